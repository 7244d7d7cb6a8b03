"""The sliding window: the causal state with its covariance, frame by frame, in bounded time and memory."""

import logging

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.window.add_frame import first_frame, next_frame
from polhode.backend.window.causal_state import OnlineState, online_state, unknown_state
from polhode.backend.window.estimator_state import EstimatorState, initial_estimator_state
from polhode.backend.window.frame import CameraNoise, FrameMeasurements
from polhode.backend.window.history import History
from polhode.backend.window.ipopt import IpoptSolver
from polhode.backend.window.marginalize import shrink_window
from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.noise_levels import estimate_levels, estimate_noise
from polhode.backend.window.problem import WindowSolver
from polhode.backend.window.solve import choose_inertia, expand_arrival, solve_history, solve_window
from polhode.camera import RectifiedRig
from polhode.config.backend import Backend
from polhode.lie import Array

REESTIMATION_FRAMES = (6, 12, 24, 48, 96, 192, 384, 768)
"""Numbers of frames at which noise levels are estimated and other inertias tried, while the history is
kept."""
MIN_FRAMES_FOR_LEVELS = 20
"""Number of frames from which the level of the disturbances is estimated."""
FIRST_FRAMES = 3
MAX_CONTRADICTED = 0.5
"""Share of contradicting observations above which the estimated motion is rejected."""
KNOWN = 0.02
"""Standard deviation of k1, k2 below which the inertia is good enough for an arrival cost."""

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
        self.solver: WindowSolver = (
            IpoptSolver(config.window.frames + 1) if config.window.solver == "ipopt" else NewtonSolver()
        )
        self._camera = camera or CameraNoise()
        self._rig, self._config = rig, config
        self._axes: Array = np.eye(3)
        self._first_ns: int | None = None
        self._number = 0
        self._missed = 0
        self.state = initial_estimator_state(rig, config, self._camera)

    def add(self, m: FrameMeasurements) -> OnlineState:
        """Add one frame, later than all before; returns its state as known now."""
        if self._first_ns is None:
            self._first_ns = m.timestamp_ns
        time_s = (m.timestamp_ns - self._first_ns) * 1e-9
        self._number += 1
        if not self.state.active.recent:
            return self._begin(m, time_s)
        try:
            online = self._continue(m, time_s)
        except (LinAlgError, ZeroDivisionError) as error:
            return self._restart(m, time_s, str(error))
        if self.state.contradicted > MAX_CONTRADICTED:
            return self._restart(m, time_s, "most observations contradict it")
        return online

    def _continue(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        frame = next_frame(self.state, m, self._number, time_s)
        if frame is None:
            return self._wait(m, time_s)
        state, history = self.state, self.state.history
        state.active.recent.append(frame)
        if history is not None:
            history.append(frame)
            n = history.n_added
            if n <= 24 or n in REESTIMATION_FRAMES:
                state.update_weak_prior()
            solve_history(state, history)
            if n in REESTIMATION_FRAMES:
                self._reestimate(state, history)
            if self.solver.name != "gauss_newton":
                expand_arrival(state, history)
                solve_window(state, self.solver)
        else:
            state.active.extend_arrival()
            state.add_newest_factor()
            solve_window(state, self.solver)
        online = self._report(m)
        shrink_window(state, self.settings.frames, self.settings.key_frames)
        if history is not None and history.n_added >= self.settings.history:
            if np.diag(online.cov_k).max() < KNOWN**2:
                self._drop_history(state, history)
            else:
                history.thin(state.active, self.settings.history)
        return online

    def _drop_history(self, state: EstimatorState, history: History) -> None:
        """Replace the history by an arrival cost."""
        expand_arrival(state, history)
        for frame in (*state.active.keys, state.active.recent[0]):
            frame.fix_linearization()
        state.history = None

    def _reestimate(self, state: EstimatorState, history: History) -> None:
        """Estimate what is fixed while solving: noise, disturbances, the choice among inertias."""
        estimate_noise(state)
        solve_history(state, history)
        if self._config.process_noise == "estimated" and len(history.frames) >= MIN_FRAMES_FOR_LEVELS:
            estimate_levels(state, history, (self._config.accel_psd, self._config.torque_psd))
        choose_inertia(state, history)
        solve_history(state, history)

    def _begin(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """Start with the first frame with measurements: the motion is still unknown."""
        state = self.state
        if len(m.landmark) < FIRST_FRAMES:
            return unknown_state(m.timestamp_ns, m.X_NR)
        frame = first_frame(state, m, self._number, time_s)
        radius = state.update_weak_prior()
        state.active.constants[:3] = state.weak_prior[:3]
        state.active.recent.append(frame)
        state.history = History(frame, state.gauge_information(radius))
        return unknown_state(m.timestamp_ns, m.X_NR, frame, state.active.constants[:3])

    def _wait(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """The frame cannot be located yet. If this continues, the first frames are wrong: restart."""
        self._missed += len(m.landmark) >= FIRST_FRAMES
        active = self.state.active
        online = unknown_state(m.timestamp_ns, m.X_NR, active.recent[-1], active.constants[:3])
        if self._missed > 2:
            return self._restart(m, time_s, "its first frames had nothing in common with those that follow")
        return online

    def _restart(self, m: FrameMeasurements, time_s: float, why: str) -> OnlineState:
        """Forget everything and start again, with a new frame G."""
        level = logging.WARNING if self.state.inertia_known else logging.INFO
        _log.log(level, "sliding window: restarted at %.2f s, %s", time_s, why)
        self._missed, self.state = 0, initial_estimator_state(self._rig, self._config, self._camera)
        return self._begin(m, time_s)

    def _report(self, m: FrameMeasurements) -> OnlineState:
        state, active = self.state, self.state.active
        assert state.last is not None
        online = online_state(
            m.timestamp_ns,
            active.recent[-1],
            active.constants,
            state.R_inertia,
            state.shape.form,
            state.last,
            np.stack([frame.x[9:12] for frame in active.recent]),
            self._axes,
        )
        self._axes = online.R_GP
        state.inertia_known = bool(online.determined[:2].all())
        return online
