"""The assessment of a point that a solver returns: cost, remaining decrease, inertia ratios and errors."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.problem.iterate import Iterate
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.schur import mirror
from polhode.backend.uncertainty.principal_axes import axes_derivative
from polhode.compare.problem.measured_problem import MeasuredProblem, ratios
from polhode.compare.rows import EstimateErrors
from polhode.geometry.lie import Array, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_fit import mean_rotation
from polhode.records.metrics import angle_deg, rms
from polhode.records.truth import Truth

AGREED = 1e-6
"""Relative difference of costs within which solvers agree; more than that left to gain is no convergence."""


@dataclass(frozen=True)
class PointAssessment:
    """A point by the common functions; None outside their domain."""

    cost: float | None = None
    gain_left: float | None = None
    k1: float | None = None
    k2: float | None = None
    errors: EstimateErrors | None = None


def assess(problem: MeasuredProblem, x: Array) -> PointAssessment:
    """Evaluate the common functions at the point x (n,)."""
    solver = GaussNewton(problem.data)
    with np.errstate(all="ignore"):
        cost = solver.cost(problem.fixed, x) if np.isfinite(x).all() else np.inf
        if not np.isfinite(cost):
            return PointAssessment()
        at = problem.iterate(x)
        k1, k2 = ratios(at, problem.data)
        errors = errors_of(at, problem, problem.truth) if problem.truth is not None else None
        return PointAssessment(float(cost), gain_left(problem, x), k1, k2, errors)


def gain_left(problem: MeasuredProblem, x: Array) -> float | None:
    """Decrease that a Gauss-Newton step predicts at x, over the cost; None where it has no solution."""
    solver = GaussNewton(problem.data)
    system = solver.normal_equations(problem.fixed, x)
    S, g, C_inv = solver.reduced(system)
    try:
        factor = cho_factor(S, lower=True, overwrite_a=True)
    except (LinAlgError, ValueError):
        return None
    of_landmarks = np.einsum("li,lij,lj->", system.h, C_inv, system.h)
    gain = 0.5 * float(g @ cho_solve(factor, g)) + 0.5 * float(of_landmarks)
    return gain / max(system.cost, 1.0) if np.isfinite(gain) else None


def sigmas(problem: MeasuredProblem, x: Array, cov_constants: Array | None) -> list[float | None]:
    """Standard deviations of k1, k2 and of com_G [mm, root of the trace] from a covariance (8, 8)."""
    if cov_constants is None or not np.isfinite(cov_constants).all():
        return [None, None, None]
    of_xi = axes_derivative(problem.data.form, problem.iterate(x)).ratios
    variances = np.diag(of_xi @ cov_constants[3:, 3:] @ of_xi.T)
    values = [*variances, 1e6 * np.trace(cov_constants[:3, :3])]
    return [float(np.sqrt(value)) if value > 0.0 else None for value in values]


def reference_covariance(problem: MeasuredProblem, x: Array) -> Array:
    """(8, 8) of com_G, xi: inverse of the whole Gauss-Newton Hessian, with priors and gauge."""
    solver = GaussNewton(problem.data)
    S, _, _ = solver.reduced(solver.normal_equations(problem.fixed, x))
    mirror(S)
    n = problem.fixed.reference.n_states
    columns = np.eye(len(S))[:, n : n + 8]
    return np.asarray(np.linalg.solve(S, columns)[n : n + 8])


def errors_of(at: Iterate, problem: MeasuredProblem, truth: Truth) -> EstimateErrors:
    """Estimate minus truth; vectors are compared in N."""
    states = FrameStates.of(at, problem.data.camera_N)
    r_N, R_NG = states.centres(), states.true_attitudes()
    R_GP = np.swapaxes(R_NG, 1, 2) @ truth.R_NP
    attitude_deg = angle_deg(mean_rotation(R_GP).T @ R_GP)
    w_N = np.einsum("fij,fj->fi", R_NG, at.w_G) - np.einsum("fij,fj->fi", truth.R_NP, truth.w_P)
    k1, k2 = ratios(at, problem.data)
    return EstimateErrors(
        position_mm=1e3 * rms(r_N - truth.r_N),
        velocity_mm_s=1e3 * rms(at.v_N - truth.v_N),
        attitude_deg=rms(attitude_deg[:, None]),
        angular_velocity_deg_s=float(np.rad2deg(rms(w_N))),
        com_mm=1e3 * float(np.linalg.norm(_offset(at, truth))),
        k1=k1 - truth.k1,
        k2=k2 - truth.k2,
    )


def _offset(at: Iterate, truth: Truth) -> Array:
    """Estimated minus true centre of mass in the body, mean over the frames [m]."""
    in_G = transform_points(inverse_pose(make_pose(at.R_NG, at.p_NG)), truth.r_N[:, None])[:, 0]
    return np.asarray(at.com_G - in_G.mean(axis=0))
