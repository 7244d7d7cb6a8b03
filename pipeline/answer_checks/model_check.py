"""Whether the fused surface, moved by the estimate, looks like the images.

The surface with the brightness that fusion gave it, in the Sun that was found, is put before the left camera
at the estimated poses. The optical flow (DIS; Kroeger et al., ECCV 2016) from the image to this picture is
what surface and motion do not explain. A motion that is not the surface's blurs its marks in the fusion, and
moves what is left of them. It uses no landmark, and all frames at once, where ``image_motion`` compares
successive pairs.
"""

from collections.abc import Sequence

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.dataset import StereoSequence
from polhode.frontend.rectification import Rectifier
from polhode.lie import Array
from polhode.pipeline.pictures.model_comparison import FrameComparison, chosen_frames, compare_frames
from polhode.pipeline.run_directory.summary_schema import Check
from polhode.records import Bools, MotionEstimate, StereoTracks

MAX_FRAMES = 10
"""Frames that are compared, chosen evenly among those with measurements."""
MIN_FRAMES = 3
DISPLACED_PX = 1.5
"""Of the compared square, at most 256 pixels wide"""
MAX_SHARE = 0.1
"""Of the textured pixels, displaced; sound runs have at most 0.04"""
MIN_PIXELS = 300
"""Textured pixels of a frame"""
LIT_GREY = 25
EDGE_PX = 4
"""Pixels at the outline and at the border of the light that are left out."""
CONTRAST_SCALE_PX, MIN_CONTRAST = 6.0, 5.0
"""Scale, and least standard deviation of the grey values over it, of a surface with texture."""


def model_check(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    sun_N: Array | None,
) -> Check:
    """Median share of the texture that is displaced; sun_N (3,) unit vector, None: unknown."""
    check = Check(
        name=f"texture displaced against the model's picture by more than {DISPLACED_PX} px",
        limit=100.0 * MAX_SHARE,
        unit="%",
    )
    measured = np.unique(tracks.frame)
    if not len(mesh.faces) or len(measured) < MIN_FRAMES:
        return check
    frames = measured[chosen_frames(len(measured), MAX_FRAMES)].tolist()
    compared = compare_frames(sequence, rectifier, tracks, estimate, mesh, frames, sun_N)
    return judged_shares([displaced_share(each) for each in compared], check)


def judged_shares(found: Sequence[float | None], check: Check) -> Check:
    """The check, from the share of each frame; None: too little texture is seen in it."""
    known = [value for value in found if value is not None]
    if len(known) < MIN_FRAMES:
        return check
    share = 100.0 * float(np.median(known))
    return check.judged(
        share,
        f"the surface, moved by the motion found, does not look like the images: {share:.0f}% of their "
        f"texture is displaced by more than {DISPLACED_PX} px against its pictures (usual: below 4%); the "
        "motion may not be that of the surface",
    )


def displaced_share(comparison: FrameComparison) -> float | None:
    """Of one frame; None: too little texture."""
    image = comparison.image
    lit = _eroded(comparison.seen & comparison.modelled) & (image > LIT_GREY)
    textured = _eroded(lit) & (_contrast(image, lit) > MIN_CONTRAST)
    if textured.sum() < MIN_PIXELS:
        return None
    model = (comparison.gain * comparison.model + comparison.offset).clip(0.0, 255.0)
    ours, theirs = (np.where(lit, each, 0).astype(np.uint8) for each in (model, image))
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(
        theirs, ours, np.zeros((*image.shape, 2), dtype=np.float32)
    )
    return float(np.mean(np.linalg.norm(flow[textured], axis=1) > DISPLACED_PX))


def _eroded(where: Bools) -> Bools:
    size = EDGE_PX + 1
    return np.asarray(cv2.erode(where.astype(np.uint8), np.ones((size, size), dtype=np.uint8)) > 0)


def _contrast(image: NDArray[np.uint8], known: Bools) -> NDArray[np.float32]:
    """Scatter of the known grey values beside their local mean."""
    grey, weight = image.astype(np.float32), known.astype(np.float32)
    around = np.maximum(cv2.GaussianBlur(weight, (0, 0), CONTRAST_SCALE_PX), 1e-3)
    marks = (grey - cv2.GaussianBlur(grey * weight, (0, 0), CONTRAST_SCALE_PX) / around) * weight
    return np.asarray(np.sqrt(cv2.GaussianBlur(marks**2, (0, 0), CONTRAST_SCALE_PX)), dtype=np.float32)
