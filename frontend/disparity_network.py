"""Disparity, uncertainty and visibility by the trained network, from a classical start."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from frontend.disparity_evidence import evidence, hypotheses
from frontend.disparity_start import Start
from frontend.networks.disparity import STRIDE, DisparityNet, read_mixture

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Refined:
    """What the network says of every pixel (h, w), also where the start knew nothing."""

    disparity: Floats
    """[px]"""
    sigma: Floats
    """[px] half the width of the interval that holds the true disparity with a probability of 68 %"""
    visible: Floats
    """probability that both cameras see the surface"""


def refine(network: DisparityNet, start: Start) -> Refined:
    """One pass over the crop."""
    h, w = start.filled.shape
    grown = padded(start, ((-h) % STRIDE, (-w) % STRIDE))
    with torch.no_grad():
        channels = evidence(grown).contiguous(memory_format=torch.channels_last)
        mixture = read_mixture(network(channels), hypotheses(grown)[None])
        disparity = mixture.mode()
        sigma = mixture.sigma(disparity)
        visible = torch.sigmoid(mixture.visible)
    return Refined(*(_cut(tensor, h, w) for tensor in (disparity, sigma, visible)))


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


def _cut(tensor: Tensor, h: int, w: int) -> Floats:
    return np.asarray(tensor[0, :h, :w].numpy(), dtype=np.float32)
