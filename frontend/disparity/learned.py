"""The learned method: a network refines semi-global disparities and fills their holes.

Input: every pixel gets six hypotheses of its disparity: the checked and refined classical disparity with its
holes filled; the farthest and the nearest disparity in the neighbourhood (a pixel at an occluding edge
belongs to one of the two); the disparity of semi-global matching before the left-right check; the plane of a
textureless facet; and the disparity of matching at half the resolution, where weak texture counts more. The
right image is warped to the left one by Kornia's differentiable remap, for a small slice of the cost volume
around the first hypothesis and for each of the others; the matching costs are the channels.

The network decides which surface a pixel belongs to; windowed least squares measure better where there is
texture. Both are averaged by their variances, and local planes reduce the noise, as in the classical method.
"""

from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import torch
from kornia.geometry.transform import remap
from numpy.typing import NDArray
from torch import Tensor

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.classical import (
    MIN_MATCHED_PIXELS,
    PLANE_RADIUS_PX,
    SIGMA_FLOOR_PX,
    crop_facets,
    fit_planes,
    refine_dense,
)
from polhode.frontend.disparity.sgbm import Floats, StereoCrop, match_coarse, match_left_right
from polhode.frontend.networks.disparity import OFFSETS_PX, STRIDE, DisparityNet, mixture_from_outputs
from polhode.frontend.networks.weights import load_weights, multiplies_in_bfloat16, shipped_path
from polhode.geometry.lie import Bools
from polhode.runtime.compiled import compiled_fused_ieee

REACH_PX = 5
"""Radius of the neighbourhood of the nearest and the farthest disparity."""
_CONTRAST_WINDOW_PX = 9
_TRUST_PX = 0.3
_MAX_COST = 3.0
_GREY_SCALE = 32.0
_ALTERNATIVE_SCALE_PX = 8.0
_PLANE_SCALE_PX = 16.0
NAME = "disparity"
"""Name of the shipped weights."""
_CORRELATED_PX2 = 25.0


@dataclass(frozen=True)
class InitialDisparity:
    """Images and hypotheses on the crop (h, w)."""

    left: Floats
    """(h, w) grey levels above the sky"""
    right: Floats
    """(h, w + 2 margin) grey levels above the sky"""
    even_left: Floats
    """(h, w) the local mean subtracted, divided by the local contrast"""
    even_right: Floats
    """(h, w + 2 margin)"""
    filled: Floats
    """(h, w) [px] finite everywhere"""
    far: Floats
    near: Floats
    unchecked: Floats
    facet: Floats
    coarse: Floats
    facet_trust: Floats
    """(h, w) from 1 on a facet whose plane is certain to 0 outside facets"""
    sigma: Floats
    """(h, w) of ``filled`` [px] from the least squares; NaN in filled holes"""
    lit: Bools
    target: Bools
    margin_px: int

    def part(self, rows: slice, columns: slice) -> "InitialDisparity":
        """The rectangle of the given rows and columns of the crop, with the margins of the right images."""
        wide = slice(columns.start, columns.stop + 2 * self.margin_px)
        cut = {
            f.name: getattr(self, f.name)[rows, wide if "right" in f.name else columns]
            for f in fields(self)
            if f.name != "margin_px"
        }
        return InitialDisparity(**cut, margin_px=self.margin_px)

    def padded(self, more: tuple[int, int]) -> "InitialDisparity":
        """With copies of the last rows and columns added below and on the right; none of them is target."""
        pads = ((0, more[0]), (0, more[1]))
        grown: dict[str, NDArray[np.generic]] = {}
        for f in fields(self):
            if f.name in ("lit", "target"):
                grown[f.name] = np.pad(getattr(self, f.name), pads)
            elif f.name != "margin_px":
                grown[f.name] = np.pad(getattr(self, f.name), pads, mode="edge")
        return InitialDisparity(**grown, margin_px=self.margin_px)  # type: ignore[arg-type]


def initial_disparity(crop: StereoCrop, config: Depth) -> InitialDisparity | None:
    """Match, refine once, fill holes; None when almost nothing matches."""
    checked, unchecked = match_left_right(crop, config)
    if np.isfinite(checked).sum() < MIN_MATCHED_PIXELS:
        return None
    refined, sigma = refine_dense(crop.left, crop.right, checked, crop.search_px)
    filled = fill_holes(refined)
    facet, sigma_facet = crop_facets(crop, refined, sigma)
    flat = np.isfinite(facet)
    known = np.isfinite(refined)
    kernel = np.ones((2 * REACH_PX + 1, 2 * REACH_PX + 1), dtype=np.uint8)
    near = np.asarray(cv2.dilate(np.where(known, refined, -1e9).astype(np.float32), kernel))
    far = np.asarray(cv2.erode(np.where(known, refined, 1e9).astype(np.float32), kernel))
    n, w = crop.search_px, crop.target.shape[1]
    levels = [image.astype(np.float32) - np.float32(crop.sky) for image in (crop.left, crop.right)]
    even = [normalise_contrast(image) for image in levels]
    return InitialDisparity(
        left=levels[0][:, n : n + w],
        right=levels[1],
        even_left=even[0][:, n : n + w],
        even_right=even[1],
        filled=filled,
        far=np.where(far < 1e8, far, filled),
        near=np.where(near > -1e8, near, filled),
        unchecked=np.where(np.isfinite(unchecked), unchecked, filled),
        facet=np.where(flat, facet, filled),
        coarse=fill_holes(match_coarse(crop, config)),
        facet_trust=np.where(flat, np.exp(-sigma_facet / _TRUST_PX), 0.0).astype(np.float32),
        sigma=sigma,
        lit=crop.lit,
        target=crop.target,
        margin_px=n,
    )


def normalise_contrast(image: Floats) -> Floats:
    """Grey levels minus the local mean, in units of the local contrast."""
    size = (_CONTRAST_WINDOW_PX, _CONTRAST_WINDOW_PX)
    mean = cv2.blur(image, size)
    variance = np.maximum(cv2.blur(image * image, size) - mean * mean, 0.0)
    # added to the standard deviation of a window [8-bit levels], so that noise is not amplified to texture
    return np.asarray((image - mean) / (np.sqrt(variance) + 4.0), dtype=np.float32)


def fill_holes(disparity: Floats) -> Floats:
    """NaN replaced by a smooth surface through the known values: means of successively coarser images."""
    known = np.isfinite(disparity)
    value, weight = np.where(known, disparity, 0.0).astype(np.float32), known.astype(np.float32)
    if known.all() or not known.any():
        return value
    h, w = disparity.shape
    if max(h, w) == 1:
        return value
    half = ((w + 1) // 2, (h + 1) // 2)
    weight_half = cv2.resize(weight, half, interpolation=cv2.INTER_AREA)
    value_half = cv2.resize(value * weight, half, interpolation=cv2.INTER_AREA)
    seen = weight_half > 1e-6
    coarse = np.where(seen, value_half / np.where(seen, weight_half, 1.0), np.nan).astype(np.float32)
    below = cv2.resize(fill_holes(coarse), (w, h), interpolation=cv2.INTER_LINEAR)
    return np.where(known, value, below).astype(np.float32)


def hypotheses(start: InitialDisparity) -> Tensor:
    """(6, h, w) [px]: filled, far, near, unchecked, facet, coarse."""
    named = [start.filled, start.far, start.near, start.unchecked, start.facet, start.coarse]
    return torch.from_numpy(np.stack(named))


def input_channels(start: InitialDisparity) -> Tensor:
    """Channels (1, CHANNELS, h, w), each of order one."""
    guess = hypotheses(start)
    left = torch.from_numpy(np.ascontiguousarray(start.even_left))
    right = torch.from_numpy(np.ascontiguousarray(start.even_right))
    steps = torch.tensor(OFFSETS_PX)[:, None, None]
    warped = warp_right(right, torch.cat([guess[:1] + steps, guess[1:]]), start.margin_px)
    cost = (warped - left).abs().clamp(max=_MAX_COST)
    middle = OFFSETS_PX.index(0.0)
    difference = left - warped[middle]
    # The products of difference and slope, and the squared slopes, are the terms that least squares sum.
    slope = warped[middle - 1] - warped[middle + 1]
    alternatives = ((guess[1:] - guess[:1]) / _ALTERNATIVE_SCALE_PX).clamp(-2.0, 2.0)
    log_left, log_right = (
        torch.log1p(torch.from_numpy(np.ascontiguousarray(image)).clamp(min=0.0) / _GREY_SCALE)
        for image in (start.left, start.right)
    )
    brighter = warp_right(log_right, guess[:1], start.margin_px)[0] - log_left
    # the first hypothesis relative to its mean, and its slopes
    first, target = guess[0], torch.from_numpy(np.ascontiguousarray(start.target))
    mean = first[target].mean() if bool(target.any()) else first.mean()
    around = ((first - mean) / _PLANE_SCALE_PX).clamp(-2.0, 2.0)
    du = torch.nn.functional.pad((first[:, 2:] - first[:, :-2]) / 2.0, (1, 1))
    dv = torch.nn.functional.pad((first[2:] - first[:-2]) / 2.0, (0, 0, 1, 1))
    known = np.isfinite(start.sigma)
    certainty: list[NDArray[np.generic]] = [
        known,
        np.log(np.clip(np.where(known, start.sigma, 2.0), 0.01, 2.0)) / 2.0,
        start.lit,
        start.target,
        np.clip((start.near - start.far) / _ALTERNATIVE_SCALE_PX, 0.0, 2.0),
        np.clip(np.abs(start.unchecked - start.filled), 0.0, 2.0),
        start.facet_trust,
    ]
    channels = [
        cost,
        alternatives,
        torch.stack([left, difference.clamp(-3.0, 3.0), (difference * slope).clamp(-4.0, 4.0), slope**2]),
        torch.stack([log_left - 1.0, brighter]),
        torch.stack([around, (2.0 * du).clamp(-1.0, 1.0), (2.0 * dv).clamp(-1.0, 1.0)]),
        torch.from_numpy(np.stack([each.astype(np.float32) for each in certainty])),
    ]
    return torch.cat(channels)[None]


def warp_right(right: Tensor, disparity: Tensor, margin_px: int) -> Tensor:
    """The right image (h, w + 2 margin) warped to the left one by k disparities (k, h, w) [px].

    Differentiable in both; where neither needs a derivative, by a compiled loop.
    """
    k, h, w = disparity.shape
    if not (torch.is_grad_enabled() and (right.requires_grad or disparity.requires_grad)):
        return torch.from_numpy(shift_rows(right.numpy(), disparity.numpy(), margin_px))
    u = torch.arange(w, dtype=disparity.dtype) + margin_px - disparity
    v = torch.arange(h, dtype=disparity.dtype)[None, :, None].expand(k, h, w)
    # One tall image holds the k maps below each other.
    warped: Tensor = remap(
        right[None, None],
        u.reshape(1, k * h, w),
        v.reshape(1, k * h, w),
        mode="bilinear",
        padding_mode="border",
        align_corners=True,
    )
    return warped.reshape(k, h, w)


@compiled_fused_ieee
def shift_rows(right: Floats, disparity: Floats, margin_px: int) -> Floats:
    """As ``warp_right``, linearly interpolated along the rows; the border is repeated."""
    k, h, w = disparity.shape
    last = right.shape[1] - 1
    out = np.empty((k, h, w), dtype=right.dtype)
    for n in range(k):
        for v in range(h):
            row = right[v]
            for u in range(w):
                at = min(max(u + margin_px - disparity[n, v, u], np.float32(0.0)), np.float32(last))
                low = min(np.int64(at), last - 1)
                share = at - low
                out[n, v, u] = row[low] + share * (row[low + 1] - row[low])
    return out


@dataclass(frozen=True)
class RefinedDisparity:
    """Estimates at the target's pixels (h, w), also where the initial disparity is unknown; NaN elsewhere."""

    disparity: Floats
    """[px]"""
    sigma: Floats
    """[px] half the width of the interval that contains the true disparity with a probability of 68 %"""
    visible: Floats
    """probability that both cameras see the surface"""


def network_disparity(crop: StereoCrop, config: Depth) -> tuple[Floats, Floats]:
    """Disparities and their standard deviations (h, w) [px]; NaN where the right camera sees nothing."""
    start = initial_disparity(crop, config)
    if start is None:
        unknown = np.full(crop.target.shape, np.nan, dtype=np.float32)
        return unknown, unknown.copy()
    refined = refine(disparity_network(config.weights), start)
    known = crop.target & (refined.visible > config.min_visible)
    return (
        np.where(known, refined.disparity, np.float32(np.nan)),
        np.where(known, refined.sigma, np.float32(np.nan)),
    )


def refine(network: DisparityNet, start: InitialDisparity) -> RefinedDisparity:
    """One pass of the network over the crop, then least squares and planes."""
    h, w = start.filled.shape
    padded = start.padded(((-h) % STRIDE, (-w) % STRIDE))
    with torch.no_grad():
        channels = input_channels(padded).contiguous(memory_format=torch.channels_last)
        target = torch.from_numpy(padded.target)
        with torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
            raw = network(channels)
        outputs, guess = raw[:, :, target], hypotheses(padded)[None, :, target]
        # components of the mixture that are evaluated: the weaker ones change almost nothing and cost time
        mixture = mixture_from_outputs(outputs, guess).strongest(3)
        mode = mixture.mode()
        values = (mode, mixture.sigma(mode), torch.sigmoid(mixture.visible))
    disparity, sigma, visible = images = [np.full((h, w), np.nan, dtype=np.float32) for _ in values]
    for image, each in zip(images, values, strict=True):
        # the padding contains no target
        image[start.target] = each[0].numpy()
    left = np.pad(start.left, ((0, 0), (start.margin_px, start.margin_px)), mode="edge")
    measured, sigma_window = refine_dense(left, start.right, disparity, start.margin_px)
    weight = sigma**2 / (sigma**2 + sigma_window**2 + SIGMA_FLOOR_PX**2)
    mean = (disparity + weight * (measured - disparity)).astype(np.float32)
    mean_sigma = (sigma * np.sqrt(1.0 - weight)).astype(np.float32)
    plane, _ = fit_planes(mean, mean_sigma, PLANE_RADIUS_PX, _CORRELATED_PX2)
    # Where no window holds enough of one surface, the pixel keeps its own value.
    refined = np.where(np.isfinite(plane), plane, mean).astype(np.float32)
    return RefinedDisparity(refined, float(network.sigma_scale) * sigma, visible)


@lru_cache(maxsize=2)
def disparity_network(path: str | None) -> DisparityNet:
    """The network with the shipped weights, or those at ``path``; read once in a process.

    Raises InputError: ``path`` has no weights of this network.
    """
    network = DisparityNet()
    load_weights(network, shipped_path(NAME) if path is None else Path(path))
    return network
