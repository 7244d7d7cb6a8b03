"""The sliding window: frame by frame, the causal state with its covariance, in bounded time and memory."""

import logging

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.window.add_frame import first_frame, next_frame
from polhode.backend.window.causal_state import OnlineState, online_state, unknown_state
from polhode.backend.window.estimator_state import Belief, new_belief
from polhode.backend.window.frame import CameraNoise, FrameMeasurements
from polhode.backend.window.history import History
from polhode.backend.window.ipopt import IpoptSolver
from polhode.backend.window.marginalize import release
from polhode.backend.window.newton import NewtonSolver
from polhode.backend.window.noise_levels import estimate_levels, estimate_noise
from polhode.backend.window.problem import WindowSolver
from polhode.backend.window.solve import choose_basin, expand_arrival, solve_whole, solve_window
from polhode.camera import RectifiedRig
from polhode.config.backend import Backend
from polhode.lie import Array

LOOK_AROUND = (6, 12, 24, 48, 96, 192, 384, 768)
"""Numbers of frames at which other inertias are tried, while the history lasts."""
LEAST_FOR_LEVELS = 20
"""Frames that tell something about disturbances."""
FIRST_FRAMES = 3
MOST_CONTRADICTED = 0.5
"""Share of the observations; above it the motion that was found is none."""
KNOWN = 0.02
"""Standard deviation of k1, k2 at which the inertia is good enough for an arrival cost."""

_log = logging.getLogger(__name__)


class SlidingWindow:
    """Causal estimator: ``add`` each frame as it comes.

    Unknowns: the states of the latest ``frames`` frames, the poses of at most ``key_frames`` earlier ones,
    com_G and the inertia; landmarks are eliminated. What leaves goes to an arrival cost by marginalization.
    The first ``history`` frames are solved as a whole, and those that follow until the inertia is known.
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
        self.belief = new_belief(rig, config, self._camera)

    def add(self, m: FrameMeasurements) -> OnlineState:
        """Take one frame, later than all before; its state as known now."""
        if self._first_ns is None:
            self._first_ns = m.timestamp_ns
        time_s = (m.timestamp_ns - self._first_ns) * 1e-9
        self._number += 1
        if not self.belief.active.recent:
            return self._begin(m, time_s)
        try:
            state = self._continue(m, time_s)
        except (LinAlgError, ZeroDivisionError) as error:
            return self._begin_anew(m, time_s, str(error))
        if self.belief.contradicted > MOST_CONTRADICTED:
            return self._begin_anew(m, time_s, "most observations contradict it")
        return state

    def _continue(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        frame = next_frame(self.belief, m, self._number, time_s)
        if frame is None:
            return self._wait(m, time_s)
        belief, history = self.belief, self.belief.history
        belief.active.recent.append(frame)
        if history is not None:
            history.append(frame)
            n = history.came
            if n <= 24 or n in LOOK_AROUND:
                belief.renew_weak_prior()
            solve_whole(belief, history)
            if n in LOOK_AROUND:
                self._look_around(belief, history)
            if self.solver.name != "gauss_newton":
                expand_arrival(belief, history)
                solve_window(belief, self.solver)
        else:
            belief.active.make_room()
            belief.link_newest()
            solve_window(belief, self.solver)
        state = self._report(m)
        release(belief, self.settings.frames, self.settings.key_frames)
        if history is not None and history.came >= self.settings.history:
            if np.diag(state.cov_k).max() < KNOWN**2:
                self._leave(belief, history)
            else:
                history.thin(belief.active, self.settings.history)
        return state

    def _leave(self, belief: Belief, history: History) -> None:
        """From now on an arrival cost stands for the history."""
        expand_arrival(belief, history)
        for frame in (*belief.active.keys, belief.active.recent[0]):
            frame.fix_linearization()
        belief.history = None

    def _look_around(self, belief: Belief, history: History) -> None:
        """What is held while solving is estimated anew: noise, disturbances, the basin of the inertia."""
        estimate_noise(belief)
        solve_whole(belief, history)
        if self._config.process_noise == "estimated" and len(history.frames) >= LEAST_FOR_LEVELS:
            estimate_levels(belief, history, (self._config.accel_psd, self._config.torque_psd))
        choose_basin(belief, history)
        solve_whole(belief, history)

    def _begin(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """The first frame with measurements: nothing is known of the motion."""
        belief = self.belief
        if len(m.landmark) < FIRST_FRAMES:
            return unknown_state(m.timestamp_ns, m.X_NR)
        frame = first_frame(belief, m, self._number, time_s)
        radius = belief.renew_weak_prior()
        belief.active.constants[:3] = belief.weak_prior[:3]
        belief.active.recent.append(frame)
        belief.history = History(frame, belief.gauge_information(radius))
        return unknown_state(m.timestamp_ns, m.X_NR, frame, belief.active.constants[:3])

    def _wait(self, m: FrameMeasurements, time_s: float) -> OnlineState:
        """The frame cannot be placed yet. When that goes on, the first ones were at fault: begin anew."""
        self._missed += len(m.landmark) >= FIRST_FRAMES
        active = self.belief.active
        state = unknown_state(m.timestamp_ns, m.X_NR, active.recent[-1], active.constants[:3])
        if self._missed > 2:
            return self._begin_anew(
                m, time_s, "its first frames had nothing in common with those that follow"
            )
        return state

    def _begin_anew(self, m: FrameMeasurements, time_s: float, why: str) -> OnlineState:
        """Forget all: from here on the frame G is another one."""
        level = logging.WARNING if self.belief.inertia_known else logging.INFO
        _log.log(level, "sliding window: begun anew at %.2f s, %s", time_s, why)
        self._missed, self.belief = 0, new_belief(self._rig, self._config, self._camera)
        return self._begin(m, time_s)

    def _report(self, m: FrameMeasurements) -> OnlineState:
        belief, active = self.belief, self.belief.active
        assert belief.last is not None
        state = online_state(
            m.timestamp_ns,
            active.recent[-1],
            active.constants,
            belief.R_inertia,
            belief.shape.form,
            belief.last,
            np.stack([frame.x[9:12] for frame in active.recent]),
            self._axes,
        )
        self._axes = state.R_GP
        belief.inertia_known = bool(state.determined[:2].all())
        return state
