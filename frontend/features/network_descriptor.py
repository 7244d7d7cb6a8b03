"""Patches to descriptors, with the weights of ``polhode train configs/train/features.yaml``."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from polhode.frontend.features.patches import Patches
from polhode.frontend.networks.descriptor import DIMENSIONS, DescriptorNet
from polhode.frontend.networks.weights import load_weights, shipped_path
from polhode.lie import Array

NAME = "descriptor"
AT_ONCE = 128
"""Patches that go through the network at once: their features stay in the processor's cache."""


@dataclass(frozen=True)
class PatchDescriptions:
    """What the network tells of n patches."""

    descriptors: NDArray[np.float32]
    """(n, 128) unit length"""
    reliability: Array
    """(n,) probability, between 0 and 1, that the descriptor finds its partner"""
    angle_rad: Array
    """(n,) direction in the patch, from x (right) to y (down), that turns with the surface"""


@cache
def descriptor_network(path: Path | None = None) -> DescriptorNet:
    """The network with the weights of a file, else those shipped. Raises InputError as ``load_weights``."""
    network = DescriptorNet()
    load_weights(network, path or shipped_path(NAME))
    return network


def describe(network: DescriptorNet, patches: Patches) -> PatchDescriptions:
    """Describe patches (n, 1, 32, 32) of grey values 0..255."""
    if len(patches) == 0:
        return PatchDescriptions(np.zeros((0, DIMENSIONS), dtype=np.float32), np.zeros(0), np.zeros(0))
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=_multiplies_in_bfloat16()):
        parts = [network(some) for some in torch.from_numpy(patches).split(AT_ONCE)]
    descriptor, reliability, direction = (torch.cat(each).float() for each in zip(*parts, strict=True))
    return PatchDescriptions(
        descriptor.numpy(),
        torch.sigmoid(reliability).numpy().astype(np.float64),
        torch.atan2(direction[:, 1], direction[:, 0]).numpy().astype(np.float64),
    )


@cache
def _multiplies_in_bfloat16() -> bool:
    """Whether the processor has matrix instructions for it: then it takes half the time."""
    return bool(torch.backends.mkldnn.is_available() and torch.cpu._is_amx_tile_supported())
