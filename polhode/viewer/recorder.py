"""What is logged to Rerun of a rig, a frame, a surface and a body.

One recorder serves a finished run, a sequence and a stream. Entities below ``N`` are in the inertial frame,
those below ``P`` in the principal axes, ``plots`` are series over time; lengths in metres. Timelines:
``frame`` (number) and ``time`` (seconds since the first frame).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np
import rerun as rr

from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, make_pose, wxyz_from_matrix
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.records.rig_calibration import StereoCalibration
from polhode.records.surface import SurfaceModel
from polhode.report.shape_figures import thin_mesh, vertex_rgb

# Okabe and Ito, "Color universal design", 2008: told apart by readers with any colour vision.
ORANGE, SKY_BLUE, GREEN = (230, 159, 0), (86, 180, 233), (0, 158, 115)
YELLOW, BLUE, VERMILION, PURPLE = (240, 228, 66), (0, 114, 178), (213, 94, 0), (204, 121, 167)
INLIER, OUTLIER, TRACK = GREEN, VERMILION, SKY_BLUE
AXES = (VERMILION, GREEN, BLUE)
"""Of x, y, z"""

TRACK_FRAMES = 5
"""Frames over which a track is drawn behind its feature."""
MAX_SIDE_PX = 1280
"""Larger images are shown at a half, a third, ... of their size."""
N_SIGMA = 3.0

SERIES: dict[str, tuple[str, ...]] = {
    "plots/r_N_m": ("x", "y", "z"),
    "plots/v_N_m_s": ("x", "y", "z"),
    "plots/w_P_deg_s": ("x", "y", "z"),
    "plots/sigma_theta_deg": ("x", "y", "z"),
    "plots/k": ("k1", "k2"),
    "plots/residual_rms_px": ("u", "v", "disparity"),
    "plots/observations": ("inliers", "outliers"),
}
BANDED = ("plots/r_N_m", "plots/v_N_m_s", "plots/w_P_deg_s", "plots/k")
"""Series with lines at plus and minus three standard deviations"""
BAND = "three_sigma"
FILLED, WIRES = rr.components.FillMode.TransparentFillMajorWireframe, rr.components.FillMode.DenseWireframe


@dataclass(frozen=True)
class ShownRig:
    """Two cameras as pinholes: those of a rectified pair, or those of a rig without their distortion."""

    K: tuple[Array, Array]
    """(3, 3) each [px], integer coordinates at pixel centres"""
    sizes_px: tuple[tuple[int, int], tuple[int, int]]
    """Width and height of each image"""
    X_LR: Array
    """(4, 4) pose of the right camera in the left one"""

    @property
    def plane_m(self) -> float:
        """Distance at which an image is drawn before its camera, until that of the target is known [m]."""
        return 5.0 * float(np.linalg.norm(self.X_LR[:3, 3]))

    @classmethod
    def rectified(cls, rig: RectifiedRig) -> Self:
        """The cameras of a rectified pair."""
        K_right = rig.K
        K_right[0, 2] -= rig.disparity_offset_px
        size = rig.width_px, rig.height_px
        return cls((rig.K, K_right), (size, size), make_pose(np.eye(3), [rig.baseline_m, 0.0, 0.0]))

    @classmethod
    def recorded(cls, calibration: StereoCalibration) -> Self:
        """The cameras as calibrated."""
        return cls(
            (calibration.K0, calibration.K1),
            (calibration.size_px(0), calibration.size_px(1)),
            inverse_pose(calibration.X_BC0) @ calibration.X_BC1,
        )


def known_ratios(k: Array, cov_k: Array, determined: Bools) -> tuple[Array, Array]:
    """Ratios k (..., 2) and their sigmas for ``ShownFrame.ratios``; determined (..., 2)."""
    sigma = np.sqrt(np.abs(np.diagonal(cov_k, axis1=-2, axis2=-1)))
    return np.where(determined, k, np.nan), np.where(determined, sigma, np.inf)


@dataclass(frozen=True)
class ShownFeatures:
    """The observations of a frame in its left image, n of them."""

    uv_px: Array
    """(n, 2)"""
    landmark: Ints
    """(n,) by which they are joined to tracks"""
    inlier: Bools
    """(n,) whether they agree with the motion"""


@dataclass(frozen=True)
class ShownMotion:
    """The state of the target; undetermined quantities have a variance of inf."""

    r_N: Array
    """(3,) [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NP: Array
    """(3, 3)"""
    w_P: Array
    """(3,) [rad/s]"""
    covariance: Array
    """(12, 12) in the order r (N), v (N), theta (P), w (P)"""
    X_NG: Array
    """(4, 4)"""
    moments: Array
    """(3,) Jxx >= Jyy >= Jzz, the middle one 1"""


@dataclass(frozen=True)
class ShownFrame:
    """One frame; None or empty where it has no such thing."""

    number: int
    time_s: float
    """Since the first frame"""
    X_NL: Array
    """(4, 4) pose of the left camera whose image is shown"""
    left: Image | None = None
    right: Image | None = None
    mask_left: Bools | None = None
    mask_right: Bools | None = None
    features: ShownFeatures | None = None
    motion: ShownMotion | None = None
    ratios: tuple[Array, Array] | None = None
    """k1 and k2 as known at the frame, NaN until the motion determines them, and their sigmas, (2,) each"""
    residual_rms_px: Array | None = None
    """(3,) of u, v, disparity; NaN where the frame has no inliers"""
    landmarks_G: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(L, 3) [m] of a finished run those that this frame is the first to observe, of a stream all of them"""


class Recorder:
    """Logs frames to one or more streams of Rerun, in the order of time."""

    def __init__(self, streams: Sequence[rr.RecordingStream], rig: ShownRig) -> None:
        self._streams = tuple(streams)
        self._rig = rig
        # whole numbers by which the sides of the images are divided
        self._shrink = [-(-max(size) // MAX_SIDE_PX) for size in rig.sizes_px]
        self._tracks: dict[int, list[tuple[int, Array]]] = {}
        """Number of the frame and place in the image of the last observations of each landmark"""
        self._last: dict[str, Array] = {}
        self._target_shown = False
        self._enlarged = 1
        self._size_m = 0.0
        self._log_rig(rig.plane_m)
        self._log_styles()

    def log_frame(self, frame: ShownFrame) -> None:
        """Everything that is known of a frame, later than those before."""
        self._set_time(frame.number, frame.time_s)
        self._log("N/camera", _transform(frame.X_NL))
        self._extend("N/camera_path", frame.X_NL[:3, 3], BLUE)
        pictures = (frame.left, frame.mask_left), (frame.right, frame.mask_right)
        for side, (image, mask) in enumerate(pictures):
            if image is not None:
                self._log_image(side, image, mask)
        if frame.features is not None:
            self._log_features(frame.number, frame.features)
        if len(frame.landmarks_G):
            self._size_m = max(self._size_m, 0.5 * float(np.ptp(frame.landmarks_G, axis=0).max()))
            self._log("N/target/landmarks", rr.Points3D(frame.landmarks_G, colors=YELLOW, radii=-1.0))
        if frame.motion is not None:
            self._log_motion(frame.motion, frame.X_NL)
        if frame.ratios is not None:
            self._plot("plots/k", *frame.ratios)
        if frame.residual_rms_px is not None:
            self._plot("plots/residual_rms_px", frame.residual_rms_px)

    def log_surface(self, surface: SurfaceModel, max_faces: int, static: bool = False) -> None:
        """The surface as known at the last frame that was logged, thinned where it has more faces; static: in
        all frames."""
        vertices, faces, of_old = thin_mesh(surface.mesh, max_faces)
        colors = vertex_rgb(surface.mesh)[of_old]
        mesh = rr.Mesh3D(vertex_positions=vertices, vertex_colors=colors, triangle_indices=faces)
        self._log("N/target/mesh", mesh, static)

    def remove_surface(self) -> None:
        """Show no surface from the last frame on that was logged: it was in a frame G that is gone."""
        self._log("N/target/mesh", rr.Clear(recursive=False))

    def log_polhode_path(self, w_P: Array) -> None:
        """The path (n, 3) [rad/s] of the angular velocity over the whole run, also between the frames."""
        path = rr.LineStrips3D([np.rad2deg(w_P)], colors=SKY_BLUE, radii=-0.75)
        self._log("P/path", path, static=True)

    def _log_rig(self, plane_m: float) -> None:
        for side, name in enumerate(("left", "right")):
            factor = self._shrink[side]
            K, (width, height) = self._rig.K[side], self._rig.sizes_px[side]
            camera = rr.Pinhole(
                focal_length=[K[0, 0] / factor, K[1, 1] / factor],
                principal_point=_in_view(K[:2, 2], factor),
                resolution=[width // factor, height // factor],
                image_plane_distance=plane_m,
            )
            self._log(f"N/camera/{name}", camera, static=True)
        self._log("N/camera/right", _transform(self._rig.X_LR), static=True)

    def _log_styles(self) -> None:
        for path, names in SERIES.items():
            colors = (GREEN, VERMILION) if path == "plots/observations" else AXES[: len(names)]
            self._log(
                path, rr.SeriesLines(colors=colors, names=names, widths=[2.0] * len(names)), static=True
            )
            if path in BANDED:
                # of the same name, so that the legend has one entry for a quantity and its band
                style = rr.SeriesLines(colors=colors * 2, names=names * 2, widths=[0.75] * 2 * len(names))
                self._log(f"{path}/{BAND}", style, static=True)

    def _log_image(self, side: int, image: Image, mask: Bools | None) -> None:
        path, factor = f"N/camera/{('left', 'right')[side]}", self._shrink[side]
        height, width = (length // factor for length in image.shape)
        # what is left over by the division is cut off, as in the resolution of the pinhole
        whole = image[: height * factor, : width * factor]
        small = whole if factor == 1 else cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        content = bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 85])[1])
        self._log(path, rr.EncodedImage(contents=content, media_type="image/jpeg"))
        borders: Sequence[Image] = ()
        if mask is not None:
            mode, method = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
            borders = [np.asarray(line) for line in cv2.findContours(mask.astype(np.uint8), mode, method)[0]]
        closed = [_in_view(np.vstack([line, line[:1]])[:, 0], factor) for line in borders]
        self._log(f"{path}/mask", rr.LineStrips2D(closed, colors=YELLOW, radii=-0.75))

    def _log_features(self, number: int, features: ShownFeatures) -> None:
        """Features by colour, and where their landmarks were observed in the frames just before."""
        uv, landmarks = _in_view(features.uv_px, self._shrink[0]), features.landmark.tolist()
        colors = np.where(features.inlier[:, None], INLIER, OUTLIER).astype(np.uint8)
        self._log("N/camera/left/features", rr.Points2D(uv, colors=colors, radii=-2.0))
        recent = {n: seen for n, seen in self._tracks.items() if seen[-1][0] >= number - TRACK_FRAMES}
        for landmark, point in zip(landmarks, uv, strict=True):
            seen = [each for each in recent.get(landmark, ()) if each[0] >= number - TRACK_FRAMES]
            recent[landmark] = [*seen, (number, point)]
        self._tracks = recent
        tracks = [np.stack([point for _, point in recent[n]]) for n in landmarks if len(recent[n]) > 1]
        self._log("N/camera/left/tracks", rr.LineStrips2D(tracks, colors=TRACK, radii=-0.4))
        inliers = int(features.inlier.sum())
        self._plot("plots/observations", np.array([inliers, len(features.inlier) - inliers], dtype=float))

    def _log_motion(self, motion: ShownMotion, X_NL: Array) -> None:
        distance_m = float(np.linalg.norm(motion.r_N - X_NL[:3, 3]))
        if not self._target_shown:
            self._target_shown = True
            self._log_rig(0.3 * distance_m)
        # half as long again as half the extent of the landmarks, where there are any
        arrow_m = 1.5 * self._size_m or 0.25 * distance_m
        self._log("N/target", _transform(motion.X_NG))
        self._log("N/principal_axes", _arrows(motion.r_N, motion.R_NP.T * arrow_m, AXES, ("x", "y", "z")))
        self._log_ellipsoid(motion, distance_m)
        self._log_rotation(motion, 1.3 * arrow_m)
        self._extend("N/trajectory", motion.r_N, ORANGE)
        variances = np.diagonal(motion.covariance)
        sigma = np.sqrt(np.where(variances >= 0.0, variances, np.inf))
        self._plot("plots/r_N_m", motion.r_N, sigma[0:3])
        self._plot("plots/v_N_m_s", motion.v_N, sigma[3:6])
        self._plot("plots/w_P_deg_s", np.rad2deg(motion.w_P), np.rad2deg(sigma[9:12]))
        self._plot("plots/sigma_theta_deg", _finite(np.rad2deg(sigma[6:9])))

    def _log_ellipsoid(self, motion: ShownMotion, distance_m: float) -> None:
        """Three standard deviations of the position, enlarged by a power of ten that its label states."""
        covariance = motion.covariance[:3, :3]
        if not np.isfinite(covariance).all():
            self._log("N/position_three_sigma", rr.Ellipsoids3D(half_sizes=[]))
            return
        values, vectors = np.linalg.eigh(covariance)
        half_m = N_SIGMA * np.sqrt(np.maximum(values, 0.0))
        most = 0.1 * distance_m / max(float(half_m.max()), 1e-12 * distance_m)
        # a stream knows the position better and better: the factor only grows, so that it seldom changes
        self._enlarged = max(self._enlarged, 10 ** int(np.clip(np.floor(np.log10(max(most, 1.0))), 0, 6)))
        # eigenvectors may be a reflection, which no rotation is
        R = vectors * np.sign(np.linalg.det(vectors))
        times = f" ×{self._enlarged}" if self._enlarged > 1 else ""
        ellipsoid = rr.Ellipsoids3D(
            centers=[motion.r_N],
            half_sizes=[self._enlarged * half_m],
            quaternions=[rr.Quaternion(xyzw=wxyz_from_matrix(R)[[1, 2, 3, 0]])],
            colors=ORANGE,
            labels=f"3σ{times}: {1e3 * half_m.max():.2g} mm",
        )
        self._log("N/position_three_sigma", ellipsoid)

    def _log_rotation(self, motion: ShownMotion, arrow_m: float) -> None:
        """Directions of angular velocity and momentum in N; in P the polhode on its two ellipsoids."""
        J, rate = np.diag(motion.moments), float(np.linalg.norm(motion.w_P))
        if rate == 0.0:
            return
        w_N, h_N = motion.R_NP @ motion.w_P, angular_momentum_N(J, motion.R_NP, motion.w_P)
        momentum = float(np.linalg.norm(h_N))
        vectors = arrow_m * np.stack([w_N / rate, h_N / momentum])
        labels = f"ω {rate * 30.0 / np.pi:.2f} RPM", "h"
        self._log("N/rotation", _arrows(motion.r_N, vectors, (YELLOW, PURPLE), labels))
        energy = float(rotational_energy(J, motion.w_P))
        for name, half, color, fill in (
            ("energy", np.sqrt(2.0 * energy / motion.moments), (*SKY_BLUE, 90), FILLED),
            ("momentum", momentum / motion.moments, (*PURPLE, 255), WIRES),
        ):
            sizes = [np.rad2deg(half)]
            surface = rr.Ellipsoids3D(half_sizes=sizes, colors=color, fill_mode=fill, line_radii=-0.25)
            self._log(f"P/{name}_ellipsoid", surface)
        w_deg = np.rad2deg(motion.w_P)
        self._extend("P/trace", w_deg, ORANGE)
        self._log("P/angular_velocity", _arrows(np.zeros(3), w_deg[None], (ORANGE,), ("ω",)))

    def _plot(self, path: str, values: Array, sigma: Array | None = None) -> None:
        """The next value of each series of a plot, with three standard deviations where they are known."""
        self._log(path, rr.Scalars(values))
        if sigma is not None:
            band = np.concatenate([values + N_SIGMA * sigma, values - N_SIGMA * sigma])
            self._log(f"{path}/{BAND}", rr.Scalars(_finite(band)))

    def _extend(self, path: str, point: Array, color: tuple[int, int, int]) -> None:
        """A path by the piece from its last point; a blueprint shows all pieces up to now."""
        if (last := self._last.get(path)) is not None and not np.array_equal(last, point):
            self._log(path, rr.LineStrips3D([np.stack([last, point])], colors=color, radii=-1.0))
        self._last[path] = point

    def _set_time(self, number: int, time_s: float) -> None:
        for stream in self._streams:
            stream.set_time("frame", sequence=number)
            stream.set_time("time", duration=time_s)

    def _log(self, path: str, content: rr.AsComponents, static: bool = False) -> None:
        for stream in self._streams:
            stream.log(path, content, static=static, strict=True)


def _transform(X_AB: Array) -> rr.Transform3D:
    """The pose (4, 4) of the entity B in its parent A."""
    return rr.Transform3D(translation=X_AB[:3, 3], mat3x3=X_AB[:3, :3])


def _arrows(
    origin: Array, vectors: Array, colors: Sequence[tuple[int, ...]], labels: Sequence[str]
) -> rr.Arrows3D:
    """Arrows (n, 3) from one point (3,)."""
    origins = np.broadcast_to(origin, vectors.shape)
    return rr.Arrows3D(vectors=vectors, origins=origins, colors=colors, labels=labels, radii=-1.5)


def _finite(values: Array) -> Array:
    """NaN, which leaves a gap in a plot, instead of infinity."""
    return np.where(np.isfinite(values), values, np.nan)


def _in_view(uv_px: Array, factor: int) -> Array:
    """Pixels (..., 2) of the image as Rerun counts them, which has pixel centres at one half."""
    return np.asarray((uv_px + 0.5) / factor)
