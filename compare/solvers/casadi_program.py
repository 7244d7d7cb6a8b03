"""The common cost as a CasADi nonlinear program in several formulations, for IPOPT and CasADi's SQP method.

Hessian: Gauss-Newton or exact. Dynamics: weighted residuals, or equality constraints with slack, whose
squares are the cost. Stereo kernels: on CasADi's virtual machine, or from generated C. Blocks of small
kernels are scattered by constant sparse matrices, as in ``backend.program``.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import Output, dynamics_kernel
from polhode.backend.solvers.casadi_nlp import gather, scatter, upper_keys, upper_sparsity
from polhode.backend.solvers.ipopt import (
    MotionProgram,
    ProgramLayout,
    ProgramTerm,
    program_parameters,
    series_groups,
)
from polhode.compare.problem.blocks import Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solvers.casadi_kernels import (
    Hessian,
    bent_step_kernel,
    compile_kernels,
    exact_prior_kernel,
    exact_step_kernel,
    stereo_kernels,
    stereo_parameters,
)
from polhode.lie import Array
from polhode.records import Ints

Dynamics = Literal["weighted", "slack"]
Code = Literal["vm", "c"]


@dataclass(frozen=True)
class Formulation:
    """What is chosen."""

    hessian: Hessian = "gauss_newton"
    dynamics: Dynamics = "weighted"
    code: Code = "vm"


class VariantProgram(MotionProgram):
    """Expressions of one formulation; ``functions`` are what CasADi's solvers want to be given."""

    def __init__(self, problem: MeasuredProblem, formulation: Formulation, folder: Path) -> None:
        super().__init__(problem.data)
        self.problem, self.formulation = problem, formulation
        held, data = problem.held, problem.data
        self._series = held.steps.series
        self.layout = ProgramLayout(held.reference, int(held.steps.series.max()))
        self.blocks = Blocks(data, held)
        self.n_x = self.blocks.n_x
        self.n_slack = 12 * (data.n_frames - 1) if formulation.dynamics == "slack" else 0
        kernels = stereo_kernels(data.robust_scale, formulation.hessian)
        self._stereo = compile_kernels(kernels, folder) if formulation.code == "c" else kernels
        self._measurements = ca.DM(stereo_parameters(data, held))
        self.p = program_parameters(data, held, self._series)

    def start(self, x: Array) -> Array:
        """Unknowns with slack, zero: the constraints do not hold yet."""
        return np.concatenate([x, np.zeros(self.n_slack)])

    def terms(self, x: Any, p: Any, at: ProgramLayout, output: Output) -> list[ProgramTerm]:
        """Those of the back end's program, exact second derivatives where asked for; slack for dynamics."""
        terms = super().terms(x, p, at, output)
        steps = len(series_groups(self._series))
        exact = self.formulation.hessian == "exact" and output == "quadratic"
        if self.formulation.dynamics == "slack":
            terms = terms[steps:]
        elif exact:
            terms[:steps] = [
                ProgramTerm(
                    slots, *exact_step_kernel(self.data.form, n, at.step).map(len(slots)).call(arguments)
                )
                for n, slots, arguments in self._steps(x, p, at)
            ]
        if exact:
            prior = 0 if self.formulation.dynamics == "slack" else steps
            body = terms[prior].slots
            arguments = [gather(x, body), p[at.prior : at.prior + 13]]
            terms[prior] = ProgramTerm(body, *exact_prior_kernel(self.data.form).call(arguments))
        return [self._stereo_term(x, output), *terms]

    def _stereo_term(self, x: Any, output: Output) -> ProgramTerm:
        slots = self.blocks.stereo_slots()
        kernel = self._stereo[output].map(len(slots))
        return ProgramTerm(slots, *kernel.call([gather(x, slots), self._measurements]))

    def _steps(self, x: Any, p: Any, at: ProgramLayout) -> list[tuple[int, Ints, list[Any]]]:
        """Of each number of series: the unknowns of its steps, and the arguments of a kernel."""
        out, all_slots = [], self.blocks.step_slots()
        for n, index in series_groups(self._series):
            slots = all_slots[index]
            of_p = at.steps + at.step.n_p * index[:, None] + np.arange(at.step.n_p)
            arguments = [gather(x, slots), gather(p, of_p)]
            if at.step.pushed:
                torque = gather(p, at.torque + at.n_torque * index[:, None] + np.arange(6 * n))
                arguments.append(ca.reshape(torque, 6, n * len(index)))
            out.append((n, slots, arguments))
        return out

    def functions(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The program and the derivatives to hand to ``nlpsol``."""
        n = self.n_x + self.n_slack
        z, p = ca.MX.sym("x", n), ca.MX.sym("p", len(self.p))
        x, slack = z[: self.n_x], z[self.n_x :]
        at = self.layout
        cost = sum(ca.sum2(term.cost) for term in self.terms(x, p, at, "cost")) + 0.5 * ca.sumsqr(slack)
        terms = self.terms(x, p, at, "gradient")
        slots = np.concatenate([term.slots.ravel() for term in terms])
        gradient = scatter(slots, self.n_x) @ ca.vertcat(*[ca.vec(term.gradient) for term in terms])
        # with slack the states' own entries are empty; IPOPT reads a gradient as if it had none
        gradient = ca.densify(ca.vertcat(gradient, slack))
        with_cost = sum(ca.sum2(term.cost) for term in terms) + 0.5 * ca.sumsqr(slack)
        program: dict[str, Any] = {"x": z, "p": p, "f": cost}
        given: dict[str, Any] = {
            "grad_f": ca.Function("nlp_grad_f", [z, p], [with_cost, gradient], ["x", "p"], ["f", "grad_f_x"])
        }
        if self.n_slack:
            program["g"], given["jac_g"] = self._constraints(z, x, slack, p)
        given["hess_lag"] = self._hessian(z, x, p, n)
        return program, given

    def _constraints(self, z: Any, x: Any, slack: Any, p: Any) -> tuple[Any, Any]:
        """Residual minus slack of every step, in the order of the groups, and its Jacobian."""
        values, blocks, cells, rows = [], [], [], 0
        for n, slots, arguments in self._steps(x, p, self.layout):
            kernel = dynamics_kernel(self.data.form, n, "jacobian", self.layout.step).map(len(slots))
            residual, jacobian = kernel.call(arguments)
            values.append(ca.vec(residual))
            blocks.append(ca.vec(jacobian))
            count, width = slots.shape
            row = rows + 12 * np.arange(count)[:, None, None] + np.arange(12)
            # by columns within a block, as CasADi stores it
            cells.append((slots[:, :, None] * 10**6 + row).reshape(count, width * 12).ravel())
            rows += 12 * count
        own = (self.n_x + self._slack_order()) * 10**6 + np.arange(rows)
        keys = np.concatenate([*cells, own])
        order = np.argsort(keys, kind="stable")
        columns, at_rows = np.divmod(keys[order], 10**6)
        offsets = np.searchsorted(columns, np.arange(self.n_x + self.n_slack + 1))
        sparsity = ca.Sparsity(rows, self.n_x + self.n_slack, offsets.tolist(), at_rows.tolist())
        numbers = ca.vertcat(*blocks, -ca.DM.ones(rows))
        jacobian = ca.MX(sparsity, numbers[order.tolist()])
        g = ca.vertcat(*values) - slack[self._slack_order().tolist()]
        return g, ca.Function("nlp_jac_g", [z, p], [g, jacobian], ["x", "p"], ["g", "jac_g_x"])

    def _slack_order(self) -> Ints:
        """Slack of each constraint: these are sorted by the number of series, slack by time."""
        index = np.concatenate([index for _, index in series_groups(self._series)])
        return np.asarray((12 * index[:, None] + np.arange(12)).ravel())

    def _hessian(self, z: Any, x: Any, p: Any, n: int) -> Any:
        """Upper triangle of the Hessian of the Lagrangian."""
        terms = self.terms(x, p, self.layout, "quadratic")
        keys = [upper_keys(term.slots, n) for term in terms]
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.n_slack)
        values = [lam_f * ca.vec(term.hessian) for term in terms]
        if self.n_slack:
            keys.append(np.arange(self.n_x, n) * (n + 1))
            values.append(lam_f * ca.DM.ones(self.n_slack))
        if self.n_slack and self.formulation.hessian == "exact":
            first = 0
            for series, slots, arguments in self._steps(x, p, self.layout):
                count = len(slots)
                multipliers = ca.reshape(lam_g[first : first + 12 * count], 12, count)
                kernel = bent_step_kernel(self.data.form, series, self.layout.step).map(count)
                values.append(ca.vec(kernel.call([*arguments, multipliers])[0]))
                keys.append(upper_keys(slots, n))
                first += 12 * count
        cells, position = np.unique(np.concatenate(keys), return_inverse=True)
        entries = scatter(position, len(cells)) @ ca.vertcat(*values)
        return ca.Function(
            "nlp_hess_l",
            [z, p, lam_f, lam_g],
            [ca.MX(upper_sparsity(cells, n), entries)],
            ["x", "p", "lam_f", "lam_g"],
            ["triu_hess_gamma_x_x"],
        )
