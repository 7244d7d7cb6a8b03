"""True disparities of simulated sequences, in the rectified pair.

The simulator writes the depth of every pixel of the unrectified images (``truth0``, ``truth1``). Here it is
transformed to the rectified images, together with the visibility of each pixel's surface in the other camera.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.dataset import StereoCalibration, StereoSequence
from polhode.errors import InputError
from polhode.frontend.disparity.crop import Floats
from polhode.frontend.rectification.rectify import Rectifier
from polhode.lie import Array, inverse_pose
from polhode.records import Bools
from polhode.simulation.dataset.frame_renderer import products_path, read_products

_SAME_SURFACE_PX = 1.0
"""Largest difference of the disparities of a point that both cameras see."""


@dataclass(frozen=True)
class TrueDisparity:
    """Truth (H, W) of one rectified image."""

    disparity: Floats
    """[px], NaN outside the target"""
    visible: Bools
    """the other camera sees the same surface"""
    sunlit: Bools
    """in direct sunlight"""


def true_disparities(
    sequence: StereoSequence, rectifier: Rectifier, k: int
) -> tuple[TrueDisparity, TrueDisparity]:
    """True disparities of the left and the right image of pair k. Raises InputError: the truth is missing."""
    depth, shadow = zip(*(_products(sequence.folder, side, sequence, k) for side in (0, 1)), strict=True)
    rig = rectifier.rig
    disparity, sunlit = [], []
    for side in (0, 1):
        z = rectified_depth(depth[side], sequence.calibration, rectifier, side)
        disparity.append((rig.focal_px * rig.baseline_m / z + rig.disparity_offset_px).astype(np.float32))
        shadowed = _resampled(shadow[side].astype(np.float32), rectifier, side)
        sunlit.append(np.isfinite(z) & (shadowed == 0))
    return (
        TrueDisparity(disparity[0], _visible(disparity[0], disparity[1], 1), sunlit[0]),
        TrueDisparity(disparity[1], _visible(disparity[1], disparity[0], -1), sunlit[1]),
    )


def rectified_depth(depth: Array, calibration: StereoCalibration, rectifier: Rectifier, side: int) -> Array:
    """Depth (H', W') [m] along the rectified axis from depth (H, W) along a camera's own axis."""
    own_depth = _resampled(depth.astype(np.float32), rectifier, side).astype(np.float64)
    rig = rectifier.rig
    centre = rig.cx_px - (rig.disparity_offset_px if side == 1 else 0.0)
    v, u = np.mgrid[: own_depth.shape[0], : own_depth.shape[1]]
    ray_R = np.stack([(u - centre) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones(u.shape)], axis=-1)
    R_KR = rectifier.X_CR[:3, :3]
    if side == 1:
        X_CD = inverse_pose(calibration.X_BC0) @ calibration.X_BC1
        R_KR = X_CD[:3, :3].T @ R_KR
    return np.asarray(own_depth / (ray_R @ R_KR[2]))


def _products(folder: Path, side: int, sequence: StereoSequence, k: int) -> tuple[Array, NDArray[np.uint8]]:
    path = products_path(folder / "mav0", side, int(sequence.timestamps_ns[k]))
    found = read_products(path)
    if found.depth is None or found.shadow is None:
        raise InputError(f"{path}: contains no depth or no shadow; simulate with scene.render.products")
    return found.depth, found.shadow


def _resampled(image: Floats, rectifier: Rectifier, side: int) -> Floats:
    """The rectified image, from the nearest pixels; NaN outside the original image."""
    if rectifier.maps is None:
        return image
    map_u, map_v = rectifier.maps[side]
    return np.asarray(
        cv2.remap(
            image, map_u, map_v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan")
        ),
        dtype=np.float32,
    )


def _visible(disparity: Floats, other: Floats, sign: int) -> Bools:
    """Pixels for which one of the nearest pixels of the other image, at u - sign * disparity, agrees."""
    h, w = disparity.shape
    target = np.isfinite(disparity)
    there = np.arange(w)[None, :] - sign * np.where(target, disparity, 0.0)
    visible = np.zeros((h, w), dtype=bool)
    for column in (np.floor(there), np.ceil(there)):
        inside = (column >= 0) & (column < w)
        found = np.take_along_axis(other, np.clip(column, 0, w - 1).astype(np.int64), axis=1)
        with np.errstate(invalid="ignore"):
            visible |= inside & (np.abs(found - disparity) < _SAME_SURFACE_PX)
    return np.asarray(visible & target)
