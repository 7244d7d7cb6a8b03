"""Where exactly a known surface patch lies in another image: least squares on grey values.

Lucas and Kanade 1981: the image is cut along the surface, the shift is found in the
patch's own coordinates, gain and offset are free. Light that moves changes a patch more than its place does,
so the fit's own sigma is a lower bound.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.frontend.features.patches import Patches, cut_patches
from polhode.frontend.rectification.target import Image
from polhode.lie import Array

Floats = NDArray[np.float32]
WINDOW = 0.5
"""Standard deviation of the weight around the middle, over half a side."""
ROUNDS = 6
_LARGEST_STEP = 0.1
"""In patch coordinates, where half a side is 1."""


@dataclass(frozen=True)
class Alignment:
    """Where n patches were found."""

    uv_px: Array
    """(n, 2)"""
    correlation: Array
    """(n,) of the weighted grey values there"""
    sigma_px: Array
    """(n,) of the place, by the residuals"""


def root_image(image: Image) -> Image:
    """Roots of the grey values: the noise is even, and what lies in the dark counts."""
    return np.asarray(np.round(16.0 * np.sqrt(image.astype(np.float32))), dtype=np.uint8)


def align_patches(template: Patches, image: Image, uv_px: Array, affine_px: Array) -> Alignment:
    """Look for templates (n, 1, s, s) around places (n, 2) of an image, cut by maps (n, 2, 2) [px]."""
    n, size = len(template), template.shape[-1]
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    weight = np.exp(-(side[:, None] ** 2 + side[None, :] ** 2) / (2.0 * WINDOW**2)).astype(np.float32)
    weight /= weight.sum()
    shift = np.zeros((n, 2))
    wanted = _centred(template[:, 0], weight)
    for _ in range(ROUNDS):
        normal, rhs, _, _ = _equations(wanted, image, uv_px, affine_px, shift, weight)
        step = np.linalg.solve(normal, rhs[..., None])[..., 0]
        shift += np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
    normal, _, left_over, correlation = _equations(wanted, image, uv_px, affine_px, shift, weight)
    # The weight's effective number of samples: neighbours in a patch are not independent.
    samples = 1.0 / float(np.sum(weight**2))
    covariance = affine_px @ np.linalg.inv(normal) @ np.swapaxes(affine_px, 1, 2)
    spread = 0.5 * np.trace(covariance, axis1=1, axis2=2) * left_over / samples
    return Alignment(uv_px + np.einsum("nab,nb->na", affine_px, shift), correlation, np.sqrt(spread))


def _centred(patches: Floats, weight: Floats) -> Floats:
    mean = np.einsum("nij,ij->n", patches, weight)
    return np.asarray(patches - mean[:, None, None], dtype=np.float32)


def _equations(
    wanted: Floats, image: Image, uv_px: Array, affine_px: Array, shift: Array, weight: Floats
) -> tuple[Array, Array, Array, Array]:
    """Normal matrices (n, 2, 2) and right-hand sides (n, 2) of the shift; variance left over, correlation."""
    size = wanted.shape[-1]
    places = uv_px + np.einsum("nab,nb->na", affine_px, shift)
    seen = _centred(cut_patches(image, places, affine_px, size)[:, 0], weight)
    gx, gy = np.zeros_like(seen), np.zeros_like(seen)
    gx[:, :, 1:-1] = (seen[:, :, 2:] - seen[:, :, :-2]) * (size / 4.0)
    gy[:, 1:-1, :] = (seen[:, 2:, :] - seen[:, :-2, :]) * (size / 4.0)
    common = np.einsum("nij,nij,ij->n", seen, wanted, weight)
    own = np.einsum("nij,nij,ij->n", seen, seen, weight)
    gain = np.clip(common / np.maximum(own, 1e-6), 0.2, 5.0)
    residual = wanted - gain[:, None, None].astype(np.float32) * seen
    slopes = [_centred(g, weight) * gain[:, None, None].astype(np.float32) for g in (gx, gy)]
    grams = [[np.einsum("nij,nij,ij->n", a, b, weight) for b in slopes] for a in slopes]
    # One grey level squared: what has no texture stays where it is.
    normal = np.array(grams, dtype=np.float64).transpose(2, 0, 1) + np.eye(2)
    rhs = np.stack([np.einsum("nij,nij,ij->n", a, residual, weight) for a in slopes], axis=1)
    left_over = np.einsum("nij,nij,ij->n", residual, residual, weight)
    power = np.einsum("nij,nij,ij->n", wanted, wanted, weight)
    correlation = common / np.sqrt(np.maximum(own * power, 1e-9))
    return normal, rhs.astype(np.float64), left_over.astype(np.float64), correlation.astype(np.float64)
