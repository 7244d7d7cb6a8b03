"""Sub-pixel alignment of known surface patches in another image: least squares on grey values.

As in Lucas and Kanade 1981; patches are cut in the tangent plane, and the shift is estimated in patch
coordinates together with gain and offset. Changes of illumination alter a patch more than its shift does, so
the sigma of the fit is a lower bound.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.frontend.features.patches import Patches, cut_patches
from polhode.frontend.rectification.target import Image
from polhode.lie import Array

Floats = NDArray[np.float32]
WINDOW = 0.5
"""Standard deviation of the weight around the centre, over half a side."""
ROUNDS = 6
_MAX_STEP = 0.1
"""In patch coordinates, where half a side is 1."""


@dataclass(frozen=True)
class PatchAlignment:
    """Positions of n patches."""

    uv_px: Array
    """(n, 2)"""
    correlation: Array
    """(n,) of the weighted grey values"""
    sigma_px: Array
    """(n,) standard deviation of the position, from the residuals"""


def align_patches(template: Patches, image: Image, uv_px: Array, affine_px: Array) -> PatchAlignment:
    """Find templates (n, 1, s, s) near positions (n, 2) of an image, cut by maps (n, 2, 2) [px]."""
    n, size = len(template), template.shape[-1]
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    weight = np.exp(-(side[:, None] ** 2 + side[None, :] ** 2) / (2.0 * WINDOW**2)).astype(np.float32)
    weight /= weight.sum()
    shift = np.zeros((n, 2))
    target = _centred(template[:, 0], weight)
    for _ in range(ROUNDS):
        normal, rhs, _, _ = _equations(target, image, uv_px, affine_px, shift, weight)
        step = np.linalg.solve(normal, rhs[..., None])[..., 0]
        shift += np.clip(step, -_MAX_STEP, _MAX_STEP)
    normal, _, variance, correlation = _equations(target, image, uv_px, affine_px, shift, weight)
    # Effective number of samples of the weight.
    samples = 1.0 / float(np.sum(weight**2))
    covariance = affine_px @ np.linalg.inv(normal) @ np.swapaxes(affine_px, 1, 2)
    spread = 0.5 * np.trace(covariance, axis1=1, axis2=2) * variance / samples
    return PatchAlignment(uv_px + np.einsum("nab,nb->na", affine_px, shift), correlation, np.sqrt(spread))


def _centred(patches: Floats, weight: Floats) -> Floats:
    mean = np.einsum("nij,ij->n", patches, weight)
    return np.asarray(patches - mean[:, None, None], dtype=np.float32)


def _equations(
    target: Floats, image: Image, uv_px: Array, affine_px: Array, shift: Array, weight: Floats
) -> tuple[Array, Array, Array, Array]:
    """Normal matrices (n, 2, 2) and right-hand sides (n, 2) of the shift; residual variance; correlation."""
    size = target.shape[-1]
    positions = uv_px + np.einsum("nab,nb->na", affine_px, shift)
    seen = _centred(cut_patches(image, positions, affine_px, size)[:, 0], weight)
    gx, gy = np.zeros_like(seen), np.zeros_like(seen)
    gx[:, :, 1:-1] = (seen[:, :, 2:] - seen[:, :, :-2]) * (size / 4.0)
    gy[:, 1:-1, :] = (seen[:, 2:, :] - seen[:, :-2, :]) * (size / 4.0)
    common = np.einsum("nij,nij,ij->n", seen, target, weight)
    own = np.einsum("nij,nij,ij->n", seen, seen, weight)
    gain = np.clip(common / np.maximum(own, 1e-6), 0.2, 5.0)
    residual = target - gain[:, None, None].astype(np.float32) * seen
    slopes = [_centred(g, weight) * gain[:, None, None].astype(np.float32) for g in (gx, gy)]
    grams = [[np.einsum("nij,nij,ij->n", a, b, weight) for b in slopes] for a in slopes]
    # The regularisation of one squared grey level keeps patches without texture in place.
    normal = np.array(grams, dtype=np.float64).transpose(2, 0, 1) + np.eye(2)
    rhs = np.stack([np.einsum("nij,nij,ij->n", a, residual, weight) for a in slopes], axis=1)
    variance = np.einsum("nij,nij,ij->n", residual, residual, weight)
    power = np.einsum("nij,nij,ij->n", target, target, weight)
    correlation = common / np.sqrt(np.maximum(own * power, 1e-9))
    return normal, rhs.astype(np.float64), variance.astype(np.float64), correlation.astype(np.float64)
