"""The states of all frames of a long sequence, from the estimate of its key frames, in time linear in them.

The key frames give the map. With the map fixed, the frames are a chain: each one's observations are
information on its own pose, the dynamics join it to the next, and the information is block-tridiagonal, with
a border for the centre of mass and the inertia. What the map's errors contribute to the covariance is added,
by draws.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from polhode.backend.dynamics.residuals import FrameStates, dynamics_jacobians, dynamics_residuals
from polhode.backend.initialization.initialize import bridge, relocalize
from polhode.backend.initialization.rates import frame_rates
from polhode.backend.outliers_and_noise.noise_and_outliers import STEREO_GATE
from polhode.backend.outliers_and_noise.systematic import SharedErrors, with_systematic
from polhode.backend.problem.inertia import inertia_derivative, second_moments_from_inertia
from polhode.backend.problem.iterate import (
    N_CAMERA,
    N_CONSTANTS,
    N_POSE,
    N_STATE,
    POSE,
    POSITION,
    ROTATION,
    Iterate,
)
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.gauss_newton import WeakPrior
from polhode.backend.solvers.linearization_point import (
    LinearizationPoint,
    MotionFit,
    linearization_point,
    recenter_inertia,
)
from polhode.backend.solvers.robust_kernel import robust_weight
from polhode.backend.solvers.schur import stereo_normal_equations, stereo_residuals
from polhode.backend.subset_solution import data_of_part
from polhode.backend.uncertainty.calibration_response import LinearObservations, whitened_effects
from polhode.backend.uncertainty.covariance import (
    body_jacobians,
    mark_jacobians,
    observation_jacobians,
    state_jacobians,
    with_constants,
    with_infinite,
)
from polhode.backend.uncertainty.principal_axes import axes_derivative
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Ints, inverse_pose, make_pose
from polhode.geometry.rigid_body import nearest_half_turn
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import RunFailure
from polhode.runtime.threads import single_threaded

MAX_ITERATIONS = 20
SMALL_STEP = 1e-3
"""Largest change of a state, in its standard deviations, that ends the iterations."""
MIN_STEP_SHARE = 1e-2
"""Share of a step below which no decrease is sought."""
DRAWS = 64
"""Draws of the map's errors, from which their share in the covariance of the states follows."""


@dataclass(frozen=True)
class FrameGuess:
    """Where the states of all F frames start."""

    X_NG: Array
    """(F, 4, 4) in the key frames' G"""
    v_N: Array
    """(F, 3) velocity of the centre of mass [m/s]"""
    w_G: Array
    """(F, 3) [rad/s]"""


@dataclass(frozen=True)
class FixedMap:
    """Landmarks that the key frames located."""

    landmarks: Ints
    """(L,) their numbers in the tracks, ascending"""
    p_G: Array
    """(L, 3) [m]"""
    covariance: Array
    """(L, 3, 3) [m^2] given the key frames' poses"""
    by_calibration: Array
    """(L, 3, c) [m] change by one sigma of each error of the calibration"""


def map_of(tracks: StereoTracks, estimate: MotionEstimate, keys: Ints, config: Backend) -> FixedMap:
    """The landmarks with at least two observations that agree with the key frames' estimate.

    tracks: of all frames; keys (K,): the key frames among them, whose observations, in their order there, are
    those of ``estimate``.
    """
    of_keys = np.flatnonzero(np.isin(tracks.frame, keys))
    agree = estimate.inlier_weight > 0.0
    counts = np.bincount(tracks.landmark[of_keys[agree]], minlength=tracks.n_landmarks)
    chosen = agree & (counts[tracks.landmark[of_keys]] >= 2)
    rows = of_keys[chosen]
    names, first, mark = np.unique(tracks.landmark[rows], return_index=True, return_inverse=True)
    k = np.searchsorted(keys, tracks.frame[rows])
    p_R = tracks.rig.triangulate((tracks.uvd_px[rows] - estimate.residuals_px[chosen])[first])
    X_RG = inverse_pose(tracks.X_NR[keys]) @ estimate.X_NG
    back = inverse_pose(X_RG)[k[first]]
    p_G = np.einsum("nij,nj->ni", back[:, :3, :3], p_R) + back[:, :3, 3]
    part = replace(
        tracks, frame=k, landmark=mark.astype(np.int64), uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows], timestamps_ns=tracks.timestamps_ns[keys], X_NR=tracks.X_NR[keys],
    )  # fmt: skip
    data, _ = data_of_part(part, estimate, config)
    R_NG = estimate.X_NG[:, :3, :3]
    w_G = estimate.w_P @ estimate.mass.R_GP.T
    poses = Iterate(
        estimate.X_NG[:, :3, 3], R_NG, estimate.v_N, w_G, estimate.mass.com_G, np.zeros(5), np.eye(3), p_G
    )
    fit = MotionFit(data, poses)
    to_pose, J = observation_jacobians(fit)
    information = np.zeros((len(names), 3, 3))
    np.add.at(information, data.landmark, np.swapaxes(J, 1, 2) @ J)
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)
    moved = np.zeros((len(names), 3, 0))
    if estimate.calibration is not None:
        effect, weight = whitened_effects(fit, part), np.ones(len(data.frame))
        seen = LinearObservations(to_pose, J, weight, effect, data.frame, data.landmark)
        moved = seen.landmark_moves(covariance, estimate.calibration.poses)
    return FixedMap(names.astype(np.int64), p_G, covariance, moved)


def first_states(
    tracks: StereoTracks,
    keys: Ints,
    estimate: MotionEstimate,
    online: OnlineEstimate,
    found_from: int,
    config: Backend,
) -> FrameGuess:
    """Where the states of all frames start: the key frames' estimate, the window's states in between.

    Frames before ``found_from``, whose poses the window knew in another frame G, are located in the map, and
    bridged where they show too little of it.
    """
    X_NG, v_N = online.X_NG.copy(), online.v_N.copy()
    w_G = np.einsum("fij,fj->fi", online.R_GP, online.w_P)
    X_NG[keys], v_N[keys], w_G[keys] = estimate.X_NG, estimate.v_N, estimate.w_P @ estimate.mass.R_GP.T
    connected = np.arange(tracks.n_frames) >= found_from
    if found_from > 0:
        known = map_of(tracks, estimate, keys, config)
        located, p_G = np.zeros(tracks.n_landmarks, dtype=np.bool_), np.zeros((tracks.n_landmarks, 3))
        located[known.landmarks], p_G[known.landmarks] = True, known.p_G
        X_RG, connected = relocalize(tracks, inverse_pose(tracks.X_NR) @ X_NG, connected, p_G, located)
        X_NG = bridge(tracks.time_s, tracks.X_NR @ X_RG, connected)
    # the window's first states have no rates yet
    still = ~w_G.any(axis=1) | (np.arange(tracks.n_frames) < found_from)
    w_G[still] = frame_rates(tracks.time_s, X_NG, connected)[still]
    v_N[still] = v_N[~still][0] if (~still).any() else 0.0
    return FrameGuess(X_NG, v_N, w_G)


@single_threaded
def smooth_between(
    tracks: StereoTracks, keys: Ints, estimate: MotionEstimate, guess: FrameGuess, config: Backend
) -> tuple[StereoTracks, MotionEstimate]:
    """The observations of the map in all frames, and the estimate of the states of all frames.

    tracks: of all frames; ``estimate``: of the key frames (K,) among them, solved with their observations.
    Map, mass properties, noise and verdict of the solver are theirs, the axes of the states those that fit
    all frames. Raises RunFailure if the equations of the states have no solution.
    """
    known = map_of(tracks, estimate, keys, config)
    seen = np.isin(tracks.landmark, known.landmarks)
    part = replace(
        tracks,
        frame=tracks.frame[seen],
        landmark=np.searchsorted(known.landmarks, tracks.landmark[seen]),
        uvd_px=tracks.uvd_px[seen],
        sigma_px=tracks.sigma_px[seen],
    )
    data, _ = data_of_part(part, estimate, config)
    xi, R_inertia = data.form.coordinates(second_moments_from_inertia(estimate.mass.J_G, 0.0))
    camera = np.zeros((tracks.n_frames, N_CAMERA)) if data.camera_is_noisy else None
    start = Iterate(
        guess.X_NG[:, :3, 3].copy(), guess.X_NG[:, :3, :3].copy(), guess.v_N, guess.w_G,
        estimate.mass.com_G, xi, R_inertia, known.p_G, camera,
    )  # fmt: skip
    chain = _Chain(data, known)
    try:
        iterate = chain.solve(start)
        return part, chain.estimate(iterate, part, keys, estimate, config)
    except LinAlgError as error:
        raise RunFailure(f"the frames between the key frames do not follow their motion ({error})") from None


class _Chain:
    """All states given the map and the constants."""

    def __init__(self, data: MotionData, known: FixedMap) -> None:
        self.data, self.known = data, known
        self._prior = WeakPrior(data.form)

    def solve(self, iterate: Iterate) -> Iterate:
        """Gauss-Newton with halved steps, references and whitening renewed at each."""
        for _ in range(MAX_ITERATIONS):
            iterate = recenter_inertia(self.data, iterate)
            fixed = linearization_point(self.data, iterate)
            system = self._system(fixed)
            step = system.step()
            before, share = self.cost(fixed, np.zeros_like(step)), 1.0
            while share > MIN_STEP_SHARE and not self.cost(fixed, share * step) <= before:
                share *= 0.5
            iterate = _moved(fixed, share * step)
            own = np.sqrt(np.diagonal(system.D, axis1=1, axis2=2)).ravel()
            if np.abs(step[: own.size] * own).max() < SMALL_STEP or share <= MIN_STEP_SHARE:
                break
        return iterate

    def residuals(self, at: Iterate) -> Array:
        """(M, 3) whitened, of the observations."""
        d = self.data
        A = d.R_RN @ at.R_NG
        return stereo_residuals(
            d.frame, d.landmark, d.uvd_px, d.inv_sigma, d.rig, A, d.R_RN, d.t_R, at.p_NG, at.p_G
        )

    def cost(self, fixed: LinearizationPoint, step: Array) -> float:
        """The objective after a step (s F + 8,) of states and constants; Cauchy's kernel."""
        at, scale = _moved(fixed, step), self.data.robust_scale**2
        squared = np.sum(self.residuals(at) ** 2, axis=1)
        states = FrameStates.of(at, self.data.camera_N)
        dynamics = dynamics_residuals(states, fixed.steps, at.J_G(self.data.form))
        total = 0.5 * scale * np.sum(np.log1p(squared / scale)) + 0.5 * np.sum(dynamics**2)
        if at.camera is not None:
            total += 0.5 * np.sum(fixed.camera_information * at.camera**2)
        return float(total + self._prior(np.concatenate([at.com_G, at.xi]), fixed.prior)[0])

    def _system(self, fixed: LinearizationPoint) -> "_System":
        d, at = self.data, fixed.reference
        s, n = at.n_state, at.n_frames
        r = self.residuals(at)
        weight = robust_weight(np.sum(r**2, axis=1), d.robust_scale)
        A = d.R_RN @ at.R_NG
        eye = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
        H, slope, _, _, E = stereo_normal_equations(
            d.frame, d.landmark, d.inv_sigma, d.rig, A, d.R_RN, d.t_R, at.p_NG, at.p_G, eye, r, weight,
            np.zeros_like(weight),
        )  # fmt: skip
        D, U, g = np.zeros((n, s, s)), np.zeros((n - 1, s, s)), np.zeros((n, s))
        D[:, POSE, POSE], g[:, POSE] = H, slope
        if at.camera is not None:
            own = np.arange(N_STATE, N_STATE + N_CAMERA)
            D[:, own, own] += fixed.camera_information
            g[:, own] += fixed.camera_information * at.camera
        dJ = inertia_derivative(d.form, at.xi, at.R_inertia)
        states = FrameStates.of(at, d.camera_N)
        error, J = dynamics_jacobians(states, fixed.steps, at.J_G(d.form), dJ)
        before, after, constants = J[:, :, :s], J[:, :, s : 2 * s], J[:, :, 2 * s :]
        T, Ta = np.swapaxes(before, 1, 2), np.swapaxes(after, 1, 2)
        D[:-1] += T @ before
        D[1:] += Ta @ after
        U += T @ after
        g[:-1] += (T @ error[:, :, None])[:, :, 0]
        g[1:] += (Ta @ error[:, :, None])[:, :, 0]
        across = np.zeros((n, s, N_CONSTANTS))
        across[:-1] += T @ constants
        across[1:] += Ta @ constants
        _, slope_c, H_c = self._prior(np.concatenate([at.com_G, at.xi]), fixed.prior)
        Tc = np.swapaxes(constants, 1, 2)
        H_c = H_c + np.sum(Tc @ constants, axis=0)
        slope_c = slope_c + np.sum(Tc @ error[:, :, None], axis=0)[:, 0]
        return _System(D, U, g, across, H_c, slope_c, E)

    def estimate(
        self, at: Iterate, tracks: StereoTracks, keys: Ints, of_keys: MotionEstimate, config: Backend
    ) -> MotionEstimate:
        """The estimate of all frames at the solution."""
        fixed = linearization_point(self.data, at)
        system = self._system(fixed)
        s, n = at.n_state, at.n_frames
        response = -_solve_chain(system.D, system.U, system.across)
        constants = np.linalg.inv(system.of_constants(response))
        joint = np.zeros((n, s + N_CONSTANTS, s + N_CONSTANTS))
        by_constants = response @ constants
        joint[:, :s, :s] = _covariances(system.D, system.U) + by_constants @ np.swapaxes(response, 1, 2)
        joint[:, :s, s:], joint[:, s:, :s] = by_constants, np.swapaxes(by_constants, 1, 2)
        joint[:, s:, s:] = constants
        joint += self._map_errors(system, response)
        by_calibration = self._calibration_errors(at, tracks, system, response)
        # the depth that is put there has the same errors of the calibration
        of_poses = joint[:, POSE, POSE].copy()
        joint += by_calibration @ np.swapaxes(by_calibration, 1, 2)
        derivative = axes_derivative(self.data.form, at)
        turn = nearest_half_turn(derivative.R_GP, of_keys.mass.R_GP)
        R_GP = derivative.R_GP @ turn
        flip = np.concatenate([np.ones(6), np.diag(turn), np.diag(turn)])
        T = state_jacobians(at, derivative, self.data.camera_N)
        covariance = (T @ joint @ np.swapaxes(T, 1, 2)) * np.outer(flip, flip)
        # what the motion does not determine in a key frame, it does not in the frames about it
        nearest = np.abs(np.arange(n)[:, None] - keys[None, :]).argmin(axis=1)
        lost = np.isinf(np.diagonal(of_keys.covariance, axis1=1, axis2=2))[nearest]
        covariance = np.stack([with_infinite(c, gone) for c, gone in zip(covariance, lost, strict=True)])
        body = with_constants(body_jacobians(at, self.data.camera_N)[-1], joint[-1])
        of_marks = mark_jacobians(at, R_GP, self.data.camera_N)
        last = with_constants(np.diag(flip) @ T[-1], joint[-1])
        calibration = of_keys.calibration
        if calibration is not None:
            share = by_calibration[-1] @ by_calibration[-1].T
            last_joint = with_constants(np.diag(flip) @ T[-1], share)
            calibration = replace(calibration, last_joint=last_joint, poses=by_calibration[:, POSE])
        last_lost = np.isinf(np.diagonal(of_keys.covariance_last_joint))
        to_G = np.zeros((n, N_POSE, N_POSE))
        to_G[:, POSITION, POSITION] = np.swapaxes(at.R_NG, 1, 2)
        to_G[:, ROTATION, ROTATION] = np.eye(3)
        pose = to_G @ of_poses @ np.swapaxes(to_G, 1, 2)
        r = self.residuals(at)
        squared = np.sum(r**2, axis=1)
        weight = np.where(squared < STEREO_GATE**2, robust_weight(squared, self.data.robust_scale), 0.0)
        true = FrameStates.of(at, self.data.camera_N)
        found = replace(
            of_keys,
            timestamps_ns=tracks.timestamps_ns,
            r_N=true.centres(),
            v_N=at.v_N,
            R_NP=true.true_attitudes() @ R_GP,
            w_P=at.w_G @ R_GP,
            X_NG=make_pose(at.R_NG, at.p_NG),
            covariance=covariance,
            covariance_last_joint=with_infinite(last, last_lost),
            covariance_last_body=body,
            covariance_X_NG=pose,
            covariance_of_marks=of_marks @ joint @ np.swapaxes(of_marks, 1, 2),
            residuals_px=self.data.unsorted(r / self.data.inv_sigma),
            inlier_weight=self.data.unsorted(weight),
            calibration=calibration,
        )
        # the mass properties of the key frames have the errors that all frames share already
        shared = SharedErrors(config.systematic_px)
        return replace(with_systematic(found, tracks, shared), mass=of_keys.mass)

    def _map_errors(self, system: "_System", response: Array) -> Array:
        """Covariance (F, s + 8, s + 8) of states and constants by the errors of the landmarks, by draws."""
        d, (n, s) = self.data, system.g.shape
        rng = np.random.default_rng(0)
        errors = np.linalg.cholesky(self.known.covariance) @ rng.standard_normal(
            (len(self.known.covariance), 3, DRAWS)
        )
        pull = np.zeros((n, s, DRAWS))
        np.add.at(pull[:, POSE], d.frame, system.E @ errors[d.landmark])
        effect = system.moved_by(pull, response)
        return np.asarray(effect @ np.swapaxes(effect, 1, 2) / DRAWS)

    def _calibration_errors(
        self, at: Iterate, tracks: StereoTracks, system: "_System", response: Array
    ) -> Array:
        """Changes (F, s + 8, c) of states and constants by one sigma of each error of the calibration."""
        d, fit = self.data, MotionFit(self.data, at)
        effect, moved = whitened_effects(fit, tracks), self.known.by_calibration
        if not moved.shape[2]:
            return np.zeros((at.n_frames, at.n_state + N_CONSTANTS, 0))
        weight = robust_weight(np.sum(self.residuals(at) ** 2, axis=1), d.robust_scale)
        seen = LinearObservations(*observation_jacobians(fit), weight, effect, d.frame, d.landmark)
        pull = np.zeros((at.n_frames, at.n_state, effect.shape[2]))
        pull[:, POSE] = seen.gradient(moved, at.n_frames)
        return system.moved_by(pull, response)


@dataclass(frozen=True)
class _System:
    D: Array
    """(F, s, s) information on each state"""
    U: Array
    """(F - 1, s, s) between a state and the next"""
    g: Array
    """(F, s) gradient"""
    across: Array
    """(F, s, 8) between states and constants"""
    H_c: Array
    """(8, 8) information on the constants"""
    g_c: Array
    """(8,) gradient"""
    E: Array
    """(M, 6, 3) coupling of poses and landmarks"""

    def of_constants(self, response: Array) -> Array:
        """Information (8, 8) on the constants, the states eliminated; response (F, s, 8) of the states."""
        return np.asarray(self.H_c + np.einsum("fsc,fsd->cd", self.across, response))

    def moved_by(self, pull: Array, response: Array) -> Array:
        """Changes (F, s + 8, c) of states and constants by changes (F, s, c) of the states' gradient."""
        alone = -_solve_chain(self.D, self.U, pull)
        force = np.einsum("fsc,fsr->cr", self.across, alone)
        constants = -np.linalg.solve(self.of_constants(response), force)
        everywhere = np.broadcast_to(constants, (len(pull), *constants.shape))
        return np.concatenate([alone + response @ constants, everywhere], axis=1)

    def step(self) -> Array:
        """The Gauss-Newton step (s F + 8,)."""
        both = -_solve_chain(self.D, self.U, np.concatenate([self.across, self.g[:, :, None]], axis=2))
        response, alone = both[:, :, :-1], both[:, :, -1]
        force = self.g_c + np.einsum("fsc,fs->c", self.across, alone)
        constants = -np.linalg.solve(self.of_constants(response), force)
        return np.concatenate([(alone + response @ constants).ravel(), constants])


def _moved(fixed: LinearizationPoint, step: Array) -> Iterate:
    x = fixed.reference.vector()
    x[: len(step)] += step
    return fixed.reference.moved_to(x)


def _factors(D: Array, U: Array) -> list[tuple[Array, bool]]:
    """Cholesky factors of the Schur complements of all earlier states."""
    out: list[tuple[Array, bool]] = []
    for k, block in enumerate(D):
        left = block if k == 0 else block - U[k - 1].T @ cho_solve(out[-1], U[k - 1], check_finite=False)
        out.append(cho_factor(0.5 * (left + left.T), lower=True))
    return out


def _solve_chain(D: Array, U: Array, right: Array) -> Array:
    """Solution (F, s, c) of the block-tridiagonal system with diagonal D and upper blocks U."""
    factors, x = _factors(D, U), right.copy()
    for k in range(1, len(D)):
        x[k] -= U[k - 1].T @ cho_solve(factors[k - 1], x[k - 1], check_finite=False)
    for k in reversed(range(len(D))):
        later = x[k] - U[k] @ x[k + 1] if k + 1 < len(D) else x[k]
        x[k] = cho_solve(factors[k], later, check_finite=False)
    return x


def _covariances(D: Array, U: Array) -> Array:
    """Diagonal blocks (F, s, s) of the inverse."""
    factors, out, eye = _factors(D, U), np.empty_like(D), np.eye(D.shape[1])
    for k in reversed(range(len(D))):
        out[k] = cho_solve(factors[k], eye, check_finite=False)
        if k + 1 < len(D):
            gain = cho_solve(factors[k], U[k], check_finite=False)
            out[k] += gain @ out[k + 1] @ gain.T
    return out
