"""Descriptors of upright surface patches, and their orientation, by the network trained here.

The weights come from ``polhode train configs/train/features.yaml``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patches import Patches
from polhode.frontend.networks.descriptor import DIMENSIONS, DescriptorNet, DescriptorOutput
from polhode.frontend.networks.weights import load_weights, multiplies_in_bfloat16, shipped_path
from polhode.geometry.lie import Array

NAME = "descriptor"
"""Name of the shipped weights."""


@dataclass(frozen=True)
class PatchDescriptions:
    """Descriptors and orientations of n patches."""

    descriptors: Descriptors
    """(n, 128) unit length"""
    angle_rad: Array
    """(n,) direction in the patch, from x (right) to y (down), that rotates with the surface"""
    reliability: Array
    """(n,) probability that the descriptor is matched correctly"""


@cache
def descriptor_network(path: Path | None = None) -> DescriptorNet:
    """The network with the weights of a file, or the shipped ones. Raises InputError as ``load_weights``."""
    network = DescriptorNet()
    load_weights(network, path or shipped_path(NAME))
    return network


def describe(network: Callable[[torch.Tensor], DescriptorOutput], given: Patches) -> PatchDescriptions:
    """By a network, of n patches (n, 1, 32, 32) of grey values 0..255, or of what else it takes."""
    if len(given) == 0:
        return PatchDescriptions(np.zeros((0, DIMENSIONS), dtype=np.float32), np.zeros(0), np.zeros(0))
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
        # patches or points in one pass of a network: their features stay in the processor's cache
        parts = [network(some) for some in torch.from_numpy(given).split(128)]
    descriptor, reliability, direction = (torch.cat(each).float() for each in zip(*parts, strict=True))
    return PatchDescriptions(
        descriptor.numpy(),
        torch.atan2(direction[:, 1], direction[:, 0]).numpy().astype(np.float64),
        torch.sigmoid(reliability).numpy().astype(np.float64),
    )
