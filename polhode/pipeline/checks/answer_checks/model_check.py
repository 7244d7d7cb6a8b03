"""Whether the fused surface, moved by the estimate, looks like the images.

The surface with the brightness that fusion gave it, in the Sun that was found, is put before the left camera
at the estimated poses. The optical flow (DIS; Kroeger et al., ECCV 2016) from the image to this picture is
what surface and motion do not explain. A motion that is not the surface's blurs its marks in the fusion, and
moves what is left of them. It uses no landmark, and all frames at once, where ``image_motion`` compares
successive pairs.
"""

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Array, Bools
from polhode.pipeline.checks.answer_checks.image_motion import (
    CONTRAST_SCALE_PX,
    MIN_CONTRAST,
    displacements_px,
    erode,
)
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.model_comparison import FrameComparison, chosen_frames, compare_frames
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary_schema import Check

MAX_FRAMES, MIN_FRAMES = 10, 3
"""Frames that are compared, chosen evenly among those with measurements."""
EDGE_PX = 4
"""Pixels at the outline and at the border of the light that are left out."""


def model_check(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    sun_N: Array | None,
) -> Check:
    """Median share of the texture that is displaced; sun_N (3,) unit vector, None: unknown."""
    measured = np.unique(tracks.frame)
    if not len(mesh.faces) or len(measured) < MIN_FRAMES:
        return make_check("rendered model", None)
    frames = measured[chosen_frames(len(measured), MAX_FRAMES)].tolist()
    compared = compare_frames(sequence, rectifier, tracks, estimate, mesh, frames, sun_N)
    shares = [share for each in compared if (share := displaced_share(each)) is not None]
    return make_check(
        "rendered model", 100.0 * float(np.median(shares)) if len(shares) >= MIN_FRAMES else None
    )


def displaced_share(comparison: FrameComparison) -> float | None:
    """Of the texture of one frame, whose picture is at most 256 pixels wide; None: too little texture."""
    image = comparison.image
    lit = erode(comparison.seen & comparison.modelled, EDGE_PX + 1) & (image > 25)
    textured = erode(lit, EDGE_PX + 1) & (_contrast(image, lit) > MIN_CONTRAST)
    if textured.sum() < 300:
        return None
    model = (comparison.gain * comparison.model + comparison.offset).clip(0.0, 255.0)
    ours, theirs = (np.where(lit, each, 0).astype(np.uint8) for each in (model, image))
    return float(np.mean(displacements_px(theirs, ours)[textured] > 1.5))


def _contrast(image: NDArray[np.uint8], known: Bools) -> NDArray[np.float32]:
    """Scatter of the known grey values beside their local mean."""
    grey, weight = image.astype(np.float32), known.astype(np.float32)
    around = np.maximum(cv2.GaussianBlur(weight, (0, 0), CONTRAST_SCALE_PX), 1e-3)
    marks = (grey - cv2.GaussianBlur(grey * weight, (0, 0), CONTRAST_SCALE_PX) / around) * weight
    return np.asarray(np.sqrt(cv2.GaussianBlur(marks**2, (0, 0), CONTRAST_SCALE_PX)), dtype=np.float32)
