"""The Cramer-Rao bound of a Monte Carlo sequence against the noise of pixels and the disturbances.

    python -m lab.monte_carlo.bound

The bound is the inverse of the Gauss-Newton information at the true state: the measurements' true noise, and
the true process noise as prior on the motion (posterior Cramer-Rao bound of Van Trees, for the simulated
states). G is fixed at its pose in the first frame, as in the estimate's covariance. Other benchmarks take the
cold start of a sequence and the errors of its estimate from here.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lab.command import command
from lab.presentation import numbers, print_table
from polhode.backend import estimate_motion, initialize_motion
from polhode.backend.dynamics.residuals import FrameStates
from polhode.backend.problem.inertia import FORMS, InertiaForm, second_moments_from_inertia
from polhode.backend.problem.iterate import N_CONSTANTS, Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.covariance import Marginals, marginals, state_jacobians
from polhode.backend.uncertainty.identifiability import analyse
from polhode.backend.uncertainty.principal_axes import axes_derivative
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, hat, inverse_pose, log_so3
from polhode.geometry.rigid_body import HALF_TURNS, best_half_turn
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.runtime.progress import Silent
from polhode.simulation.monte_carlo import SyntheticSequence, generate

QUANTITIES = ("position", "velocity", "attitude", "angular velocity", "centre of mass", "inertia")
"""r along N [m], v along N [m/s], theta in P [rad], w along N [rad/s], com_G [m], the five numbers xi."""
COMPONENTS = np.array([3, 3, 3, 3, 3, 5])
UNITS = np.array([1e3, 1e3, np.rad2deg(1.0), np.rad2deg(1.0), 1e3, 1.0])
"""To mm, mm/s, deg, deg/s, mm."""


def cold_start(sequence: SyntheticSequence, config: Backend) -> tuple[InitialMotion, MotionEstimate]:
    """Initial motion from the relative poses, and the estimate. Raises RunFailure."""
    initial = initialize_motion(sequence.tracks, sequence.relative, config)
    return initial, estimate_motion(sequence.tracks, initial, config, Silent())


@dataclass(frozen=True)
class Bound:
    """Covariances that no unbiased estimator falls below."""

    states: Array
    """(F, 12, 12) of r (N), v (N), theta (P), w (N)"""
    com_G: Array
    """(3, 3) [m^2]"""
    xi: Array
    """(5, 5) of the inertia in the solver's coordinates, in the true G"""
    freedom: Array
    """(6,) degrees of freedom of the chi-square that each mean normalised square over the frames is like"""

    @property
    def mean_squares(self) -> Array:
        """(6,) least mean squared error of each of QUANTITIES, over the frames."""
        return np.array([*_traces(self.states), np.trace(self.com_G), np.trace(self.xi)])


ALL_FRAMES = slice(None)


def cramer_rao_bound(sequence: SyntheticSequence, config: Backend, frames: slice = ALL_FRAMES) -> Bound:
    """The bound for a sequence; ``config`` holds the true process noise, the tracks the true pixel noise.

    Outliers carry no information. ``frames``: those whose states are wanted, from the measurements of all.
    """
    data, truth, m = _marginals_at_truth(sequence, config)
    joint = joint_of_states(truth, data.form, m.dense, data.camera_N)
    F, n = truth.n_frames, truth.n_states
    joint = joint.reshape(F, 12, F, 12)[frames, :, frames]
    F = len(joint)
    states, joint = joint[np.arange(F), :, np.arange(F)], joint.reshape(12 * F, 12 * F)
    freedom = np.array([*(_freedom(joint, quantity) for quantity in range(4)), 3.0, 5.0])
    return Bound(states, m.dense[n : n + 3, n : n + 3], m.dense[n + 3 :, n + 3 :], freedom)


def _marginals_at_truth(
    sequence: SyntheticSequence, config: Backend
) -> tuple[MotionData, Iterate, Marginals]:
    data, truth = motion_data(sequence.tracks, config), true_iterate(sequence, config)
    # nearly 0, so that a landmark of outliers alone can still be eliminated
    weight = np.where(sequence.outlier[data.order], 1e-6, 1.0)
    return data, truth, marginals(MotionFit(data, truth), weight)


def true_iterate(sequence: SyntheticSequence, config: Backend) -> Iterate:
    """The unknowns at the truth; where the camera's poses are noisy, with their true errors."""
    truth, form, tracks = sequence.truth, FORMS[config.inertia], sequence.tracks
    xi, R_inertia = form.coordinates(second_moments_from_inertia(truth.R_GP * truth.moments @ truth.R_GP.T))
    X_NG, camera = sequence.X_NG, None
    if max(tracks.sigma_camera_p_m, tracks.sigma_camera_theta_rad) > 0.0:
        # the unknown poses are those that the stated camera sees
        to_true = sequence.X_NR @ inverse_pose(tracks.X_NR)
        X_NG = inverse_pose(to_true) @ X_NG
        shift = sequence.X_NR[:, :3, 3] - tracks.X_NR[:, :3, 3]
        camera = np.concatenate([shift, log_so3(to_true[:, :3, :3])], axis=1)
    return Iterate(
        X_NG[:, :3, 3],
        X_NG[:, :3, :3],
        truth.v_N,
        truth.w_P @ truth.R_GP.T,
        truth.com_G,
        xi,
        R_inertia,
        sequence.p_G,
        camera,
    )


def joint_of_states(
    iterate: Iterate, form: InertiaForm, dense: Array, camera_N: Array | None = None
) -> Array:
    """Covariance (12 F, 12 F) of (r_N, v_N, theta_P, w_N) of all frames from that of the unknowns."""
    derivative, n, s = axes_derivative(form, iterate), iterate.n_states, iterate.n_state
    R_NG = FrameStates.of(iterate, np.zeros((iterate.n_frames, 3))).true_attitudes()
    R_NP, w_P = R_NG @ derivative.R_GP, iterate.w_G @ derivative.R_GP
    jacobians, parts = state_jacobians(iterate, derivative, camera_N), []
    for k in range(iterate.n_frames):
        T = rate_along_N(R_NP[k], w_P[k])
        own, constants = jacobians[k, :, :s], jacobians[k, :, s:]
        parts.append((slice(12 * k, 12 * k + 12), slice(s * k, s * k + s), T @ own, T @ constants))
    half = np.empty((12 * iterate.n_frames, n + N_CONSTANTS))
    joint = np.empty((len(half), len(half)))
    for at, unknowns, own, constants in parts:
        half[at] = own @ dense[unknowns] + constants @ dense[n:]
    for at, unknowns, own, constants in parts:
        joint[:, at] = half[:, unknowns] @ own.T + half[:, n:] @ constants.T
    return joint


def rate_along_N(R_NP: Array, w_P: Array) -> Array:
    """(r, v, theta, w_N) by (r, v, theta, w_P), (..., 12, 12): w_N is free of the axes' error."""
    T = np.tile(np.eye(12), (*w_P.shape[:-1], 1, 1))
    T[..., 9:, 9:], T[..., 9:, 6:9] = R_NP, -R_NP @ hat(w_P)
    return T


def _freedom(joint: Array, quantity: int) -> float:
    """Satterthwaite's degrees of freedom of the mean normalised square of one quantity over the frames.

    The errors of neighbouring frames are nearly the same. With C their whitened joint covariance (3 F, 3 F)
    the sum has mean 3 F and variance 2 |C|^2, like (3 F / nu) chi2_nu with nu = (3 F)^2 / |C|^2.
    """
    F = len(joint) // 12
    blocks = joint.reshape(F, 12, F, 12)[
        :, 3 * quantity : 3 * quantity + 3, :, 3 * quantity : 3 * quantity + 3
    ]
    whiten = np.linalg.inv(np.linalg.cholesky(blocks[np.arange(F), :, np.arange(F)]))
    white = np.einsum("fab,fbgc,gdc->fagd", whiten, blocks, whiten, optimize=True)
    return (3.0 * F) ** 2 / float(np.sum(white**2))


@dataclass(frozen=True)
class EstimateDeviation:
    """Estimate minus truth, half-turn resolved."""

    states: Array
    """(F, 12): r, v along N, theta in the estimate's P, w along N"""
    com_G: Array
    """(3,) in the estimate's G"""
    xi: Array
    """(5,) in the estimate's G"""
    xi_true_G: Array
    """(5,) in the true G, as in the bound"""
    ratios: Array
    """(2,) of k1, k2"""

    @property
    def mean_squares(self) -> Array:
        """(6,) mean squared error of each of QUANTITIES."""
        squares = (self.states**2).reshape(-1, 4, 3).sum(axis=2).mean(axis=0)
        return np.array([*squares, self.com_G @ self.com_G, self.xi_true_G @ self.xi_true_G])


def errors_of(estimate: MotionEstimate, sequence: SyntheticSequence, config: Backend) -> EstimateDeviation:
    """Compare an estimate with the truth of its sequence."""
    truth, mass = sequence.truth, estimate.mass
    turn = HALF_TURNS[best_half_turn(estimate.R_NP, truth.R_NP)]
    theta = -log_so3(np.swapaxes(estimate.R_NP, 1, 2) @ (truth.R_NP * turn))
    w = _along_N(estimate.R_NP, estimate.w_P) - _along_N(truth.R_NP, truth.w_P)
    states = np.concatenate([estimate.r_N - truth.r_N, estimate.v_N - truth.v_N, theta, w], axis=1)
    # both covariances hold G at its true pose of the first frame: there the two frames G are compared
    R_NG = estimate.R_NP[0] @ mass.R_GP.T
    between = sequence.X_NG[0, :3, :3].T @ R_NG
    J_true, form = truth.R_GP * truth.moments @ truth.R_GP.T, FORMS[config.inertia]
    return EstimateDeviation(
        states,
        R_NG.T @ (estimate.r_N[0] - truth.r_N[0]),
        _difference(form, mass.J_G, between.T @ J_true @ between),
        _difference(form, between @ mass.J_G @ between.T, J_true),
        np.array([mass.k1 - truth.k1, mass.k2 - truth.k2]),
    )


def normalised_squares(errors: EstimateDeviation, estimate: MotionEstimate) -> Array:
    """(6,) mean normalised squared error over the frames under the estimate's own covariance.

    Expected: COMPONENTS. Not a number where a component is undetermined.
    """
    states, mass = _states(estimate), estimate.mass
    parts = [(errors.states[:, a : a + 3], states[:, a : a + 3, a : a + 3]) for a in (0, 3, 6, 9)]
    parts += [(errors.com_G[None], mass.cov_com_G[None]), (errors.xi[None], mass.cov_J[None])]
    return np.array([_nees(*part) for part in parts])


def _states(estimate: MotionEstimate) -> Array:
    """Covariance (F, 12, 12) as in ``Bound.states``; not finite where undetermined."""
    T = rate_along_N(estimate.R_NP, estimate.w_P)
    with np.errstate(invalid="ignore"):
        return np.asarray(T @ estimate.covariance @ np.swapaxes(T, 1, 2))


def _traces(states: Array) -> Array:
    """(4,) of each state's block, averaged over the frames."""
    variance = np.diagonal(states, axis1=1, axis2=2).reshape(-1, 4, 3)
    return np.asarray(variance.sum(axis=2).mean(axis=0))


def _along_N(R_NP: Array, w_P: Array) -> Array:
    return np.asarray(np.einsum("fij,fj->fi", R_NP, w_P))


def _difference(form: InertiaForm, J: Array, J_true: Array) -> Array:
    """xi of J minus xi of J_true (5,), both in the same frame."""
    return np.asarray(
        form.coordinates(second_moments_from_inertia(J))[0]
        - form.coordinates(second_moments_from_inertia(J_true))[0]
    )


def _nees(errors: Array, covariance: Array) -> float:
    if not np.isfinite(covariance).all():
        return float("nan")
    solved = np.linalg.solve(covariance, errors[..., None])[..., 0]
    return float(np.mean(np.sum(errors * solved, axis=-1)))


def determined_at_truth(sequence: SyntheticSequence, config: Backend) -> list[bool]:
    """What the information at the truth determines (8): com along x, y, z of P, k1, k2, axes about them."""
    data, truth, m = _marginals_at_truth(sequence, config)
    derivative = axes_derivative(data.form, truth)
    record = analyse(m.constants_information, derivative, truth.w_G @ derivative.R_GP).record
    return [*map(bool, record.com_P), record.k1, record.k2, *map(bool, record.axes_P)]


def constants_errors(estimate: MotionEstimate, sequence: SyntheticSequence) -> Array:
    """Estimate minus truth (8,): com along the estimate's principal axes [m], k1, k2, axes [rad]."""
    truth, mass = sequence.truth, estimate.mass
    between = estimate.R_NP[0].T @ truth.R_NP[0]
    turn = HALF_TURNS[int(np.argmax(HALF_TURNS @ np.diag(between)))]
    axes = -log_so3(between * turn)
    ratios = mass.k1 - truth.k1, mass.k2 - truth.k2
    return np.array([*(estimate.R_NP[0].T @ (estimate.r_N[0] - truth.r_N[0])), *ratios, *axes])


SHOWN = ("spin of 10 RPM near the middle axis (TS38)", "triaxial tumble, 7 RPM")
PIXELS, DISTURBANCES = (1.0, 0.3, 0.1), (1e-6, 1e-8, 1e-10)


def main() -> None:
    """Root mean square bounds over the frames."""
    head = "motion | noise [px] | disturbances | r mm | v mm/s | attitude deg | w deg/s | com mm | inertia"
    print_table(head, _rows())


def _rows() -> Iterator[list[object]]:
    from lab.monte_carlo.accuracy import MOTIONS

    for motion in SHOWN:
        for psd in DISTURBANCES:
            for noise in PIXELS:
                scene = replace(
                    MOTIONS[motion], sigma_uv_px=noise, sigma_d_px=noise, accel_psd=psd, torque_psd=psd
                )
                bound = cramer_rao_bound(generate(scene, 0), Backend(accel_psd=psd, torque_psd=psd))
                rms = UNITS * np.sqrt(bound.mean_squares)
                yield [motion, noise, f"{psd:.0e}", *numbers(rms, ".2g")]


if __name__ == "__main__":
    command(main)
