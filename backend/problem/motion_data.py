"""The data of the estimation problem: measurements, camera poses and noise, prepared for the solvers."""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.problem.inertia import FORMS, InertiaForm
from polhode.backend.problem.level_prior import LevelPrior
from polhode.backend.problem.wrench import Impulses, impulses_of
from polhode.config.backend_settings import Backend
from polhode.geometry.camera import RectifiedRig, stereo_jacobian
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.records.tracks import StereoTracks


@dataclass(frozen=True)
class MotionData:
    """Measurements sorted by landmark, camera poses and noise levels: what no iteration changes."""

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
    """Impulses of the known wrench; None: none acts"""
    bias_sigma: tuple[float, float]
    """[N, N m] of the constant biases of the known force and torque"""
    order: Ints
    """(M,) sorted observation -> observation of the tracks"""
    nodes: Bools
    """(F - 1,) steps in which an unknown disturbance may act"""
    node_sigma: tuple[float, float]
    """[m/s^2, rad/s^2] standard deviation of such a disturbance, which is zero-mean"""
    level_prior: LevelPrior
    """Of accel_psd and torque_psd"""
    level_decades: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of their logarithms after the data [decades]; zeros: they are given"""
    loose: Bools | None = None
    """(F - 1,) steps whose dynamics are given no weight; None: all count"""

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
        """The same measurements, the standard deviations of u, v and disparity multiplied by factors (3,)."""
        return replace(self, inv_sigma=self.inv_sigma / factors)

    def select(self, observations: Bools, landmark: Ints, n_landmarks: int) -> "MotionData":
        """Some of the observations (M,), of n_landmarks whose new numbers (m,) ascend."""
        return replace(
            self,
            frame=self.frame[observations],
            landmark=landmark,
            start=np.searchsorted(landmark, np.arange(n_landmarks + 1)).astype(np.int64),
            uvd_px=self.uvd_px[observations],
            inv_sigma=self.inv_sigma[observations],
            order=self.order[observations],
        )

    def unsorted(self, values: Array) -> Array:
        """Values (M, ...) of the sorted observations, in the order of the tracks."""
        out = np.empty_like(values)
        out[self.order] = values
        return out

    def point_jacobians(self, A: Array, p_NG: Array, p_G: Array) -> Array:
        """Derivatives (M, 3, 3) of the whitened predictions in the points p_R that they are of [1/m].

        A (F, 3, 3) = R_RN R_NG, p_NG (F, 3), p_G (L, 3).
        """
        k = self.frame
        p_R = (
            np.einsum("mij,mj->mi", A[k], p_G[self.landmark])
            + np.einsum("mij,mj->mi", self.R_RN[k], p_NG[k])
            + self.t_R[k]
        )
        return self.inv_sigma[:, :, None] * stereo_jacobian(p_R, self.rig[0], self.rig[3])


def motion_data(tracks: StereoTracks, config: Backend) -> MotionData:
    """Prepare the tracks for the solvers."""
    order = np.lexsort((tracks.frame, tracks.landmark))
    landmark = tracks.landmark[order]
    X_RN = inverse_pose(tracks.X_NR)
    impulses = impulses_of(tracks.wrench, tracks.timestamps_ns) if tracks.wrench is not None else None
    force_N, torque_Nm = impulses.largest if impulses is not None else (0.0, 0.0)
    return MotionData(
        frame=np.ascontiguousarray(tracks.frame[order], dtype=np.int64),
        landmark=np.ascontiguousarray(landmark, dtype=np.int64),
        start=np.searchsorted(landmark, np.arange(tracks.n_landmarks + 1)).astype(np.int64),
        uvd_px=np.ascontiguousarray(tracks.uvd_px[order], dtype=np.float64),
        inv_sigma=1.0 / np.array(tracks.sigma_px, dtype=np.float64)[order],
        camera_sigma=(tracks.sigma_camera_p_m, tracks.sigma_camera_theta_rad),
        rig=rig_vector(tracks.rig),
        R_RN=np.ascontiguousarray(X_RN[:, :3, :3]),
        t_R=np.ascontiguousarray(X_RN[:, :3, 3]),
        camera_N=(tracks.X_NR @ inverse_pose(tracks.X_BR))[:, :3, 3],
        dt_s=np.diff(tracks.time_s),
        accel_psd=config.accel_psd,
        torque_psd=config.torque_psd,
        robust_scale=config.robust_scale,
        form=FORMS[config.inertia],
        impulses=impulses,
        # tiny where no force or torque acts
        bias_sigma=(max(config.wrench_bias * force_N, 1e-12), max(config.wrench_bias * torque_Nm, 1e-12)),
        order=order,
        nodes=steps_with_nodes(
            config.unknown_wrench_s, config.unknown_wrench == "everywhere", np.diff(tracks.time_s)
        ),
        node_sigma=(config.unknown_acceleration, config.unknown_angular_acceleration),
        level_prior=LevelPrior.of(config),
    )


def rig_vector(rig: RectifiedRig) -> Array:
    """(5,) as ``MotionData.rig``."""
    return np.array([rig.focal_px, rig.cx_px, rig.cy_px, rig.baseline_m, rig.disparity_offset_px])


def steps_with_nodes(windows_s: tuple[tuple[float, float], ...], everywhere: bool, dt_s: Array) -> Bools:
    """(F - 1,) steps in which an unknown disturbance is stated to be possible."""
    ends = np.concatenate([[0.0], np.cumsum(dt_s)])
    nodes = np.full(len(dt_s), everywhere)
    for start, end in windows_s:
        nodes |= (ends[:-1] < end) & (ends[1:] > start)
    return nodes
