"""Slow, unreported rotations of the inspector: do they explain the disturbances better than a wrench does?

Where the inspector's stated attitude differs from the true one by a rotation ``alpha(t)``, the whole scene
appears rotated about the camera: the target is displaced by ``alpha x d``, d being its position relative to
the camera, and turned by ``alpha``, both reversed. Free motion is then contradicted in translation and in
rotation together, in the ratio that d prescribes; force and torque on the target are unrelated. Both
explanations are judged by their evidence, as the levels of the process noise are (``process_level``), each
with the process noise that suits it best::

    -ln p(data | q) = cost + 1/2 ln det Lambda(q) + 1/2 ln det H + constant

alpha is a Gaussian process in time, smooth over a share of the sequence, across the line of sight: a roll
about that line displaces nothing and cannot be distinguished from a torque. Its coefficients are further
constants of the dynamics. The problem is linearized at the estimate: a process noise costs one elimination.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from polhode.backend.dynamics.residuals import FrameStates, add_steps, dynamics_jacobians
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import CAMERA_ROTATION, N_CAMERA, N_POSE, N_STATE
from polhode.backend.problem.level_prior import FLOOR_PSD
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.chain import eliminate_chain
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit, linearization_point
from polhode.backend.solvers.schur import mirror
from polhode.geometry.lie import Array

CORRELATION_LENGTHS = (1.0 / 12.0, 1.0 / 6.0, 1.0 / 3.0)
"""Correlation length of a swing, as shares of the sequence, the shortest first: a period is about six times
as long."""
SIGMAS_RAD = tuple(np.deg2rad([0.1, 0.3, 1.0, 3.0]).tolist())
"""Standard deviation of a swing about each axis; the errors of features cause up to 0.03 deg."""


@dataclass(frozen=True)
class InspectorSwing:
    """The smooth error of the inspector's attitude that explains the disturbances best."""

    evidence_gain: float
    """Logarithm of the odds for it, against forces and torques on the target alone"""
    alpha_N: Array
    """(F, 3) rotation [rad] along N from the stated to the true attitude, without its mean"""

    @property
    def rms_rad(self) -> float:
        """Root mean square of the rotation."""
        return float(np.sqrt(np.mean(np.sum(self.alpha_N**2, axis=1))))


@dataclass(frozen=True)
class LinearizedLevel:
    """The problem under one process noise, with all but the m coefficients of a swing eliminated."""

    minus_log_evidence: float
    """Without a swing, less what all levels have in common"""
    information: Array
    """(m, m) of the coefficients"""
    gradient: Array
    """(m,)"""


def find_swing(fit: MotionFit) -> InspectorSwing | None:
    """The most likely swing at a solution; None: fewer than eight frames."""
    if fit.data.n_frames < 8:
        return None
    problem = SwingProblem(fit)
    without, least, best = np.inf, np.inf, np.zeros(problem.directions.shape[2])
    for level in problem.levels():
        without = min(without, level.minus_log_evidence)
        for root in problem.prior_roots:
            scale, axes = np.linalg.eigh(root.T @ level.information @ root)
            along = axes.T @ (root.T @ level.gradient)
            for sigma in SIGMAS_RAD:
                narrower = 1.0 / sigma**2 + scale
                value = level.minus_log_evidence + 0.5 * float(
                    np.log(narrower * sigma**2).sum() - np.sum(along**2 / narrower)
                )
                if value < least:
                    least, best = value, -root @ axes @ (along / narrower)
    alpha_N = problem.directions @ best
    return InspectorSwing(without - least, alpha_N - alpha_N.mean(axis=0))


class SwingProblem:
    """The problem at one iterate, with a swing's coefficients among its constants."""

    def __init__(self, fit: MotionFit) -> None:
        self.data, self.iterate = data, iterate = fit.data, fit.iterate
        fixed, x = fit.linearized(), iterate.vector()
        vision = GaussNewton(data, with_dynamics=False)
        system = vision.normal_equations(fixed, x)
        # velocities and rates are left to the dynamics
        chain = np.arange(iterate.n_states).reshape(-1, iterate.n_state)[:, N_POSE:N_STATE]
        system.H[chain, chain] = 0.0
        self.S, self.g, _ = vision.reduced(system)
        camera = np.zeros((data.n_frames, N_CAMERA)) if iterate.camera is None else iterate.camera
        self.states = FrameStates.of(replace(iterate, camera=camera), data.camera_N)
        in_time, roots = smooth_functions(data.dt_s)
        across = directions_across(self.states.centres() - data.camera_N)
        self.directions = np.einsum("fij,fn->fijn", across, in_time).reshape(data.n_frames, 3, -1)
        """(F, 3, m) rotation per coefficient of a swing"""
        self.prior_roots = [np.kron(np.eye(2), root) for root in roots]
        """(m, r) each: root of the covariance of the coefficients, for a swing of one radian"""

    def levels(self) -> Iterator[LinearizedLevel]:
        """The problem under each process noise."""
        for accel_psd, torque_psd in product(_lowered(self.data.accel_psd), _lowered(self.data.torque_psd)):
            yield self._level(replace(self.data, accel_psd=accel_psd, torque_psd=torque_psd))

    def _level(self, data: MotionData) -> LinearizedLevel:
        fixed, s, n = linearization_point(data, self.iterate), self.iterate.n_state, self.iterate.n_dense
        J_G = self.iterate.J_G(data.form)
        dJ = inertia_derivative(data.form, self.iterate.xi, self.iterate.R_inertia)
        residual, jacobian = dynamics_jacobians(self.states, fixed.steps, J_G, dJ)
        m = self.directions.shape[2]
        H, g = np.zeros((n + m, n + m)), np.zeros(n + m)
        H[:n, :n], g[:n] = self.S, self.g
        add_steps(H, g, residual, self._with_swing(jacobian), s)
        chain = eliminate_chain(H, g, data.n_frames, s)
        mirror(chain.dense)
        rest = len(chain.dense) - m
        factor = np.linalg.cholesky(chain.dense[:rest, :rest])
        columns = np.column_stack([chain.dense_gradient[:rest], chain.dense[:rest, rest:]])
        columns = solve_triangular(factor, columns, lower=True, check_finite=False)
        along, coupling = columns[:, 0], columns[:, 1:]
        diagonals = np.diagonal(chain.diagonal, axis1=1, axis2=2), np.diagonal(factor)
        minus_log_evidence = fixed.steps.half_log_det + sum(float(np.log(each).sum()) for each in diagonals)
        for sign, vector in ((1.0, residual), (-1.0, chain.gradient), (-1.0, along)):
            minus_log_evidence += 0.5 * sign * float(np.sum(vector**2))
        return LinearizedLevel(
            minus_log_evidence,
            chain.dense[rest:, rest:] - coupling.T @ coupling,
            chain.dense_gradient[rest:] - coupling.T @ along,
        )

    def _with_swing(self, jacobian: Array) -> Array:
        """Jacobians (F - 1, 12, 2 s + c + m) of the steps from those with the camera's errors."""
        width, s = N_STATE + N_CAMERA, self.iterate.n_state
        before, after = jacobian[:, :, :width], jacobian[:, :, width : 2 * width]
        of_swing = before[:, :, CAMERA_ROTATION] @ self.directions[:-1]
        of_swing += after[:, :, CAMERA_ROTATION] @ self.directions[1:]
        parts = before[:, :, :s], after[:, :, :s], jacobian[:, :, 2 * width :], of_swing
        return np.concatenate(parts, axis=2)


def _lowered(psd: float) -> list[float]:
    """The estimated process noise, which has risen to contain a swing, and lower ones, down to its floor."""
    return sorted({max(factor * psd, min(psd, FLOOR_PSD)) for factor in (1.0, 0.1, 0.01)})


def smooth_functions(dt_s: Array) -> tuple[Array, list[Array]]:
    """Functions of time (F, n), and for each correlation length the root (n, r) of the covariance of their
    coefficients, that of a Gaussian process of unit variance with a squared-exponential correlation."""
    at = np.concatenate([[0.0], np.cumsum(dt_s)]) / np.sum(dt_s)
    between = np.subtract.outer(at, at)
    # what is faster than three mean steps between frames are errors of single frames
    lengths = np.maximum(CORRELATION_LENGTHS, 3.0 / len(dt_s))
    correlations = [np.exp(-0.5 * (between / length) ** 2) for length in lengths]
    functions = _root(correlations[0])
    functions /= np.linalg.norm(functions, axis=0)
    return functions, [_root(functions.T @ correlation @ functions) for correlation in correlations]


def _root(covariance: Array) -> Array:
    """(n, r) matrix whose square is the covariance (n, n), without what is numerical noise."""
    variance, axes = np.linalg.eigh(covariance)
    counts = variance > 1e-5 * variance[-1]
    return np.asarray(axes[:, counts] * np.sqrt(variance[counts]))


def directions_across(d: Array) -> Array:
    """(F, 3, 2) two unit vectors perpendicular to each d (F, 3) and to one another."""
    line = d / np.linalg.norm(d, axis=1, keepdims=True)
    first = np.cross(line, np.eye(3)[np.argmin(np.abs(line.mean(axis=0)))])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(line, first)], axis=2)
