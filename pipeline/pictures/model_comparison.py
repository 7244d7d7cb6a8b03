"""The model through the left camera at the estimated poses, held against the images: thesis figure 6-30.

What differs should be geometry and light, so gain and offset of the brightness are fitted in each frame. The
difference is the image minus the model; its root mean square is taken where both show the target.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.camera import RectifiedRig
from polhode.dataset import StereoSequence
from polhode.frontend.rectification.rectify import Rectifier, rectified_left
from polhode.lie import Array, inverse_pose, transform_points
from polhode.mapping.mesh_viewer import MeshViewer
from polhode.pipeline.report.figures.shape import vertex_rgb
from polhode.records import Bools, Ints, MotionEstimate, StereoTracks

MAX_PIXELS = 256
"""Edge of the square that is compared; of a larger window, fewer rays are cast."""
MARGIN = 1.12
"""Edge of the window over what the model needs in any frame."""
_MAX_VERTICES = 3000


@dataclass(frozen=True)
class FrameComparison:
    """One frame: squares of n x n pixels about the target."""

    frame: int
    time_s: float
    measured: bool
    """whether the frame has measurements; else its pose is bridged by the dynamics"""
    image: NDArray[np.uint8]
    model: Array
    """brightness of the model [grey levels], 0 where there is none"""
    seen: Bools
    """the target's silhouette in the image"""
    modelled: Bools
    """the model's"""
    gain: float
    offset: float
    """grey levels"""

    @property
    def difference(self) -> Array:
        """Image minus model after gain and offset [grey levels]; 0 outside both silhouettes."""
        fitted = np.where(self.modelled, (self.gain * self.model + self.offset).clip(0.0, 255.0), 0.0)
        return np.where(self.seen | self.modelled, self.image - fitted, 0.0)

    @property
    def rms_grey(self) -> float:
        """Root mean square of the difference where both show the target; NaN where they nowhere do."""
        both = self.seen & self.modelled
        return float(np.sqrt(np.mean(np.square(self.difference[both])))) if both.any() else float("nan")

    @property
    def overlap(self) -> float:
        """Intersection over union of the silhouettes; NaN where both are empty."""
        return _share(self.seen & self.modelled, self.seen | self.modelled)

    @property
    def covered(self) -> float:
        """Share of the image's silhouette that the model covers: in shadows, only lit parts are seen."""
        return _share(self.seen & self.modelled, self.seen)


def _share(part: Bools, whole: Bools) -> float:
    count = int(whole.sum())
    return int(part.sum()) / count if count else float("nan")


def chosen_frames(n_frames: int, most: int) -> list[int]:
    """At most ``most`` frames, spread evenly, first and last among them."""
    frames: list[int] = np.unique(
        np.linspace(0, n_frames - 1, min(n_frames, most)).round().astype(int)
    ).tolist()
    return frames


def compare_frames(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    viewer: MeshViewer,
    frames: list[int],
) -> Iterator[FrameComparison]:
    """The model beside the image, frame by frame. ``viewer`` looks at ``mesh``, which has faces."""
    rig = rectifier.rig
    brightness = vertex_rgb(mesh).astype(np.float64).mean(axis=1)
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    corners, side = _window(np.asarray(mesh.vertices), rig, X_RG[frames])
    measured = np.bincount(tracks.frame, minlength=tracks.n_frames) > 0
    for k, corner in zip(frames, corners, strict=True):
        left, mask = rectified_left(sequence, rectifier, k)
        u, v, image, seen = _cut(left, mask, corner, side)
        view = viewer.perspective(rig, X_RG[k], u, v)
        inside = ((v >= 0) & (v <= rig.height_px - 1))[:, None] & ((u >= 0) & (u <= rig.width_px - 1))
        modelled = view.hit & inside
        model = np.where(modelled, view.values(brightness), 0.0)
        fit = fit_brightness(image[seen & modelled], model[seen & modelled])
        time_s = float(tracks.time_s[k])
        yield FrameComparison(k, time_s, bool(measured[k]), image, model, seen, modelled, *fit)


def fit_brightness(image: NDArray[np.uint8], model: Array) -> tuple[float, float]:
    """Gain and offset of least squares, image ~ gain model + offset (n,); the gain is never negative."""
    if len(model) == 0:
        return 1.0, 0.0
    grey = image.astype(np.float64)
    spread = float(np.var(model))
    gain = float(np.mean((model - model.mean()) * (grey - grey.mean()))) / spread if spread > 0.0 else 1.0
    gain = max(gain, 0.0)
    return gain, float(grey.mean() - gain * model.mean())


def _window(vertices: Array, rig: RectifiedRig, X_RG: Array) -> tuple[Ints, int]:
    """First column and row (F, 2) and edge [px] of a square that follows the model and contains all of it.

    Frames without the model's middle in view follow, but do not count for the size.
    """
    some = vertices[:: max(1, len(vertices) // _MAX_VERTICES)]
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    size = np.array([rig.width_px, rig.height_px])
    most = int(size.max())
    centres, half = np.tile([rig.cx_px, rig.cy_px], (len(X_RG), 1)), 8.0
    for k, X in enumerate(X_RG):
        p_R = transform_points(X, np.vstack([middle, some]))
        if p_R[0, 2] <= 0.0:
            continue
        centres[k] = rig.project(p_R[0])[:2]
        if p_R[:, 2].min() > 0.0 and np.all((centres[k] >= 0.0) & (centres[k] < size)):
            half = max(half, float(np.abs(rig.project(p_R)[:, :2] - centres[k]).max()))
    side = int(min(np.ceil(2.0 * MARGIN * half), most))
    return np.round(centres - 0.5 * (side - 1)).clip(-4 * most, 4 * most).astype(np.int64), side


def _cut(
    image: NDArray[np.uint8], mask: Bools, corner: Ints, side: int
) -> tuple[Array, Array, NDArray[np.uint8], Bools]:
    """Columns and rows of the cut-out, its image and its mask; black beyond the image's border."""
    count = min(side, MAX_PIXELS)
    step = side / count
    u0, v0 = (int(start) for start in corner)
    place = np.asarray((np.arange(count) + 0.5) * step - 0.5, dtype=np.float64)
    grey: NDArray[np.uint8] = np.zeros((side, side), dtype=np.uint8)
    target: NDArray[np.uint8] = np.zeros((side, side), dtype=np.uint8)
    height, width = image.shape
    rows, columns = slice(max(v0, 0), min(v0 + side, height)), slice(max(u0, 0), min(u0 + side, width))
    if rows.start < rows.stop and columns.start < columns.stop:
        there = (slice(rows.start - v0, rows.stop - v0), slice(columns.start - u0, columns.stop - u0))
        grey[there], target[there] = image[rows, columns], mask[rows, columns]
    if count < side:
        grey = np.asarray(cv2.resize(grey, (count, count), interpolation=cv2.INTER_AREA), dtype=np.uint8)
        shrunk = cv2.resize(255 * target, (count, count), interpolation=cv2.INTER_AREA)
        return u0 + place, v0 + place, grey, np.asarray(shrunk) > 127
    return u0 + place, v0 + place, grey, target > 0
