"""The data of the estimation problem, and the values that are held during one solve."""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.dynamics.propagation import series_steps
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import FORMS, InertiaForm
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.wrench import Impulses, impulses_of
from polhode.config.backend import Backend
from polhode.lie import Array, inverse_pose
from polhode.records import Bools, Ints, StereoTracks

LOOSE_GAUGE, TIGHT_GAUGE = 0.1, 1e-3
"""How firmly G is held at the first frame [rad, body radii]. A cold start must be free to move it; near the
solution a step along it would leave the curved valley in which G may move."""
COM_PRIOR_M = 0.1
"""Least standard deviation of the prior on the centre of mass; a larger body's own radius is taken."""


TINY = 1e-12
"""[N, N m] bias of a force or a torque where there is none."""
UNKNOWN_PUSH_PSD = 1.0
"""[(m/s^2)^2/Hz], [(rad/s^2)^2/Hz] so strong that a step tells nothing of the body."""
LEAST_CAMERA_SIGMA = 1e-7
"""[m, rad] where only the other half of the camera's pose is noisy."""


@dataclass(frozen=True)
class MotionData:
    """Measurements sorted by landmark, the camera's poses and the noise: what does not change in a run."""

    frame: Ints
    """(M,)"""
    landmark: Ints
    """(M,) ascending"""
    start: Ints
    """(L + 1,) the observations of landmark l are start[l]:start[l + 1]"""
    uvd_px: Array
    """(M, 3)"""
    inv_sigma: Array
    """(M, 3) [1/px]"""
    rig: Array
    """(5,) f, cx, cy [px], baseline [m], disparity offset [px]"""
    R_RN: Array
    """(F, 3, 3)"""
    t_R: Array
    """(F, 3) origin of N in R [m]"""
    camera_N: Array
    """(F, 3) stated position of the body whose pose is stated, with the camera on it [m]"""
    dt_s: Array
    """(F - 1,)"""
    camera_sigma: tuple[float, float]
    """[m, rad] of the camera's stated poses, independent from frame to frame; zeros: they are exact"""
    accel_psd: float
    torque_psd: float
    robust_scale: float
    form: InertiaForm
    impulses: Impulses | None
    """Of the known wrench; None: none acts"""
    bias_sigma: tuple[float, float]
    """[N, N m] of the constant biases of the known force and torque"""
    order: Ints
    """(M,) sorted observation -> observation of the tracks"""
    nodes: Bools
    """(F - 1,) steps in which something unknown may push"""
    node_sigma: tuple[float, float]
    """[m/s^2, rad/s^2] of such a push, zero on average"""
    loose: Bools | None = None
    """(F - 1,) steps whose dynamics tell nothing; None: all tell"""

    @property
    def n_frames(self) -> int:
        return len(self.R_RN)

    @property
    def camera_is_noisy(self) -> bool:
        """Whether the errors of the camera's pose are unknowns."""
        return max(self.camera_sigma) > 0.0

    @property
    def n_landmarks(self) -> int:
        return len(self.start) - 1

    def rescaled(self, factors: Array) -> "MotionData":
        """The same measurements, the standard deviations of u, v and disparity times factors (3,)."""
        return replace(self, inv_sigma=self.inv_sigma / factors)


def motion_data(tracks: StereoTracks, config: Backend) -> MotionData:
    """Prepare the tracks for the solvers."""
    order = np.lexsort((tracks.frame, tracks.landmark))
    landmark = tracks.landmark[order]
    X_RN, rig = inverse_pose(tracks.X_NR), tracks.rig
    impulses = impulses_of(tracks.wrench, tracks.timestamps_ns) if tracks.wrench is not None else None
    force_N, torque_Nm = impulses.largest if impulses is not None else (0.0, 0.0)
    return MotionData(
        frame=np.ascontiguousarray(tracks.frame[order], dtype=np.int64),
        landmark=np.ascontiguousarray(landmark, dtype=np.int64),
        start=np.searchsorted(landmark, np.arange(tracks.n_landmarks + 1)).astype(np.int64),
        uvd_px=np.ascontiguousarray(tracks.uvd_px[order], dtype=np.float64),
        inv_sigma=1.0 / np.array(tracks.sigma_px, dtype=np.float64)[order],
        camera_sigma=(tracks.sigma_camera_p_m, tracks.sigma_camera_theta_rad),
        rig=np.array([rig.focal_px, rig.cx_px, rig.cy_px, rig.baseline_m, rig.disparity_offset_px]),
        R_RN=np.ascontiguousarray(X_RN[:, :3, :3]),
        t_R=np.ascontiguousarray(X_RN[:, :3, 3]),
        camera_N=(tracks.X_NR @ inverse_pose(tracks.X_BR))[:, :3, 3],
        dt_s=np.diff(tracks.time_s),
        accel_psd=config.accel_psd,
        torque_psd=config.torque_psd,
        robust_scale=config.robust_scale,
        form=FORMS[config.inertia],
        impulses=impulses,
        bias_sigma=(max(config.wrench_bias * force_N, TINY), max(config.wrench_bias * torque_Nm, TINY)),
        order=order,
        nodes=nodes_of(
            config.unknown_wrench_s, config.unknown_wrench == "everywhere", np.diff(tracks.time_s)
        ),
        node_sigma=(config.unknown_acceleration, config.unknown_angular_acceleration),
    )


def nodes_of(windows_s: tuple[tuple[float, float], ...], everywhere: bool, dt_s: Array) -> Bools:
    """(F - 1,) steps in which a push is stated to be possible."""
    ends = np.concatenate([[0.0], np.cumsum(dt_s)])
    nodes = np.full(len(dt_s), everywhere)
    for start, end in windows_s:
        nodes |= (ends[:-1] < end) & (ends[1:] > start)
    return nodes


@dataclass(frozen=True)
class Held:
    """What is held during one solve: reference attitudes, whitening at the current rate, priors, gauge.

    The free frame G is kept near the reference by a soft hold on the first pose: it costs nothing at the
    solution, because every motion of G with its landmarks leaves the other terms unchanged.
    """

    reference: Iterate
    A: Array
    """(F, 3, 3) R_RN R_ref"""
    steps: Steps
    """Lengths, numbers of series and whitening of the steps between frames"""
    prior: Array
    """(13,) parameters of the prior kernel"""
    gauge_information: Array
    """(6,) diagonal of the hold on p_NG, theta of the first frame"""
    camera_information: Array
    """(6,) diagonal of the prior on the errors of the camera's pose, for each frame"""
    bias_sigma: tuple[float, float]
    """[N, N m] of the constant biases of a known wrench"""
    half_log_det: float
    """Normalisation of the dynamics term: makes the costs of different inertias comparable"""


def hold(data: MotionData, iterate: Iterate, gauge: float = LOOSE_GAUGE) -> Held:
    """Freeze references and whitening at an iterate; gauge is the standard deviation of the first pose."""
    w, J_G = iterate.w_G[:-1], iterate.J_G(data.form)
    accel_psd, torque_psd = _levels(data, iterate)
    # an unknown push of any course within its step, integrated out: white, and as strong over the whole step
    accel_node, torque_node = np.square(data.node_sigma)[:, None] * data.nodes * data.dt_s
    W_t, W_r, half_log = whitening(w, J_G, data.dt_s, accel_psd + accel_node, torque_psd + torque_node)
    middle = geometric_median(iterate.p_G)
    radius = float(np.sqrt(np.median(np.sum((iterate.p_G - middle) ** 2, axis=1))))
    com_sigma = max(COM_PRIOR_M, radius)
    return Held(
        reference=iterate,
        A=data.R_RN @ iterate.R_NG,
        steps=_steps(data, iterate, series_steps(w, J_G, data.dt_s, torque_psd), W_t, W_r),
        prior=np.concatenate([middle, [com_sigma], iterate.R_inertia.T.ravel()]),
        gauge_information=np.repeat([(gauge * com_sigma) ** -2, gauge**-2], 3),
        camera_information=np.repeat(
            [max(sigma, LEAST_CAMERA_SIGMA) ** -2 for sigma in data.camera_sigma], 3
        ),
        bias_sigma=data.bias_sigma,
        half_log_det=half_log,
    )


def _levels(data: MotionData, iterate: Iterate) -> tuple[Array, Array]:
    """Disturbances in each step (F - 1,); in loose ones any, and where a known wrench acts that the iterate
    does not have."""
    unknown = np.zeros_like(data.dt_s)
    if data.loose is not None:
        unknown[data.loose] = UNKNOWN_PUSH_PSD
    if data.impulses is not None and iterate.wrench is None:
        unknown[data.impulses.acting] = UNKNOWN_PUSH_PSD
    return np.maximum(data.accel_psd, unknown), np.maximum(data.torque_psd, unknown)


def _steps(data: MotionData, iterate: Iterate, series: Ints, W_t: Array, W_r: Array) -> Steps:
    known = data.impulses
    if known is None or iterate.wrench is None:
        return Steps(data.dt_s, series, W_t, W_r)
    series = known.finer(series, iterate.w_G[:-1], data.dt_s)
    return Steps(data.dt_s, series, W_t, W_r, known.of_force, known.torque(series))


def geometric_median(points: Array) -> Array:
    """Middle (3,) of points (n, 3): robust, and the same whichever way the axes lie (Weiszfeld 1937)."""
    middle = points.mean(axis=0)
    for _ in range(10):
        weight = 1.0 / np.maximum(np.linalg.norm(points - middle, axis=1), 1e-6)
        middle = weight @ points / weight.sum()
    return np.asarray(middle)


def series_groups(series: Ints) -> list[tuple[int, Ints]]:
    """Intervals that share a number of Taylor series: (number, indices)."""
    return [(int(n), np.flatnonzero(series == n)) for n in np.unique(series)]
