"""Planes painted with noise, rendered by exact warping."""

import cv2
import numpy as np

from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools

RIG = RectifiedRig(400.0, 159.5, 119.5, 0.1, 320, 240)


def slanted(base_px: float, slope_u: float, slope_v: float) -> Array:
    """Disparity (240, 320) of a plane."""
    v, u = np.mgrid[:240, :320].astype(np.float64)
    return np.asarray(base_px + slope_u * (u - 160) + slope_v * (v - 120))


def rectangle(rows: slice, columns: slice) -> Bools:
    mask = np.zeros((240, 320), dtype=bool)
    mask[rows, columns] = True
    return mask


def pair_of(
    disparity: Array, mask: Bools, bare: Bools | None = None, interpolation: int = cv2.INTER_CUBIC
) -> tuple[Image, Image]:
    """Left and right image of a surface whose disparity at left pixels (240, 320) is an affine function.

    bare (240, 320): the part of it that carries no texture.
    """
    rng = np.random.default_rng(0)
    # noise of several sizes, smooth enough to be sampled between pixels
    layers = [cv2.GaussianBlur(rng.normal(size=(240, 1024)), (0, 0), s) * s for s in (1.2, 2.5, 6.0)]
    painted = np.asarray(layers[0] + layers[1] + layers[2])
    painted = 110.0 + 35.0 * painted / painted.std()
    if bare is not None:
        painted[:, 300:620][bare] = 140.0
    v, u = np.mgrid[:240, :320].astype(np.float32)
    left = painted[:, 300:620] * mask
    # u_right = u - d(u, v): solve for u at every right pixel; d is affine in u.
    slope = (disparity[:, -1] - disparity[:, 0])[:, None] / 319.0
    source = ((u + disparity[:, :1]) / (1.0 - slope)).astype(np.float32)
    inside = cv2.remap(mask.astype(np.float32), source, v, cv2.INTER_NEAREST)
    right = cv2.remap(painted.astype(np.float32), source + 300, v, interpolation) * inside
    noisy = [np.clip(i + 4 + rng.normal(0, 1.5, i.shape), 0, 255) for i in (left, right)]
    return noisy[0].round().astype(np.uint8), noisy[1].round().astype(np.uint8)
