"""Landmarks of one image by the surface network: their places, and the descriptions of the surface there.

The network looks once at the target's part of the image; places come from its map of scores, descriptions
from rings that are cut from its channels in the tangent planes of the surface.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from polhode.frontend.features.keypoints import FeatureCandidates
from polhode.frontend.features.patch_descriptors import PatchDescriptions, describe
from polhode.frontend.networks.surface import (
    ANGLES,
    CHANNELS,
    INNERMOST,
    OUTERMOST,
    RINGS,
    SMOOTH_FROM,
    STRIDE_PX,
    SurfaceNet,
    find_places,
    ring_positions,
    smoothed_channels,
)
from polhode.frontend.networks.weights import load_weights, multiplies_in_bfloat16, shipped_path
from polhode.frontend.rectification import Image, target_crop
from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.compiled import compiled_reordered

Floats = NDArray[np.float32]
NAME = "surface"
"""Name of the shipped weights."""
_BLUR_STEPS = np.sqrt(2.0) ** np.arange(9)
"""Pixels of the image between rings for which the channels are smoothed."""


@cache
def surface_network(path: Path | None = None) -> SurfaceNet:
    """The network with the weights of a file, or the shipped ones. Raises InputError as ``load_weights``."""
    network = SurfaceNet()
    load_weights(network, path or shipped_path(NAME))
    return network


class SurfaceLook:
    """One image as the network sees it."""

    def __init__(self, network: SurfaceNet, image: Image, mask: Bools) -> None:
        self._network = network
        crop = target_crop(mask)
        self._is_empty = crop is None
        if crop is None:
            return
        rows, columns = slice(crop.v0, crop.v1), slice(crop.u0, crop.u1)
        part, on_target = image[rows, columns], mask[rows, columns]
        self._corner = np.array([crop.u0, crop.v0], float)
        # longest side of what the network looks at; larger targets are reduced [px]
        self._zoom = min(1.0, 640 / max(part.shape))
        part = np.where(
            cv2.dilate(on_target.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0, part, np.uint8(0)
        )
        if self._zoom < 1.0:
            size = tuple(max(8, round(side * self._zoom)) for side in part.shape[::-1])
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
            on_target = cv2.resize(on_target.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        height, width = part.shape
        framed = np.zeros(
            (-(-height // STRIDE_PX) * STRIDE_PX, -(-width // STRIDE_PX) * STRIDE_PX), np.float32
        )
        framed[:height, :width] = part
        self._mask = np.zeros(framed.shape, bool)
        self._mask[:height, :width] = on_target
        with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
            self._dense = network.dense(torch.from_numpy(framed)[None, None])

    def candidates(self, count: int) -> tuple[FeatureCandidates, Array]:
        """The ``count`` best landmarks, and the standard deviation (n,) of their places, each axis [px]."""
        if self._is_empty:
            return FeatureCandidates(np.zeros((0, 2)), np.zeros(0), np.zeros(0)), np.zeros(0)
        with torch.inference_mode():
            found = find_places(self._dense, 0, torch.from_numpy(self._mask), count)
        uv = found.uv_px.numpy().astype(np.float64)
        # landmarks in the same cell are one [px]
        first = np.unique(np.floor(uv / 0.75).astype(int), axis=0, return_index=True)[1]
        first.sort()
        sigma = np.exp(found.log_sigma.numpy().astype(np.float64))[first] / self._zoom
        response = torch.sigmoid(found.score).numpy().astype(np.float64)[first]
        scale = np.full(len(first), 1.5 / self._zoom)  # scale of a landmark, as of a blob [px]
        uv = (uv[first] + 0.5) / self._zoom - 0.5 + self._corner
        return FeatureCandidates(uv, scale, response), sigma

    def describe(self, uv_px: Array, affine_px: Array) -> PatchDescriptions:
        """The surface around points (n, 2), by maps (n, 2, 2) of their upright patches."""
        if len(uv_px) == 0:
            return describe(self._network.describe, np.zeros((0, CHANNELS, RINGS, ANGLES), np.float32))
        uv = (uv_px - self._corner + 0.5) * self._zoom - 0.5
        return describe(
            self._network.describe, cut_rings(self._dense.channels[0], uv, affine_px * self._zoom)
        )


def cut_rings(channels: torch.Tensor, uv_px: Array, affine_px: Array) -> Floats:
    """Rings (n, c, rings, angles) of channels (c, H, W) around uv_px (n, 2), by maps (n, 2, 2).

    They are those of ``sample_rings``; channels are smoothed where rings are more than a pixel apart.
    """
    rings = np.empty((len(uv_px), CHANNELS, RINGS, ANGLES), np.float32)
    positions = ring_positions().numpy().astype(np.float64)
    step = np.sqrt(np.abs(np.linalg.det(affine_px))) * (OUTERMOST - INNERMOST) / (RINGS - 1)
    level = np.abs(np.log(np.maximum(step, 1e-6))[:, None] - np.log(_BLUR_STEPS)).argmin(axis=1)
    for k in np.unique(level):
        smooth = _smoothed(channels, float(_BLUR_STEPS[k]))
        with torch.inference_mode():
            outer = smoothed_channels(smooth[None])[0]
        last = [np.ascontiguousarray(each.permute(1, 2, 0).numpy()) for each in (smooth, outer)]
        _cut_rings(last[0], last[1], uv_px, affine_px, positions, np.flatnonzero(level == k), rings)
    return rings


def _smoothed(channels: torch.Tensor, step_px: float) -> torch.Tensor:
    """Channels (c, H, W) smoothed for rings that are ``step_px`` apart."""
    if step_px <= 1.2:
        return channels
    sigma = 0.5 * float(np.sqrt(step_px**2 - 1.0))
    return torch.from_numpy(np.stack([cv2.GaussianBlur(each, (0, 0), sigma) for each in channels.numpy()]))


@compiled_reordered
def _cut_rings(
    inner: Floats,
    outer: Floats,
    uv_px: Array,
    affine_px: Array,
    positions: Array,
    chosen: Ints,
    rings: Floats,
) -> None:
    height, width, channels = inner.shape
    for k in chosen:
        for ring in range(RINGS):
            source = inner if ring < SMOOTH_FROM else outer
            for angle in range(ANGLES):
                x, y = positions[ring, angle]
                at_u = uv_px[k, 0] + affine_px[k, 0, 0] * x + affine_px[k, 0, 1] * y
                at_v = uv_px[k, 1] + affine_px[k, 1, 0] * x + affine_px[k, 1, 1] * y
                at_u = min(max(at_u, 0.0), width - 1.0)
                at_v = min(max(at_v, 0.0), height - 1.0)
                left, top = min(int(at_u), width - 2), min(int(at_v), height - 2)
                s, t = np.float32(at_u - left), np.float32(at_v - top)
                for c in range(channels):
                    upper = source[top, left, c] + s * (source[top, left + 1, c] - source[top, left, c])
                    below = source[top + 1, left, c]
                    lower = below + s * (source[top + 1, left + 1, c] - below)
                    rings[k, c, ring, angle] = upper + t * (lower - upper)
