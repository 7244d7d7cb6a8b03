"""The common cost as a CasADi nonlinear program in several formulations, for IPOPT and CasADi's SQP method.

Hessian: Gauss-Newton or exact. Dynamics: weighted residuals, or equality constraints with slack, whose
squares are the cost. Stereo kernels: on CasADi's virtual machine, or from generated C. Blocks of small
kernels are scattered by constant sparse matrices, as in ``backend.solvers.ipopt``.
"""

import subprocess
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import Any, Literal

import casadi as ca
import numpy as np

from polhode.backend.dynamics.kernels import Output, StepLayout, dynamics_kernel, prior_kernel, upper
from polhode.backend.problem.inertia import InertiaForm, rotation_sx
from polhode.backend.problem.iterate import N_CONSTANTS
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.casadi_nlp import gather, scatter, upper_keys, upper_sparsity
from polhode.backend.solvers.ipopt import (
    MotionProgram,
    ProgramLayout,
    ProgramTerm,
    program_parameters,
    series_groups,
)
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.backend.solvers.robust_kernel import MAX_CURVATURE
from polhode.compare.problem.blocks import Blocks
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.geometry.lie import Array, Ints
from polhode.runtime.parent_death import tied

Hessian = Literal["gauss_newton", "exact"]
Dynamics = Literal["weighted", "slack"]
Code = Literal["vm", "c"]


@dataclass(frozen=True)
class Formulation:
    """One choice of Hessian, dynamics and code."""

    hessian: Hessian = "gauss_newton"
    dynamics: Dynamics = "weighted"
    code: Code = "vm"


class VariantProgram(MotionProgram):
    """Expressions of one formulation; ``functions`` are those that CasADi's solvers take."""

    def __init__(self, problem: MeasuredProblem, formulation: Formulation, folder: Path) -> None:
        super().__init__(problem.data)
        self.problem, self.formulation = problem, formulation
        fixed, data = problem.fixed, problem.data
        self._series = fixed.steps.series
        self.layout = ProgramLayout(fixed.reference, int(fixed.steps.series.max()))
        self.blocks = Blocks(data, fixed)
        self.n_x = self.blocks.n_x
        self.n_slack = 12 * (data.n_frames - 1) if formulation.dynamics == "slack" else 0
        kernels = stereo_kernels(data.robust_scale, formulation.hessian)
        self._stereo = compile_kernels(kernels, folder) if formulation.code == "c" else kernels
        self._measurements = ca.DM(stereo_parameters(data, fixed))
        self.p = program_parameters(data, fixed, self._series)

    def start(self, x: Array) -> Array:
        """The unknowns with slack zero, at which the constraints are violated."""
        return np.concatenate([x, np.zeros(self.n_slack)])

    def terms(self, x: Any, p: Any, at: ProgramLayout, output: Output) -> list[ProgramTerm]:
        """Terms of the back end's program, with exact second derivatives or slack as chosen."""
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
                for n, slots, arguments in self.steps(x, p, at)
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

    def functions(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """The program and its derivatives, for ``nlpsol``."""
        n = self.n_x + self.n_slack
        z, p = ca.MX.sym("x", n), ca.MX.sym("p", len(self.p))
        x, slack = z[: self.n_x], z[self.n_x :]
        at = self.layout
        cost = sum(ca.sum2(term.cost) for term in self.terms(x, p, at, "cost")) + 0.5 * ca.sumsqr(slack)
        terms = self.terms(x, p, at, "gradient")
        slots = np.concatenate([term.slots.ravel() for term in terms])
        gradient = scatter(slots, self.n_x) @ ca.vertcat(*[ca.vec(term.gradient) for term in terms])
        # with slack, the states' own entries are structural zeros, which IPOPT does not expect in a gradient
        gradient = ca.densify(ca.vertcat(gradient, slack))
        with_cost = sum(ca.sum2(term.cost) for term in terms) + 0.5 * ca.sumsqr(slack)
        program: dict[str, Any] = {"x": z, "p": p, "f": cost}
        derivatives: dict[str, Any] = {
            "grad_f": ca.Function("nlp_grad_f", [z, p], [with_cost, gradient], ["x", "p"], ["f", "grad_f_x"])
        }
        if self.n_slack:
            program["g"], derivatives["jac_g"] = self._constraints(z, x, slack, p)
        derivatives["hess_lag"] = self._hessian(z, x, p, n)
        return program, derivatives

    def _constraints(self, z: Any, x: Any, slack: Any, p: Any) -> tuple[Any, Any]:
        """Residual minus slack of every step, in the order of the groups, and its Jacobian."""
        values, blocks, cells, rows = [], [], [], 0
        for n, slots, arguments in self.steps(x, p, self.layout):
            kernel = dynamics_kernel(self.data.form, n, "jacobian", self.layout.step).map(len(slots))
            residual, jacobian = kernel.call(arguments)
            values.append(ca.vec(residual))
            blocks.append(ca.vec(jacobian))
            count, width = slots.shape
            row = rows + 12 * np.arange(count)[:, None, None] + np.arange(12)
            # by columns within a block, as CasADi stores matrices
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
        """Slack of each constraint: constraints are sorted by the number of series, slack by time."""
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
            for series, slots, arguments in self.steps(x, p, self.layout):
                count = len(slots)
                multipliers = ca.reshape(lam_g[first : first + 12 * count], 12, count)
                kernel = curvature_kernel(self.data.form, series, self.layout.step).map(count)
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


N_STEREO = 32
"""Parameters of a measurement: A_ref (9), R_RN (9), by columns, t_R, uvd, 1 / sigma (3 each), rig (5)."""
COMPILERS = ("cc", "gcc", "clang")


def stereo_kernels(scale: float, hessian: Hessian) -> dict[str, Any]:
    """Functions (x (9) = p_NG, theta, p_G; q (32)) of the cost; with gradient; with upper Hessian too."""
    x, q = ca.SX.sym("x", 9), ca.SX.sym("q", N_STEREO)
    A = ca.reshape(q[0:9], 3, 3) @ rotation_sx(x[3:6])
    p = A @ x[6:9] + ca.reshape(q[9:18], 3, 3) @ x[0:3] + q[18:21]
    f, cx, cy, baseline, offset = (q[27 + i] for i in range(5))
    predicted = ca.vertcat(f * p[0] / p[2] + cx, f * p[1] / p[2] + cy, f * baseline / p[2] + offset)
    r = (q[21:24] - predicted) * q[24:27]
    s = ca.sumsqr(r)
    cost = 0.5 * scale**2 * ca.log1p(s / scale**2)
    gradient = ca.gradient(cost, x)
    if hessian == "exact":
        second, _ = ca.hessian(cost, x)
    else:
        # as in robust_kernel: second-order correction, limited so that the block stays positive
        J, weight = ca.jacobian(r, x), 1.0 / (1.0 + s / scale**2)
        limited = ca.fmin(2.0 / (scale**2 + s), MAX_CURVATURE / (s + 1e-12))
        correction = limited / (1.0 + ca.sqrt(1.0 - limited * s))
        B = J - correction * r @ (r.T @ J)
        second = weight * B.T @ B
    outputs = [cost, ca.densify(gradient), upper(ca.densify(second))]
    return {
        name: ca.Function(f"stereo_{name}", [x, q], outputs[:n])
        for name, n in (("cost", 1), ("gradient", 2), ("quadratic", 3))
    }


def compile_kernels(kernels: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same functions from generated C, compiled by the machine's compiler; RuntimeError without one."""
    compiler = next((name for name in COMPILERS if which(name)), None)
    if compiler is None:
        raise RuntimeError(f"no C compiler found ({', '.join(COMPILERS)})")
    generator = ca.CodeGenerator("stereo.c")
    for kernel in kernels.values():
        generator.add(kernel)
    source, library = Path(generator.generate(f"{folder}/")), folder / "stereo.so"
    command = [compiler, "-O3", "-fPIC", "-shared", str(source), "-o", str(library), "-lm"]
    # the compiler of the user's PATH, on code that we generated in a folder of the user alone
    done = subprocess.run(tied(command), capture_output=True, text=True, check=False)  # noqa: S603
    if done.returncode:
        raise RuntimeError(f"{compiler} failed: {done.stderr.splitlines()[0] if done.stderr else ''}")
    return {name: ca.external(kernel.name(), str(library)) for name, kernel in kernels.items()}


def stereo_parameters(data: MotionData, fixed: LinearizationPoint) -> Array:
    """(32, M) one column a measurement."""
    d, k = data, data.frame
    by_columns = [np.swapaxes(R, 1, 2).reshape(-1, 9)[k] for R in (fixed.A, d.R_RN)]
    rig = np.broadcast_to(d.rig, (len(k), 5))
    return np.ascontiguousarray(np.hstack([*by_columns, d.t_R[k], d.uvd_px, d.inv_sigma, rig]).T)


def exact_step_kernel(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """The dynamics of a step: cost, gradient, upper exact Hessian; arguments as ``dynamics_kernel``."""
    kernel = dynamics_kernel(form, n_series, "gradient", layout).expand()
    arguments = [ca.SX.sym(f"a{i}", kernel.size1_in(i), kernel.size2_in(i)) for i in range(kernel.n_in())]
    cost, gradient = kernel.call(arguments)
    second = ca.densify(ca.jacobian(gradient, arguments[0]))
    return ca.Function("exact_step", arguments, [cost, gradient, upper(second)])


def curvature_kernel(form: InertiaForm, n_series: int, layout: StepLayout) -> Any:
    """Upper Hessian of the residuals of a step, each times its multiplier (last argument, 12)."""
    kernel = dynamics_kernel(form, n_series, "jacobian", layout).expand()
    arguments = [ca.SX.sym(f"a{i}", kernel.size1_in(i), kernel.size2_in(i)) for i in range(kernel.n_in())]
    multiplier = ca.SX.sym("multiplier", 12)
    _, jacobian = kernel.call(arguments)
    second = ca.densify(ca.jacobian(jacobian.T @ multiplier, arguments[0]))
    return ca.Function("curvature", [*arguments, multiplier], [upper(second)])


def exact_prior_kernel(form: InertiaForm) -> Any:
    """The weak prior: cost, gradient, upper exact Hessian; arguments as ``prior_kernel``."""
    x, p = ca.SX.sym("x", N_CONSTANTS), ca.SX.sym("p", 13)
    cost, gradient = prior_kernel(form, "gradient")(x, p)
    return ca.Function("exact_prior", [x, p], [cost, gradient, upper(ca.densify(ca.jacobian(gradient, x)))])
