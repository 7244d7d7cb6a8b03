"""Frames, landmarks, constants and noise levels of the window; the choice of key frames, marginalization."""

from dataclasses import dataclass, field
from operator import is_

import numpy as np

from polhode.backend.dynamics.propagation import propagate_rotations, series_steps
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import FORMS, inertia_from_second_moments
from polhode.backend.problem.iterate import (
    COM,
    N_CONSTANTS,
    N_POSE,
    N_STATE,
    POSITION,
    RATE,
    ROTATION,
    VELOCITY,
    XI,
)
from polhode.backend.problem.level_prior import LevelPrior
from polhode.backend.problem.motion_data import rig_vector
from polhode.backend.solvers.gauss_newton import WeakPrior
from polhode.backend.solvers.linearization_point import COM_PRIOR_M, middle_and_radius
from polhode.backend.solvers.robust_kernel import robust_gain
from polhode.backend.window.causal_state import LastInformation
from polhode.backend.window.frame import (
    STEREO_GATE,
    CameraNoise,
    CondensedVision,
    Frame,
    FrameMeasurements,
    FramePoses,
    LandmarkSlots,
    ObservationModel,
    WindowObservations,
    condense,
    gather_observations,
    information_of,
    residuals,
)
from polhode.backend.window.history import ActiveWindow, History
from polhode.backend.window.problem import DisturbanceLevels, Quadratic, WindowProblem, whitened_steps
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, matrix_from_wxyz

GAUGE_SIGMA = 1e-5
"""Standard deviation with which G is fixed at the first frame [rad, radii of the target]."""


@dataclass
class EstimatorState:
    """Frames, landmarks and constants, and the noise levels that weight them."""

    rig: RectifiedRig
    model: ObservationModel
    prior: WeakPrior
    level_prior: LevelPrior
    disturbances: DisturbanceLevels
    """as stated, until they are estimated"""
    landmarks: LandmarkSlots = field(default_factory=LandmarkSlots)
    active: ActiveWindow = field(default_factory=ActiveWindow)
    history: History | None = None
    """the first frames as a whole; None once an arrival cost has replaced them"""
    R_inertia: Array = field(default_factory=lambda: np.eye(3))
    weak_prior: Array = field(default_factory=lambda: np.zeros(13))
    """parameters of ``kernels.prior_kernel``"""
    noise: Array = field(default_factory=lambda: np.ones(3))
    """factors on the stated standard deviations of u, v and disparity"""
    camera: CameraNoise = field(default_factory=CameraNoise)
    inertia_known: bool = False
    """whether both ratios were determined at the last frame"""
    contradicted: float = 0.0
    """share of the observations that contradict the last solution"""
    last: LastInformation | None = None
    """about the newest state and the constants"""
    _observations: WindowObservations | None = None
    _gathered: list[Array] = field(default_factory=list)

    @property
    def second_moments(self) -> Array:
        """(3, 3) in G."""
        return self.prior.form.second_moments(self.active.constants[XI], self.R_inertia)

    @property
    def J_G(self) -> Array:
        """(3, 3) up to scale."""
        return inertia_from_second_moments(self.second_moments)

    @property
    def J_noise(self) -> Array:
        """(3, 3) inertia by which a torque disturbs the rates: a sphere's until the ratios are determined.

        Otherwise a guess that is too elongated weakens the dynamics about its axis, so that no residual
        contradicts it.
        """
        return self.J_G if self.inertia_known else np.eye(3)

    def observations(self) -> WindowObservations:
        """Observations of the landmarks that are seen more than once."""
        # any change of the observations of a frame replaces this array
        now = [frame.inv_sigma for frame in self.active.frames]
        same = len(now) == len(self._gathered) and all(map(is_, now, self._gathered))
        if self._observations is None or not same:
            self._observations = gather_observations(self.active.frames, len(self.landmarks))
            self._gathered = now
        return self._observations

    def condensed(self) -> CondensedVision:
        """The observations linearized at the present unknowns, landmarks eliminated."""
        observations, poses = self.observations(), FramePoses(self.active.frames)
        return condense(observations, poses, self.model, self.landmarks.p_G[observations.slot])

    def problem(self, vision: Quadratic, R_ref: Array, steps: Steps) -> WindowProblem:
        """The program of some states, with the present prior."""
        return WindowProblem(vision, R_ref, steps, self.weak_prior, self.prior)

    def move_landmarks(self, condensed: CondensedVision, step: Array, n_fixed: int = 0) -> None:
        """Move the landmarks with the step (6 F,) of the poses; those seen once move with their frame.

        The first ``n_fixed`` frames keep their reference attitudes, on which an arrival cost depends.
        """
        slot = condensed.observations.slot
        self.landmarks.p_G[slot] += condensed.landmark_steps(step)
        self.landmarks.covariance[slot] = condensed.C_inv
        frames = self.active.frames
        for frame in frames[n_fixed:]:
            frame.recenter()
        slot = np.concatenate([frame.slot for frame in frames])
        once = self.landmarks.views[slot] == 1
        of = np.repeat(np.arange(len(frames)), [len(frame.slot) for frame in frames])[once]
        p_R = self.rig.triangulate(np.concatenate([frame.uvd_px for frame in frames])[once])
        poses = FramePoses(frames)
        p_N = p_R - poses.t_R[of] - np.einsum("mij,mj->mi", poses.R_RN[of], poses.p_NG[of])
        self.landmarks.p_G[slot[once]] = np.einsum("mji,mj->mi", poses.A[of], p_N)

    def update_weak_prior(self) -> float:
        """Expect the centre of mass in the middle of the landmarks. Returns their radius [m]."""
        middle, radius = middle_and_radius(self.landmarks.p_G[self.landmarks.used])
        sigma = max(COM_PRIOR_M, radius)
        self.weak_prior = np.concatenate([middle, [sigma], self.R_inertia.T.ravel()])
        return radius

    def set_inertia(self, second_moments: Array) -> None:
        """Set the inertia, second moments (3, 3) in G, and its reference."""
        xi, self.R_inertia = self.prior.form.coordinates(second_moments)
        self.weak_prior[4:] = self.R_inertia.T.ravel()
        self.active.constants = np.concatenate([self.active.constants[COM], xi])

    def gauge_information(self, radius_m: float) -> Array:
        """(6,) information of the prior on the first pose."""
        return np.repeat([(GAUGE_SIGMA * max(radius_m, 1e-3)) ** -2, GAUGE_SIGMA**-2], 3)

    def predict(self, time_s: float) -> tuple[Array, Array]:
        """State (12,) and attitude R_NG (3, 3) at a later time, by the dynamics."""
        last, com_G = self.active.recent[-1], self.active.constants[COM]
        dt = time_s - last.time_s
        w_G = last.x[RATE]
        J_G, dt_s = self.J_G, np.array([dt])
        series = series_steps(w_G[None], J_G, dt_s, self.disturbances.torque_psd)
        q, w_after, _, _ = propagate_rotations(w_G[None], J_G, dt_s, series)
        R_NG = last.R_NG @ matrix_from_wxyz(q[0])
        r_N = last.x[POSITION] + last.R_NG @ com_G + dt * last.x[VELOCITY]
        return np.concatenate([r_N - R_NG @ com_G, np.zeros(3), last.x[VELOCITY], w_after[0]]), R_NG

    def predicted_sigma(self, time_s: float) -> float:
        """Approximate largest standard deviation [rad] of the attitude that ``predict`` gives."""
        if self.last is None:
            return np.inf
        covariance, dt = np.linalg.inv(self.last.joint), time_s - self.active.recent[-1].time_s
        turn = covariance[ROTATION, ROTATION] + dt**2 * covariance[RATE, RATE]
        return float(np.sqrt(np.linalg.eigvalsh(turn)[-1] + self.disturbances.torque_psd * dt**3 / 3.0))

    def frame(self, m: FrameMeasurements, number: int, time_s: float, R_NG: Array, x: Array) -> Frame:
        """A frame at R_NG (3, 3), x (12,), without its observations."""
        information = self.camera.information(m.X_NR, R_NG, x[POSITION])
        return Frame(number, time_s, m.X_NR, R_NG, x, camera_information=information)

    def add_newest_step(self) -> None:
        """Add the dynamics to the newest state, whitened at the present rates."""
        self._add_step(*self.active.recent[-2:])

    def renew_step(self) -> None:
        """Make the latest step again: the time of its frame, or what is doubtful about it, has changed."""
        if self.history is None:
            self.active.steps = self.active.steps.part(slice(0, -1))
            self._add_step(*self.active.recent[-3:-1])

    def _add_step(self, before: Frame, frame: Frame) -> None:
        dt_s = np.array([frame.time_s - before.time_s])
        doubts = np.append(frame.doubts, np.linalg.norm(before.x[VELOCITY]))[None]
        step = whitened_steps(before.x[None, RATE], self.J_G, self.J_noise, dt_s, self.disturbances, doubts)
        self.active.steps = self.active.steps.and_then(step)


def initial_estimator_state(rig: RectifiedRig, config: Backend, camera: CameraNoise) -> EstimatorState:
    """State before the first frame, with the inertia of a sphere."""
    prior = WeakPrior(FORMS[config.inertia])
    model = ObservationModel(rig_vector(rig), config.robust_scale, robust_gain(config.robust_scale))
    level_prior = LevelPrior.of(config)
    state = EstimatorState(rig, model, prior, level_prior, DisturbanceLevels(*level_prior.stated))
    state.camera, state.active.noisy_camera = camera, not camera.exact
    xi, state.R_inertia = prior.form.coordinates(np.eye(3))
    state.active.constants = np.concatenate([np.zeros(N_CONSTANTS - len(xi)), xi])
    return state


def shrink_window(state: EstimatorState, n_recent: int, n_keys: int) -> None:
    """Keep the latest states and the most valuable key poses, at most these numbers."""
    active = state.active
    while len(active.recent) > n_recent:
        dropped = least_valuable(state) if len(active.keys) >= n_keys else None
        if state.history is None:
            _marginalize(state, dropped)
        else:
            if dropped is not None:
                state.history.absorb(active.frames, *_condense(state, dropped))
            active.keys.append(active.recent.pop(0))
        if dropped is not None:
            frame = active.keys.pop(dropped)
            state.landmarks.leave(frame.slot)
            frame.keep(np.zeros(len(frame.slot), bool))


def least_valuable(state: EstimatorState) -> int:
    """Of the key frames and the oldest recent frame, the one whose landmarks are seen most in other frames.

    Each observation counts with its share of the observations of its landmark: a frame that shows a side of
    the target that no other frame shows has its number of landmarks as value.
    """
    candidates = [*state.active.keys, state.active.recent[0]]
    worth = [np.sum(1.0 / state.landmarks.views[frame.slot]) for frame in candidates]
    return int(np.argmin(worth))


def _marginalize(state: EstimatorState, dropped: int | None) -> None:
    """Marginalize velocities and step of the oldest state into the arrival cost; its pose becomes a key."""
    active = state.active
    parts = [active.oldest_step(state.prior.form, state.R_inertia), *active.camera_parts(1)]
    # a seen pose stays when the oldest state becomes a key
    first = active.n_seen + (0 if active.noisy_camera else N_POSE)
    gone = [np.arange(first, active.n_seen + N_STATE)]
    if dropped is not None:
        parts.append((active.seen_entries, *_condense(state, dropped)))
        gone.append(np.arange(N_POSE * dropped, N_POSE * (dropped + 1)))
    active.absorb(parts, np.concatenate(gone))
    active.keys.append(active.recent.pop(0))
    active.steps = active.steps.part(slice(1, None))
    for frame in (active.keys[-1], active.recent[0]):
        frame.fix_linearization()


def _condense(state: EstimatorState, k: int) -> tuple[Array, Array]:
    """Information on all poses, and its gradient, from the observations of frame k alone."""
    frames, p_G = state.active.frames, state.landmarks.p_G
    poses = FramePoses(frames)
    observations = state.observations().common_with(k)
    r = residuals(observations, poses, state.model.rig, p_G[observations.slot])
    wrong = (observations.frame == k) & (np.sum(r**2, axis=1) > STEREO_GATE**2)
    bad = np.zeros(len(observations.slot), bool)
    bad[observations.landmark[wrong]] = True
    observations = observations.select(~bad) if bad.any() else observations
    H, g = information_of(k, observations, poses, state.model, p_G[observations.slot])
    for frame in frames:
        frame.fix_linearization()
    return H, g
