"""Whether the images move as the estimate says, and whether the fused surface, moved by it, looks like them.

Landmarks that agree with one another may all belong to what stands still on a turning target: the outline,
nozzle and rings of a body of revolution, a reflection, a pattern of the light. The motion found is then
theirs, and no residual shows it. Here, every pixel with depth is moved to the next pair by the estimate, and
the optical flow (DIS; Kroeger et al., ECCV 2016) between the image and the one that was moved back is what
the motion does not explain.

The surface with the brightness that fusion gave it, in the Sun that was found, is put before the left camera
at the estimated poses; the flow from the image to this picture is what surface and motion do not explain. A
motion that is not the surface's blurs its marks in the fusion, and moves what is left of them. Neither uses
landmarks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.frontend.rectification import Rectifier
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, inverse_pose, transform_points
from polhode.pipeline.checks.answer_checks.symmetry_turn import PairView, pair_view, rotation_check
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.metrics import angle_deg
from polhode.records.surface import DepthMap
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.model_comparison import chosen_frames, compare_frames
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary_schema import Check

MAX_PAIRS, MIN_PAIRS = 10, 3
"""Pairs of successive frames, or frames with the model, that are compared, chosen evenly; least number."""
MAX_TURN_DEG = 40.0
"""Between frames; beyond, the surface looks too different."""
CONTRAST_SCALE_PX, MIN_CONTRAST = 6.0, 5.0
"""Scale, and least standard deviation of the grey values over it, of a surface with texture."""


@dataclass
class ImageMotion:
    """Compares some pairs of successive frames."""

    rig: RectifiedRig
    X_RG: Array
    """(F, 4, 4)"""
    measured: Bools
    """(F,) frames with measurements of their own"""
    shares: list[float] = field(default_factory=list)
    """Of each pair that was compared: the share of its textured surface that is displaced"""
    views: list[PairView] = field(default_factory=list)
    """Of these pairs: what the check of the turn about an axis of symmetry needs"""

    def compare(self, maps: Sequence[DepthMap]) -> None:
        """Compare some pairs of successive frames. maps: of all frames, in order."""
        R = self.X_RG[:, :3, :3]
        turn_deg = angle_deg(np.swapaxes(R[:-1], 1, 2) @ R[1:])
        fit = 1 + np.flatnonzero((turn_deg < MAX_TURN_DEG) & self.measured[:-1] & self.measured[1:])
        at = np.linspace(0, len(fit) - 1, min(MAX_PAIRS, len(fit))).round().astype(np.int64)
        for k in fit[at].tolist():
            before, current, poses = maps[k - 1], maps[k], (self.X_RG[k - 1], self.X_RG[k])
            X = poses[1] @ inverse_pose(poses[0])
            displacement = residual_displacement(before, current, X, self.rig)
            if len(displacement) >= 400:
                self.shares.append(float(np.mean(displacement > 2.0)))
            if (view := pair_view(before, current, poses, self.rig)) is not None:
                self.views.append(view)

    def checks(self, interval_s: float) -> list[Check]:
        """Whether the images move as the motion says, and show the rotation of a body of revolution.

        interval_s: between successive pairs.
        """
        share = 100.0 * float(np.median(self.shares)) if len(self.shares) >= MIN_PAIRS else None
        return [make_check("image motion", share), rotation_check(self.views, self.rig, interval_s)]


def residual_displacement(first: DepthMap, second: DepthMap, X: Array, rig: RectifiedRig) -> Array:
    """Displacements (n,) [px] that the motion leaves, of the textured pixels of the first frame.

    X (4, 4) moves points of the first frame's camera to the second's.
    """
    back, known = warp_back(first, second, X, rig)
    picture = first.intensity.copy()
    back = np.where(known, back, picture)
    textured = _erode(known, 9)
    for image in (picture, back):
        grey, weight = image.astype(np.float32), known.astype(np.float32)
        around = np.maximum(cv2.GaussianBlur(weight, (0, 0), CONTRAST_SCALE_PX), 1e-3)
        mean = cv2.GaussianBlur(grey * weight, (0, 0), CONTRAST_SCALE_PX) / around
        square = cv2.GaussianBlur((grey - mean) ** 2 * weight, (0, 0), CONTRAST_SCALE_PX) / around
        textured &= np.asarray(np.sqrt(square)) > MIN_CONTRAST
    return _displacements_px(picture, back)[textured]


def _displacements_px(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> Array:
    """Length (H, W) of the optical flow from one image (H, W) to the other."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(
        first, second, np.zeros((*first.shape, 2), dtype=np.float32)
    )
    return np.asarray(np.linalg.norm(flow, axis=2), dtype=np.float64)


def _erode(where: Bools, size_px: int) -> Bools:
    """The pixels (H, W) whose whole square neighbourhood belongs to ``where``, or lies beyond the border."""
    return np.asarray(cv2.erode(where.astype(np.uint8), np.ones((size_px, size_px), dtype=np.uint8)) > 0)


def warp_back(
    first: DepthMap, second: DepthMap, X: Array, rig: RectifiedRig
) -> tuple[NDArray[np.uint8], Bools]:
    """The second image (H, W) as seen from the first frame, by its depth; where it is known (H, W)."""
    height, width = first.depth_m.shape
    v, u = np.mgrid[0:height, 0:width]
    known = np.isfinite(first.depth_m)
    z = np.where(known, first.depth_m, 1.0)
    p_R = np.stack([(u - rig.cx_px) / rig.focal_px * z, (v - rig.cy_px) / rig.focal_px * z, z], axis=2)
    moved = transform_points(X, p_R)
    known &= moved[..., 2] > 1e-6
    uv = rig.project(np.where(known[..., None], moved, [0.0, 0.0, 1.0]))[..., :2].astype(np.float32)
    known &= np.all((uv >= 1.0) & (uv <= [width - 2.0, height - 2.0]), axis=2)
    image = cv2.remap(second.intensity, uv[..., 0], uv[..., 1], cv2.INTER_LINEAR, borderValue=0)
    return np.asarray(image, dtype=np.uint8), np.asarray(known)


def model_check(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    sun_N: Array | None,
) -> Check:
    """Median share of the texture that is displaced; sun_N (3,) unit vector, None: unknown.

    Of each frame with enough texture, away from the outline and the border of the light. Texture is what the
    known grey values scatter by beside their local mean.
    """
    measured, shares = np.unique(tracks.frame), list[float]()
    if not len(mesh.faces) or len(measured) < MIN_PAIRS:
        return make_check("rendered model", None)
    frames = measured[chosen_frames(len(measured), MAX_PAIRS)].tolist()
    for each in compare_frames(sequence, rectifier, tracks, estimate, mesh, frames, sun_N):
        image, edge_px = each.image, 5
        lit = _erode(each.seen & each.modelled, edge_px) & (image > 25)
        grey, weight = image.astype(np.float32), lit.astype(np.float32)
        around = np.maximum(cv2.GaussianBlur(weight, (0, 0), CONTRAST_SCALE_PX), 1e-3)
        marks = (grey - cv2.GaussianBlur(grey * weight, (0, 0), CONTRAST_SCALE_PX) / around) * weight
        contrast = np.sqrt(cv2.GaussianBlur(marks**2, (0, 0), CONTRAST_SCALE_PX))
        textured = _erode(lit, edge_px) & np.asarray(contrast > MIN_CONTRAST)
        if textured.sum() >= 300:
            model = (each.gain * each.model + each.offset).clip(0.0, 255.0)
            ours, theirs = (np.where(lit, picture, 0).astype(np.uint8) for picture in (model, image))
            shares.append(float(np.mean(_displacements_px(theirs, ours)[textured] > 1.5)))
    return make_check(
        "rendered model", 100.0 * float(np.median(shares)) if len(shares) >= MIN_PAIRS else None
    )
