"""The learned method: a network refines semi-global disparities and fills their holes.

The network decides which surface a pixel belongs to; windowed least squares measure better where there is
texture. Both are averaged by their variances, and local planes reduce the noise, as in the classical method.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from polhode.config.frontend import Depth
from polhode.frontend.disparity.classical import refine_dense
from polhode.frontend.disparity.crop import Floats, StereoCrop
from polhode.frontend.disparity.network_input import (
    InitialDisparity,
    hypotheses,
    initial_disparity,
    input_channels,
)
from polhode.frontend.disparity.planes import fit_planes
from polhode.frontend.networks.disparity import STRIDE, DisparityNet, mixture_from_outputs
from polhode.frontend.networks.weights import load_weights, shipped_path
from polhode.records import Bools

NAME = "disparity"
"""Name of the shipped weights."""
_COMPONENTS = 3
"""Components of the mixture that are evaluated: the weaker ones change almost nothing and cost time."""
_WINDOW_PX = 7
_PLANE_RADIUS_PX = 6
_CORRELATED_PX2 = 25.0
_SIGMA_FLOOR_PX = 0.05


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
    refined = refine(_network(config.weights), start)
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
        outputs, guess = network(channels)[:, :, target], hypotheses(padded)[None, :, target]
        mixture = mixture_from_outputs(outputs, guess).strongest(_COMPONENTS)
        mode = mixture.mode()
        values = (mode, mixture.sigma(mode), torch.sigmoid(mixture.visible))
    disparity, sigma, visible = (_as_image(each[0], start.target) for each in values)
    refined = _refine_subpixel(start, disparity, sigma)
    return RefinedDisparity(refined, float(network.sigma_scale) * sigma, visible)


@lru_cache(maxsize=2)
def _network(path: str | None) -> DisparityNet:
    """The network with the shipped weights, or those at ``path``; read once in a process."""
    network = DisparityNet()
    load_weights(network, shipped_path(NAME) if path is None else Path(path))
    return network


def _as_image(values: Tensor, target: Bools) -> Floats:
    """Values (n,) of the target's pixels as an image, NaN elsewhere; the padding contains no target."""
    image = np.full(target.shape, np.nan, dtype=np.float32)
    image[target] = values.numpy()
    return image


def _refine_subpixel(start: InitialDisparity, disparity: Floats, sigma: Floats) -> Floats:
    """Disparity (h, w) [px] from the network's disparity and sigma; NaN stays NaN."""
    margin = ((0, 0), (start.margin_px, start.margin_px))
    left = np.pad(start.left, margin, mode="edge")
    measured, sigma_window = refine_dense(left, start.right, disparity, start.margin_px, _WINDOW_PX)
    weight = sigma**2 / (sigma**2 + sigma_window**2 + _SIGMA_FLOOR_PX**2)
    mean = (disparity + weight * (measured - disparity)).astype(np.float32)
    mean_sigma = (sigma * np.sqrt(1.0 - weight)).astype(np.float32)
    plane, _ = fit_planes(mean, mean_sigma, _PLANE_RADIUS_PX, _CORRELATED_PX2)
    # Where no window holds enough of one surface, the pixel keeps its own value.
    return np.where(np.isfinite(plane), plane, mean).astype(np.float32)
