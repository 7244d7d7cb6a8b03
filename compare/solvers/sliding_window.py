"""The sliding window of the back end in different lengths, compared with batch smoothing.

The window gets the frames one by one. Each state is taken when its frame leaves the window, or after the last
frame: it is smoothed by at most that many frames after its own. Landmarks are then optimized for these poses,
and the common cost is assessed. The window starts from the measurements alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.window import CameraNoise, FrameMeasurements, OnlineState, SlidingWindow
from polhode.camera import RectifiedRig
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.compare.solvers.condensed import ReducedCost
from polhode.config.backend_settings import Backend, Window
from polhode.lie import Array, inverse_pose, make_pose

MIN_HISTORY = 4


@dataclass
class WindowLength:
    """One length."""

    frames: str = "12"

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Each state when it left the window; those of ``x`` for frames whose pose was not found."""
        data, start = problem.data, problem.iterate(x)
        window = SlidingWindow(
            rig_of(data), settings_of(data, int(self.frames)), CameraNoise(*data.camera_sigma)
        )
        states = np.concatenate([start.p_NG, np.zeros_like(start.p_NG), start.v_N, start.w_G], axis=1)
        R_NG, centres = start.R_NG.copy(), start.p_NG + start.R_NG @ start.com_G
        placed, restarts, state, last = np.zeros(data.n_frames, dtype=bool), 0, window.state, None
        monitor.report(f"none of {data.n_frames} frames were in")
        for k, measured in enumerate(frames_of_data(data)):
            last = window.add(measured)
            restarts, state = restarts + (window.state is not state), window.state
            for frame in state.active.recent:
                n = frame.number - 1
                states[n], R_NG[n], placed[n] = frame.x, frame.R_NG, True
                centres[n] = frame.x[:3] + frame.R_NG @ state.active.constants[:3]
            monitor.report(f"{k + 1} of {data.n_frames} frames were in")
            monitor.check()
        monitor.report("")
        monitor.stop()
        assert last is not None
        xi, R_inertia = data.form.coordinates(second_moments_of(last))
        at = replace(
            start,
            p_NG=centres - R_NG @ last.com_G,
            R_NG=R_NG,
            v_N=states[:, 6:9],
            w_G=states[:, 9:12],
            com_G=last.com_G,
            xi=xi,
            R_inertia=R_inertia,
        )
        end = problem.vector(at)
        end[start.n_dense :] = x[start.n_dense :]
        message = f"{np.sum(~placed)} frames have no pose, the window restarted {restarts} times"
        return AdapterResult(with_landmarks(problem, end), True, data.n_frames, message)


def settings_of(data: MotionData, frames: int) -> Backend:
    """Settings of the window: its length, a history of the same length, the noise of the problem."""
    return Backend(
        # the length is compared here, not the solver
        window=Window(solver="gauss_newton", frames=frames, history=max(frames, MIN_HISTORY)),
        process_noise="given",
        accel_psd=data.accel_psd,
        torque_psd=data.torque_psd,
        robust_scale=data.robust_scale,
        inertia="ratios_axes" if data.form.name == "ratios_axes" else "second_moments",
    )


def rig_of(data: MotionData) -> RectifiedRig:
    """The camera; the size of its images does not matter."""
    f, cx, cy, baseline, offset = (float(value) for value in data.rig)
    return RectifiedRig(f, cx, cy, baseline, int(2.0 * cx), int(2.0 * cy), offset)


def frames_of_data(data: MotionData) -> Iterator[FrameMeasurements]:
    """The measurements of the problem in the order of time."""
    X_NR = inverse_pose(make_pose(data.R_RN, data.t_R))
    time_ns = np.round(1e9 * np.concatenate([[0.0], np.cumsum(data.dt_s)])).astype(np.int64)
    order = np.lexsort((data.landmark, data.frame))
    start = np.searchsorted(data.frame[order], np.arange(data.n_frames + 1))
    for k in range(data.n_frames):
        use = order[start[k] : start[k + 1]]
        landmarks, uvd, sigma = data.landmark[use], data.uvd_px[use], 1.0 / data.inv_sigma[use]
        yield FrameMeasurements(int(time_ns[k]), X_NR[k], landmarks, uvd, sigma)


def second_moments_of(state: OnlineState) -> Array:
    """(3, 3) in G, from the ratios and the axes."""
    moments = np.array([np.exp(state.k[0]), 1.0, np.exp(-state.k[1])])
    return second_moments_from_inertia(state.R_GP @ np.diag(moments) @ state.R_GP.T)


def with_landmarks(problem: MeasuredProblem, x: Array) -> Array:
    """x with the landmarks that minimize the cost at its poses."""
    n = problem.fixed.reference.n_dense
    reduced = ReducedCost(problem, x, SolveMonitor(np.inf))
    reduced.cost(x[:n])
    return np.concatenate([x[:n], reduced.landmarks])
