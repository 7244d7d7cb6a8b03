"""Disparity, uncertainty and visibility by the trained network and a last polish, from a classical start."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from polhode.frontend.disparity.evidence import evidence, hypotheses
from polhode.frontend.disparity.polish import polish
from polhode.frontend.disparity.start import Start
from polhode.frontend.networks.disparity import STRIDE, DisparityNet, read_mixture
from polhode.records import Bools

Floats = NDArray[np.float32]
_COMPONENTS = 3
"""Of the mixture, the strongest: the others change next to nothing and cost time."""


@dataclass(frozen=True)
class Refined:
    """What the network says of the target's pixels (h, w), also where the start knew nothing."""

    disparity: Floats
    """[px]; NaN beside the target"""
    sigma: Floats
    """[px] half the width of the interval that holds the true disparity with a probability of 68 %"""
    visible: Floats
    """probability that both cameras see the surface; NaN beside the target"""


def refine(network: DisparityNet, start: Start) -> Refined:
    """One pass over the crop, then least squares and planes."""
    h, w = start.filled.shape
    grown = padded(start, ((-h) % STRIDE, (-w) % STRIDE))
    with torch.no_grad():
        channels = evidence(grown).contiguous(memory_format=torch.channels_last)
        target = torch.from_numpy(grown.target)
        outputs, guess = network(channels)[:, :, target], hypotheses(grown)[None, :, target]
        mixture = read_mixture(outputs, guess).strongest(_COMPONENTS)
        disparity = mixture.mode()
        sigma = mixture.sigma(disparity)
        visible = torch.sigmoid(mixture.visible)
    placed = [_placed(values[0], start.target) for values in (disparity, sigma, visible)]
    return Refined(polish(start, placed[0], placed[1]), float(network.sigma_scale) * placed[1], placed[2])


def padded(start: Start, more: tuple[int, int]) -> Start:
    """Rows and columns added below and on the right, copies of the last ones; none of them is target."""
    pads = ((0, more[0]), (0, more[1]))
    grown: dict[str, NDArray[np.generic]] = {}
    for f in fields(Start):
        if f.name in ("lit", "target"):
            grown[f.name] = np.pad(getattr(start, f.name), pads)
        elif f.name != "margin_px":
            grown[f.name] = np.pad(getattr(start, f.name), pads, mode="edge")
    return Start(**grown, margin_px=start.margin_px)  # type: ignore[arg-type]


def _placed(values: Tensor, target: Bools) -> Floats:
    """Values (n,) of the target's pixels as an image, NaN beside it; padding has no target."""
    image = np.full(target.shape, np.nan, dtype=np.float32)
    image[target] = values.numpy()
    return image
