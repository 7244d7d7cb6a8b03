"""The sliding window: the causal state with its covariance, frame by frame, in bounded time and memory."""

import logging
from dataclasses import fields, replace
from time import perf_counter

import numpy as np
from scipy.linalg import LinAlgError
from scipy.spatial.transform import Rotation

from polhode.backend.outliers_and_noise.systematic import (
    SharedErrors,
    body_with_systematic,
    online_with_systematic,
)
from polhode.backend.problem.iterate import COM, POSITION, RATE
from polhode.backend.uncertainty.covariance import with_infinite
from polhode.backend.window.add_frame import (
    MIN_COMMON_LANDMARKS,
    MIN_FRAMES_FOR_DYNAMICS,
    first_frame,
    next_frame,
    pose_in_map,
)
from polhode.backend.window.causal_state import (
    BodyState,
    OnlineState,
    body_state,
    iterate_of_frame,
    online_state,
    unknown_state,
)
from polhode.backend.window.estimator_state import EstimatorState, initial_estimator_state, shrink_window
from polhode.backend.window.frame import CameraNoise, FrameMeasurements, camera_noise_of, frames_of
from polhode.backend.window.frame_of_reference import FrameOfReference
from polhode.backend.window.history import History
from polhode.backend.window.judge import Judge, Judgement
from polhode.backend.window.problem import IpoptSolver
from polhode.backend.window.solve import (
    choose_inertia,
    estimate_levels,
    estimate_noise,
    solve_history,
    solve_window,
)
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, exp_so3, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_body import HALF_TURNS
from polhode.records.calibration_effects import CalibrationEffects
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.records.tracks import StereoTracks, Wrench
from polhode.runtime.progress import Progress
from polhode.runtime.threads import single_threaded

REESTIMATION_FRAMES = (6, 12, 24, 48, 96, 192, 384, 768)
"""Numbers of frames at which noise levels are estimated and other inertias tried, while the history is
kept."""
MIN_FIRST_OBSERVATIONS = 3
"""Observations of a frame that may define G, or that counts as missed if it cannot be located."""
MAX_CONTRADICTED_SHARE = 0.5
"""Share of contradicting observations above which the estimated motion is rejected."""
MAX_RATIO_SIGMA = 0.02
"""Standard deviation of k1, k2 below which the inertia is good enough for an arrival cost."""
WARM_UP_FRAMES = 24
"""Noise levels are estimated and other inertias tried after 6, 12 and 24 frames."""

UNKNOWN = Judgement(False, "no motion is known yet")
_log = logging.getLogger(__name__)


class SlidingWindow:
    """Causal estimator: ``add`` each frame as it comes.

    Unknowns: the states of the latest ``frames`` frames, the poses of at most ``key_frames`` earlier ones,
    com_G and the inertia; landmarks are eliminated. Older unknowns are marginalized into an arrival cost. The
    first ``history`` frames, and further ones until the inertia is known, are solved as a whole.
    """

    def __init__(self, rig: RectifiedRig, config: Backend, camera: CameraNoise | None = None) -> None:
        """camera: noise of the stated camera poses; None: they are exact."""
        self.settings = config.window
        ipopt = config.window.solver == "ipopt"
        self.answer = IpoptSolver(config.window.frames + 1) if ipopt else None
        """Continues where Gauss-Newton ends; None: Gauss-Newton's answer stands"""
        self.updates = 0
        """Frames after which the window was solved"""
        self.answered = 0
        """Those of them whose result is the optimum of ``answer``"""
        self._camera = camera or CameraNoise()
        self._rig, self._config = rig, config
        self._axes: Array = np.eye(3)
        self._first_ns: int | None = None
        self._number = 0
        self._missed = 0
        self._lost: EstimatorState | None = None
        """What was forgotten last, until a new frame G refers to it"""
        self._judge = Judge()
        self.judgement = UNKNOWN
        """Of the latest frame"""
        self.restarts = 0
        """How often everything was forgotten: each time with a new frame G"""
        self.frame: FrameOfReference | None = None
        """The present frame G; None: no pair has fixed it yet"""
        self.state = initial_estimator_state(rig, config, self._camera)

    @property
    def accepted(self) -> int:
        """Number of observations of the latest frame that agree with the motion."""
        recent = self.state.active.recent
        return len(recent[-1].slot) if recent and recent[-1].number == self._number else 0

    @property
    def accepted_landmarks(self) -> Ints:
        """(accepted,) the landmarks that they are of."""
        if not self.accepted:
            return np.zeros(0, dtype=np.int64)
        return np.asarray(self.state.landmarks.name[self.state.active.recent[-1].slot])

    @property
    def landmarks_G(self) -> Array:
        """(L, 3) landmarks of the frames that are kept, in the present frame G [m]."""
        landmarks = self.state.landmarks
        return np.array(landmarks.p_G[landmarks.used])

    @property
    def sigma_rate(self) -> float:
        """Standard deviation [rad/s] of the size of the latest angular velocity; inf: it is unknown.

        It is known long before the axes are, along which the state has its components.
        """
        last, recent = self.state.last, self.state.active.recent
        rate = float(np.linalg.norm(recent[-1].x[RATE])) if recent else 0.0
        if last is None or rate == 0.0:
            return float("inf")
        along = recent[-1].x[RATE] / rate
        return float(np.sqrt(along @ np.linalg.inv(last.joint)[RATE, RATE] @ along))

    def body_state(self) -> BodyState | None:
        """The body itself at the latest frame; None: no motion is known."""
        state, active = self.state, self.state.active
        if state.last is None or not active.recent or active.recent[-1].number != self._number:
            return None
        *before, now = active.frames
        past_s = np.array([frame.time_s - now.time_s for frame in reversed(before)])
        past_R_NG = np.array([frame.R_NG for frame in reversed(before)]).reshape(-1, 3, 3)
        at = iterate_of_frame(now, active.constants, state.R_inertia)
        return body_state(at, state.prior.form, state.last, state.disturbances, (past_s, past_R_NG))

    def predict(self, timestamp_ns: int) -> Array | None:
        """X_NG (4, 4) at a time after the latest frame, by the dynamics; None: the motion is unknown."""
        if self._first_ns is None or len(self.state.active.frames) < 2:
            return None
        x, R_NG = self.state.predict(self._time_s(timestamp_ns))
        return make_pose(R_NG, x[POSITION])

    def _time_s(self, timestamp_ns: int) -> float:
        """Since the first frame, by stamps that are corrected for the jumps of the clock that were found."""
        return (timestamp_ns - (self._first_ns or 0)) * 1e-9 + self._judge.offset_s

    def add(self, m: FrameMeasurements) -> OnlineState:
        """Add one frame, later than all before; returns its state as known now."""
        if self._first_ns is None:
            self._first_ns = m.timestamp_ns
        time_s = self._time_s(m.timestamp_ns)
        self._number += 1
        self.judgement = UNKNOWN
        return replace(self._added(m, time_s), frame=self.restarts)

    def _added(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        if not self.state.active.recent:
            return self._begin(m, time_s)
        try:
            online = self._continue(m, time_s)
        except (LinAlgError, ZeroDivisionError) as error:
            return self._restart(m, time_s, str(error))
        if self.state.contradicted > MAX_CONTRADICTED_SHARE:
            return self._restart(m, time_s, "most observations contradict it")
        return online

    def _continue(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        n_known = int(np.sum(self.state.landmarks.find(m.landmark) >= 0))
        frame = next_frame(self.state, m, self._number, time_s)
        if frame is None:
            return self._wait(m, time_s)
        state, history = self.state, self.state.history
        state.active.recent.append(frame)
        if history is not None:
            history.append(frame)
        else:
            state.active.extend_arrival()
        contradicts = n_known >= MIN_COMMON_LANDMARKS and len(frame.slot) == 0
        self.judgement = self._judge.judge(state, contradicts)
        if history is not None:
            n = history.n_added
            if n <= 24 or n in REESTIMATION_FRAMES:
                state.update_weak_prior()
            if n in REESTIMATION_FRAMES:
                solve_history(state, history)
                is_answered = self._reestimate(state, history)
            else:
                is_answered = solve_history(state, history, self.answer)
        else:
            state.add_newest_step()
            is_answered = solve_window(state, self.answer)
        self.updates, self.answered = self.updates + 1, self.answered + is_answered
        online = self._report(m)
        shrink_window(state, self.settings.frames, self.settings.key_frames)
        if history is not None and history.n_added >= self.settings.history:
            if np.diag(online.cov_k).max() < MAX_RATIO_SIGMA**2:
                history.expand_arrival(state.active, state.prior.form, state.R_inertia)
                for frame in (*state.active.keys, state.active.recent[0]):
                    frame.fix_linearization()
                state.history = None
            else:
                history.thin(state.active, self.settings.history)
        return online

    def _reestimate(self, state: EstimatorState, history: History) -> bool:
        """Estimate what is fixed while solving: noise, disturbances, the choice among inertias."""
        estimate_noise(state)
        solve_history(state, history)
        if self._config.process_noise == "estimated":
            estimate_levels(state, history)
        choose_inertia(state, history)
        return solve_history(state, history, self.answer)

    def _begin(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """Start with the first frame with measurements: the motion is still unknown."""
        state = self.state
        if len(m.landmark) < MIN_FIRST_OBSERVATIONS:
            return unknown_state(m.timestamp_ns, m.X_NR)
        frame = first_frame(state, m, self._number, time_s)
        state.active.recent.append(frame)
        self._name_frame(m)
        radius = state.update_weak_prior()
        state.active.constants[COM] = state.weak_prior[:3]
        state.history = History(frame, state.gauge_information(radius))
        return unknown_state(m.timestamp_ns, m.X_NR, frame, state.active.constants[COM])

    def _wait(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """The frame cannot be located yet. If this continues, the first frames are wrong: restart."""
        self._missed += len(m.landmark) >= MIN_FIRST_OBSERVATIONS
        active = self.state.active
        online = unknown_state(m.timestamp_ns, m.X_NR, active.recent[-1], active.constants[COM])
        if self._missed > 2:
            return self._restart(m, time_s, "its first frames had nothing in common with those that follow")
        return online

    def _restart(self, m: FrameMeasurements, time_s: float, why: str) -> OnlineState:
        """Forget everything and start again, with a new frame G."""
        level = logging.WARNING if self.state.inertia_known else logging.INFO
        _log.log(level, "sliding window: restarted at %.2f s, %s", time_s, why)
        self.restarts += 1
        self._lost, self._judge = self.state, Judge(self._judge.offset_s)
        self._missed, self.state = 0, initial_estimator_state(self._rig, self._config, self._camera)
        online = self._begin(m, time_s)
        where = "no frame G yet" if self.frame is None else self.frame.words
        self.judgement = Judgement(False, f"the motion was lost, {why}; begun again: {where}")
        return online

    def _name_frame(self, m: FrameMeasurements) -> None:
        """A new frame G, and where it is in the one before, if the map that was lost shows what this pair
        shows."""
        lost, before, self._lost = self._lost, self.frame, None
        self.frame = FrameOfReference(f"G@{m.timestamp_ns}")
        if before is None or lost is None or len(lost.active.frames) < MIN_FRAMES_FOR_DYNAMICS:
            # what there was of a map was none
            return
        self.frame = replace(self.frame, before=before.name)
        found = pose_in_map(lost, m, self._number)
        if found is not None:
            X = inverse_pose(m.X_NR @ found[0]) @ self.state.active.recent[-1].X_NG_seen
            self.frame = replace(self.frame, X_before=X, covariance=found[1])
            # the choice among the half-turns of the axes goes on
            self._axes = X[:3, :3].T @ self._axes

    def _report(self, m: FrameMeasurements) -> OnlineState:
        state, active = self.state, self.state.active
        assert state.last is not None
        online = online_state(
            m.timestamp_ns,
            iterate_of_frame(active.recent[-1], active.constants, state.R_inertia),
            active.recent[-1].X_NG_seen,
            state.prior.form,
            state.last,
            np.stack([frame.x[RATE] for frame in active.recent]),
            self._axes,
        )
        self._axes = online.R_GP
        state.inertia_known = bool(online.determined[:2].all())
        return online


@single_threaded
def estimate_online(tracks: StereoTracks, config: Backend, progress: Progress) -> OnlineEstimate:
    """Process the frames in the order of time. A row depends only on its frame and earlier ones."""
    window = SlidingWindow(tracks.rig, config, camera_noise_of(tracks))
    states, seconds = [], []
    with progress.stage("sliding window", tracks.n_frames) as advance:
        for measurements in frames_of(tracks):
            begin = perf_counter()
            states.append(window.add(measurements))
            seconds.append(perf_counter() - begin)
            advance()
    _log.info("window: median %.0f ms a frame, %.1f s in all", 1e3 * np.median(seconds), sum(seconds))
    if window.answer is not None and window.updates:
        _log.info("window: %d of %d answers by IPOPT", window.answered, window.updates)
    online = online_estimate(states, tracks.rig, tracks.X_NR, config, tracks.calibration)
    return online if tracks.wrench is None else without_claims_after_torques(online, tracks.wrench)


def online_estimate(
    states: list[OnlineState],
    rig: RectifiedRig,
    X_NR: Array,
    config: Backend,
    calibration: CalibrationEffects | None = None,
) -> OnlineEstimate:
    """One record of states with the errors that all landmarks share; X_NR (F, 4, 4): the left camera.

    A row depends on its state, the one before and the first one of which something is known only.
    """
    return online_with_systematic(stack_states(states), rig, X_NR, _shared_errors(config), calibration)


def body_estimate(
    body: BodyState,
    states: list[OnlineState],
    rig: RectifiedRig,
    X_NR: Array,
    config: Backend,
    calibration: CalibrationEffects | None = None,
) -> BodyState:
    """The body itself with the errors that all landmarks share; the rest as for ``online_estimate``, whose
    last row is of the same frame.
    """
    online, shared = stack_states(states), _shared_errors(config)
    return replace(
        body, covariance=body_with_systematic(body.covariance, online, rig, X_NR, shared, calibration)
    )


def _shared_errors(config: Backend) -> SharedErrors:
    light_px = config.light_px if config.correlated_errors == "slide" else 0.0
    return SharedErrors(config.systematic_px, light_px)


def without_claims_after_torques(online: OnlineEstimate, wrench: Wrench) -> OnlineEstimate:
    """Nothing is claimed of inertia, axes, attitude and rate from the first known torque on.

    The window assumes free motion: what the torque does seems to be the inertia's doing.
    """
    acting = wrench.time_ns[wrench.torque_P.any(axis=1)]
    if not len(acting):
        return online
    after = online.timestamps_ns > acting[0]
    unknown = {
        "covariance": np.repeat([False, True], 6),
        "cov_k": np.ones(2, dtype=np.bool_),
        "cov_R_GP": np.ones(3, dtype=np.bool_),
    }
    changed = {
        name: np.stack([
            with_infinite(c, lost) if late else c
            for c, late in zip(getattr(online, name), after, strict=True)
        ])
        for name, lost in unknown.items()
    }  # fmt: skip
    return replace(online, **changed)


def window_warnings(n_frames: int, config: Backend) -> list[str]:
    """Warnings about settings that do not suit the sequence, one line each."""
    window = config.window
    if not window.enabled or window.frames <= n_frames:
        return []
    return [
        f"backend.window.frames: the sliding window of {window.frames} frames is longer than the sequence of "
        f"{n_frames}; the causal estimate smooths all frames so far"
    ]


def stack_states(states: list[OnlineState]) -> OnlineEstimate:
    """One record of the states of all frames."""
    names = (each.name for each in fields(OnlineEstimate) if each.name != "timestamps_ns")
    stacked = {name: np.stack([getattr(state, name) for state in states]) for name in names}
    return OnlineEstimate(np.array([s.timestamp_ns for s in states], dtype=np.int64), **stacked)


def align_online_estimate(online: OnlineEstimate, final: MotionEstimate) -> OnlineEstimate:
    """Express the causal estimate in the frame G and with the half-turns of the final one.

    This changes conventions only and adds no information. Each row takes the half-turn of the axes that is
    nearest to the final attitude at its frame. Frames G differ from the final one by a constant: the mean
    over the last ten rows of each is taken.
    """
    X_FG = np.tile(np.eye(4), (len(online.frame), 1, 1))
    for number in np.unique(online.frame):
        rows = np.flatnonzero(online.frame == number)
        X = inverse_pose(final.X_NG[rows[-10:]]) @ online.X_NG[rows[-10:]]
        X_FG[rows, :3, :3] = Rotation.from_matrix(X[:, :3, :3]).mean().as_matrix()
        X_FG[rows, :3, 3] = np.median(X[:, :3, 3], axis=0)
    R = X_FG[:, :3, :3]
    along = np.einsum("fij,fij->fj", online.R_NP, final.R_NP)
    turn: Array = HALF_TURNS[np.argmax(along @ HALF_TURNS.T, axis=1)]
    sign = np.concatenate([np.ones((len(turn), 6)), turn, turn], axis=1)
    return replace(
        online,
        R_NP=online.R_NP * turn[:, None, :],
        w_P=online.w_P * turn,
        covariance=online.covariance * sign[:, :, None] * sign[:, None, :],
        X_NG=online.X_NG @ inverse_pose(X_FG),
        com_G=transform_points(X_FG, online.com_G[:, None])[:, 0],
        cov_com_G=_turned(online.cov_com_G, R),
        R_GP=R @ online.R_GP * turn[:, None, :],
        cov_R_GP=online.cov_R_GP * turn[:, :, None] * turn[:, None, :],
    )


def _turned(covariance: Array, R: Array) -> Array:
    """Covariances (F, 3, 3) in other axes, by R (F, 3, 3); components that involve an undetermined one are
    undetermined."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    lost = ~np.isfinite(variance)
    finite = np.where(lost[:, :, None] | lost[:, None, :], 0.0, covariance)
    out = R @ finite @ np.swapaxes(R, 1, 2)
    touched = (np.abs(R) * lost[:, None, :]).max(axis=2) > 0.1
    out[touched[:, :, None] | touched[:, None, :]] = 0.0
    rows, components = np.nonzero(touched)
    out[rows, components, components] = np.inf
    return np.asarray(out)


def warm_up(rig: RectifiedRig, config: Backend) -> None:
    """Compile what the window needs before the first frame comes: it would wait for seconds there.

    A window of its own sees a body that turns; what is compiled stays for all others.
    """
    rng, window = np.random.default_rng(0), SlidingWindow(rig, config)
    names = np.arange(40, dtype=np.int64)
    p_G = rng.uniform(-0.1, 0.1, (len(names), 3))
    sigma = np.full((len(names), 3), 0.3)
    for k in range(WARM_UP_FRAMES):
        X_RG = make_pose(exp_so3([0.05 * k, 0.3 * k, 0.0]), [0.0, 0.0, 1.0])
        uvd = rig.project(transform_points(X_RG, p_G)) + sigma * rng.standard_normal((len(names), 3))
        window.add(FrameMeasurements(500_000_000 * k, np.eye(4), names, uvd, sigma))
