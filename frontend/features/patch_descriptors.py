"""Descriptors of surface patches, and their orientation: by the network trained here, or by RootSIFT.

Both describe upright patches of the tangent plane. RootSIFT needs no weights: on patches whose scale and
inclination are known it gives two to ten times the matches of RootSIFT in the image. The weights of the
network come from ``polhode train configs/train/features.yaml``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import kornia.feature
import numpy as np
import torch

from polhode.config.frontend_settings import Frontend
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patches import (
    Patches,
    cut_patches,
    dominant_angles,
    root_image,
    rotate_affines,
)
from polhode.frontend.networks.descriptor import DIMENSIONS, DescriptorNet, DescriptorOutput
from polhode.frontend.networks.precision import multiplies_in_bfloat16
from polhode.frontend.networks.weights import load_weights, shipped_path
from polhode.frontend.rectification import Image
from polhode.geometry.lie import Array

NAME = "descriptor"
"""Name of the shipped weights."""
NETWORK_BATCH = 128
"""Patches or points in one pass of a network: their features stay in the processor's cache."""
_SIFT_BATCH = 256


@dataclass(frozen=True)
class PatchDescriptions:
    """Descriptors and orientations of n patches."""

    descriptors: Descriptors
    """(n, 128) unit length"""
    angle_rad: Array
    """(n,) direction in the patch, from x (right) to y (down), that rotates with the surface"""
    reliability: Array
    """(n,) probability that the descriptor is matched correctly; 1 where it is not estimated"""


SurfaceDescriptor = Callable[[Image, Array, Array], PatchDescriptions]
"""Image, points (n, 2), maps (n, 2, 2) of their upright patches -> descriptions of the surface there."""


def make_descriptor(config: Frontend) -> SurfaceDescriptor:
    """The configured descriptor. Raises InputError: its weights are missing."""
    if config.features.surface_descriptor == "rootsift":
        return HistogramDescriptor()
    path = config.weights.descriptor
    network = descriptor_network(None if path is None else Path(path))
    return lambda image, uv_px, affine_px: describe(network, cut_patches(image, uv_px, affine_px))


class HistogramDescriptor:
    """RootSIFT of the patch, rotated to its dominant gradient, on square roots of the grey values."""

    def __init__(self) -> None:
        self._sift = kornia.feature.SIFTDescriptor(32, rootsift=True)

    def __call__(self, image: Image, uv_px: Array, affine_px: Array) -> PatchDescriptions:
        """See ``SurfaceDescriptor``."""
        root = root_image(image)
        angle = dominant_angles(cut_patches(root, uv_px, affine_px))
        patches = cut_patches(root, uv_px, rotate_affines(affine_px, angle))
        return PatchDescriptions(self._histograms(patches), angle, np.ones(len(uv_px)))

    def _histograms(self, patches: Patches) -> Descriptors:
        parts = [np.zeros((0, 128), np.float32)]
        with torch.inference_mode():
            for first in range(0, len(patches), _SIFT_BATCH):
                some = torch.from_numpy(patches[first : first + _SIFT_BATCH] / np.float32(255.0))
                parts.append(self._sift(some).numpy().astype(np.float32))
        return np.concatenate(parts)


@cache
def descriptor_network(path: Path | None = None) -> DescriptorNet:
    """The network with the weights of a file, or the shipped ones. Raises InputError as ``load_weights``."""
    network = DescriptorNet()
    load_weights(network, path or shipped_path(NAME))
    return network


def describe(network: DescriptorNet, patches: Patches) -> PatchDescriptions:
    """Describe patches (n, 1, 32, 32) of grey values 0..255."""
    return described(network, patches)


def described(network: Callable[[torch.Tensor], DescriptorOutput], given: Patches) -> PatchDescriptions:
    """Descriptions by a network of n patches, or whatever it takes of each."""
    if len(given) == 0:
        return PatchDescriptions(np.zeros((0, DIMENSIONS), dtype=np.float32), np.zeros(0), np.zeros(0))
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=multiplies_in_bfloat16()):
        parts = [network(some) for some in torch.from_numpy(given).split(NETWORK_BATCH)]
    descriptor, reliability, direction = (torch.cat(each).float() for each in zip(*parts, strict=True))
    return PatchDescriptions(
        descriptor.numpy(),
        torch.atan2(direction[:, 1], direction[:, 0]).numpy().astype(np.float64),
        torch.sigmoid(reliability).numpy().astype(np.float64),
    )
