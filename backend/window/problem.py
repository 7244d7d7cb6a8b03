"""The nonlinear program of one step of the window, landmarks and key poses already eliminated."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from polhode.backend.dynamics.kernels import prior_kernel
from polhode.backend.dynamics.residuals import add_steps
from polhode.backend.problem.inertia import FORMS, InertiaForm
from polhode.backend.problem.iterate import N_CONSTANTS, N_STATE
from polhode.backend.solvers.gauss_newton import Solution
from polhode.backend.window.dynamics_factors import DynamicsFactors, factor_jacobians, factor_residuals
from polhode.backend.window.quadratic import Quadratic
from polhode.lie import Array


class InertiaModel:
    """The parametrization of the inertia and the weak prior on it, whose kernel is built once."""

    def __init__(self, name: str) -> None:
        self.form: InertiaForm = FORMS[name]
        self._prior: Any = prior_kernel(self.form)
        self._known: tuple[bytes, tuple[float, Array, Array]] | None = None

    def weak_prior(self, x: Array, parameters: Array) -> tuple[float, Array, Array]:
        """Cost, gradient (8,) and Hessian (8, 8) of the weak prior on com_G and xi."""
        # it is evaluated repeatedly at the same point
        at = x[-N_CONSTANTS:].tobytes() + parameters.tobytes()
        if self._known is None or self._known[0] != at:
            self._known = at, self._evaluated(x, parameters)
        return self._known[1]

    def _evaluated(self, x: Array, parameters: Array) -> tuple[float, Array, Array]:
        cost, gradient, upper = self._prior(x[-N_CONSTANTS:], parameters)
        cols, rows = np.tril_indices(N_CONSTANTS)
        block = np.zeros((N_CONSTANTS, N_CONSTANTS))
        block[rows, cols] = block[cols, rows] = np.asarray(upper).ravel()
        return float(cost), np.asarray(gradient).ravel(), block


@dataclass(frozen=True)
class WindowProblem:
    r"""States of W consecutive frames and the constants (``Iterate`` has their meaning), 12 W + 8 numbers x.

    minimise over x, without constraints::

        1/2 (x - x0)^T Q (x - x0) + q^T (x - x0)                 vision, landmarks and key poses eliminated,
                                                                 and the arrival cost
      + 1/2 sum_k || W_k [ r_k+1 - r_k - dt v_k; v_k+1 - v_k;    dynamics, as ``ipopt.MotionProgram``
                           Log(dR_k^T R_k^T R_k+1); w_k+1 - w'_k ] ||^2
      + 1/2 || (com - middle) / s ||^2 + 1/2 || 3 Sigma(xi) / tr Sigma(xi) - I ||^2      weak prior
    """

    vision: Quadratic
    R_ref: Array
    """(W, 3, 3) reference attitudes, which the theta of the states rotate"""
    factors: DynamicsFactors
    weak_prior: Array
    """(13,) parameters of ``kernels.prior_kernel``"""
    shape: InertiaModel

    @property
    def n_frames(self) -> int:
        return len(self.R_ref)

    @property
    def R_inertia(self) -> Array:
        """(3, 3) reference rotation of the inertia's form."""
        return self.weak_prior[4:13].reshape(3, 3).T

    def cost(self, x: Array) -> float:
        """The objective."""
        # a very long step may overflow: it is rejected like any other
        with np.errstate(over="ignore", invalid="ignore"):
            try:
                r = factor_residuals(x, self.R_ref, self.factors, self.shape.form, self.R_inertia)
            except ValueError:
                return np.inf
            weak, _, _ = self.shape.weak_prior(x, self.weak_prior)
            return self.vision.value(x) + 0.5 * float(np.sum(r**2)) + weak

    def normal_equations(self, x: Array) -> tuple[float, Array, Array]:
        """The objective, its Gauss-Newton Hessian (n, n) and its gradient (n,)."""
        H, d = self.vision.H.copy(), x - self.vision.x0
        along = self.vision.H @ d
        g, cost = self.vision.g + along, float(d @ (self.vision.g + 0.5 * along))
        if len(self.factors):
            r, D = factor_jacobians(x, self.R_ref, self.factors, self.shape.form, self.R_inertia)
            add_steps(H, g, r, D, N_STATE)
            cost += 0.5 * float(np.sum(r**2))
        weak, gradient, hessian = self.shape.weak_prior(x, self.weak_prior)
        H[-N_CONSTANTS:, -N_CONSTANTS:] += hessian
        g[-N_CONSTANTS:] += gradient
        return cost + weak, H, g


class WindowSolver(Protocol):
    """A solver of the window's program."""

    name: str

    def solve(self, problem: WindowProblem, x: Array, max_iterations: int) -> Solution:
        """Minimize from x (12 W + 8,)."""
        ...
