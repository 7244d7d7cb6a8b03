"""What a surface patch looks like, and which way it is turned: by the network trained here, or by RootSIFT.

Both see upright patches of the tangent plane. RootSIFT on them needs no weights: with the patch's size and
lean known it finds two to ten times the matches of RootSIFT in the image.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import kornia.feature
import numpy as np
import torch

from polhode.config.frontend import Frontend
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.network_descriptor import describe, descriptor_network
from polhode.frontend.features.patches import Patches, cut_patches, dominant_angles, turned
from polhode.frontend.rectification.target import Image
from polhode.lie import Array

_AT_ONCE = 256
"""Patches that a network sees at once: their activations stay in the cache."""


@dataclass(frozen=True)
class Description:
    """What is told of n upright patches."""

    descriptors: Descriptors
    """(n, 128) unit length"""
    angle_rad: Array
    """(n,) direction in the patch that turns with the surface"""
    reliability: Array
    """(n,) probability that the descriptor finds its partner; 1 where nothing is known of it"""


class SurfaceDescriptor(Protocol):
    """Describes places of an image."""

    def __call__(self, image: Image, uv_px: Array, affine_px: Array) -> Description:
        """Places (n, 2) with the maps (n, 2, 2) of their upright patches."""
        ...


def make_descriptor(config: Frontend) -> SurfaceDescriptor:
    """The descriptor that the configuration names. Raises InputError: its weights are missing."""
    if config.features.surface_descriptor == "rootsift":
        return HistogramDescriptor()
    path = config.weights.descriptor
    return NetworkDescriptor(None if path is None else Path(path))


class NetworkDescriptor:
    """``DescriptorNet``, which needs no turned patches: it finds the direction itself."""

    def __init__(self, path: Path | None) -> None:
        self._network = descriptor_network(path)

    def __call__(self, image: Image, uv_px: Array, affine_px: Array) -> Description:
        """See ``SurfaceDescriptor``."""
        found = describe(self._network, cut_patches(image, uv_px, affine_px))
        return Description(found.descriptors, found.angle_rad, found.reliability)


class HistogramDescriptor:
    """RootSIFT of the patch turned to its strongest gradients, on roots of the grey values."""

    def __init__(self) -> None:
        self._sift = kornia.feature.SIFTDescriptor(32, rootsift=True)

    def __call__(self, image: Image, uv_px: Array, affine_px: Array) -> Description:
        """See ``SurfaceDescriptor``."""
        # Roots: shot noise is even then, and what lies in the dark is not drowned by what the Sun lights.
        root = np.round(16.0 * np.sqrt(image.astype(np.float32))).astype(np.uint8)
        angle = dominant_angles(cut_patches(root, uv_px, affine_px))
        patches = cut_patches(root, uv_px, turned(affine_px, angle))
        return Description(self._histograms(patches), angle, np.ones(len(uv_px)))

    def _histograms(self, patches: Patches) -> Descriptors:
        found = [np.zeros((0, 128), np.float32)]
        with torch.inference_mode():
            for first in range(0, len(patches), _AT_ONCE):
                some = torch.from_numpy(patches[first : first + _AT_ONCE] / np.float32(255.0))
                found.append(self._sift(some).numpy().astype(np.float32))
        return np.concatenate(found)
