"""What is logged to Rerun of a rig, a frame, a surface and a body.

One recorder serves a finished run, a sequence and a stream. Entities below ``N`` are in the inertial frame,
those below ``P`` in the principal axes, ``plots`` are series over time; lengths in metres. Timelines:
``frame`` (number) and ``time`` (seconds since the first frame).
"""

from collections.abc import Sequence

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from polhode.frontend.rectification import Image
from polhode.geometry.lie import Array, Bools, Ints, wxyz_from_matrix
from polhode.geometry.rigid_body import angular_momentum_N, rotational_energy
from polhode.viewer.shown_frame import ShownFeatures, ShownFrame, ShownMotion, ShownRig

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
PLANE_SHARE = 0.3
"""Distance of the image from its camera in 3D, over the distance of the target."""
ELLIPSOID_SHARE = 0.1
"""The ellipsoid of the position is enlarged by a power of ten, at most to this share of the distance."""
ARROW_SHARE = 0.25
"""Length of arrows and axes over the distance of the target, where no landmarks tell the target's size."""
ARROW_OVER_SIZE = 1.5
"""Length of arrows and axes over half the extent of the landmarks."""

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


class Recorder:
    """Logs frames to one or more streams of Rerun, in the order of time."""

    def __init__(self, streams: Sequence[rr.RecordingStream], rig: ShownRig) -> None:
        self._streams = tuple(streams)
        self._rig = rig
        self._shrink = _shrink_factors(rig)
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

    def log_surface(self, vertices_G: Array, rgb: NDArray[np.uint8], faces: Ints) -> None:
        """The whole surface as known at the last frame that was logged. (V, 3) [m], (V, 3), (T, 3)."""
        mesh = rr.Mesh3D(vertex_positions=vertices_G, vertex_colors=rgb, triangle_indices=faces)
        self._log("N/target/mesh", mesh)

    def remove_surface(self) -> None:
        """Show no surface from the last frame on that was logged: it was in a frame G that is gone."""
        self._log("N/target/mesh", rr.Clear(recursive=False))

    def log_vertices(self, vertices_G: Array, rgb: NDArray[np.uint8]) -> None:
        """The vertices (V, 3) [m] of a surface of which ``log_faces`` shows more and more."""
        vertices = rr.Mesh3D.from_fields(vertex_positions=vertices_G, vertex_colors=rgb)
        self._log("N/target/mesh", vertices, static=True)

    def log_faces(self, faces: Ints) -> None:
        """The faces (T, 3) that are shown from the last frame on that was logged."""
        self._log("N/target/mesh", rr.Mesh3D.from_fields(triangle_indices=faces))

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
        picture = cv2.imencode(".jpg", _shrink_image(image, factor), [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        self._log(path, rr.EncodedImage(contents=bytes(picture), media_type="image/jpeg"))
        outlines = [] if mask is None else _outlines(mask, factor)
        self._log(f"{path}/mask", rr.LineStrips2D(outlines, colors=YELLOW, radii=-0.75))

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
            self._log_rig(PLANE_SHARE * distance_m)
        arrow_m = self._size_m * ARROW_OVER_SIZE or ARROW_SHARE * distance_m
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
        most = ELLIPSOID_SHARE * distance_m / max(float(half_m.max()), 1e-12 * distance_m)
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


def _shrink_factors(rig: ShownRig) -> tuple[int, int]:
    """Whole numbers by which the sides of the images are divided."""
    left, right = (-(-max(size) // MAX_SIDE_PX) for size in rig.sizes_px)
    return left, right


def _in_view(uv_px: Array, factor: int) -> Array:
    """Pixels (..., 2) of the image as Rerun counts them, which has pixel centres at one half."""
    return np.asarray((uv_px + 0.5) / factor)


def _shrink_image(image: Image, factor: int) -> Image:
    if factor == 1:
        return image
    height, width = (side // factor for side in image.shape)
    # what is left over by the division is cut off, as in the resolution of the pinhole
    whole = image[: height * factor, : width * factor]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _outlines(mask: Bools, factor: int) -> list[Array]:
    """The borders of a mask (H, W) as closed lines in the shown image."""
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    lines = (np.asarray(line, dtype=np.float64).reshape(-1, 2) for line in found)
    return [_in_view(np.concatenate([line, line[:1]]), factor) for line in lines]
