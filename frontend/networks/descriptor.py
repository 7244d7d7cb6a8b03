"""The descriptor network: a surface patch to 128 numbers that do not depend on its in-plane rotation.

The patch is sampled on rings around its centre, where a rotation is a shift along the rings (as in Ebel et
al., "Beyond Cartesian representations for local descriptors", 2019). Circular convolutions along the rings
preserve the shift. The inputs are the grey values and their logarithm, for sunlit and for dark regions. The
features are expanded in harmonics of the angle, and a learned direction that rotates with the patch removes
the rotation from them: the network estimates the orientation, where others take the peaks of a histogram of
gradients (Lowe 2004). A second output is the reliability of the descriptor.
"""

import math
from functools import cache
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

PATCH_PX = 32
"""Side of the patches [px]."""
DIMENSIONS = 128
RINGS, ANGLES = 16, 48
INNERMOST, OUTERMOST = 0.07, 0.97
"""Radii of the rings, over half a side; evenly spaced, since positions are known to a pixel and no better."""
HARMONICS = 6
"""Number of harmonics of the angle: 0 to 5."""


class DescriptorOutput(NamedTuple):
    """Output of the network for n patches."""

    descriptor: Tensor
    """(n, 128) unit length"""
    reliability: Tensor
    """(n,) logit of the probability that the descriptor is matched correctly"""
    direction: Tensor
    """(n, 2) cosine and sine of an angle in the patch, from x (right) to y (down), which rotates with it"""


class RotationFree(nn.Module):
    """The end of a network that describes what is around a point."""

    cosines: Tensor
    sines: Tensor
    direction: nn.Module
    project: nn.Module
    reliability: nn.Module

    def described(self, around: Tensor) -> DescriptorOutput:
        """Outputs by the features (n, c, angles) around n points."""
        with torch.autocast(around.device.type, enabled=False):
            # Angles need full precision.
            features = around.float()
            invariant, direction, strength = rotation_removed(
                features, self.direction(features), self.cosines, self.sines
            )
        descriptor = functional.normalize(self.project(invariant.flatten(1)).float(), dim=1)
        summary = torch.cat([around.mean(dim=2), around.amax(dim=2), strength[:, None]], dim=1)
        return DescriptorOutput(descriptor, self.reliability(summary)[:, 0], direction)


class DescriptorNet(RotationFree):
    """Descriptor, reliability and direction of patches (n, 1, 32, 32) of grey values 0..255."""

    sampler: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("sampler", _sampler(), persistent=False)
        cosines, sines = harmonics(ANGLES // 2)
        self.register_buffer("cosines", cosines, persistent=False)
        self.register_buffer("sines", sines, persistent=False)
        self.layers = nn.Sequential(
            RingConvolution(2, 24, (2, 2), reach=2),
            RingConvolution(24, 32),
            RingConvolution(32, 64, (2, 1)),
            RingConvolution(64, 64),
            RingConvolution(64, 64, (2, 1)),
        )
        self.whole = nn.Sequential(nn.Conv2d(64, 96, (2, 1), bias=False), nn.BatchNorm2d(96), nn.ReLU())
        self.direction = nn.Conv1d(96, 1, 1)
        self.project = nn.Linear(96 * (2 * HARMONICS - 1), DIMENSIONS)
        self.reliability = nn.Sequential(nn.Linear(2 * 96 + 1, 48), nn.ReLU(), nn.Linear(48, 1))

        for weight in self.parameters():
            if weight.ndim == 4:
                # With channels last, a CPU takes a fifth less time.
                weight.data = weight.data.contiguous(memory_format=torch.channels_last)

    def forward(self, patches: Tensor) -> DescriptorOutput:
        """Describe patches (n, 1, 32, 32) of grey values 0..255."""
        logarithm = 32.0 * torch.log1p(patches.clamp(min=0.0) / 4.0)
        seen = torch.cat([normalise_patches(patches), normalise_patches(logarithm)], dim=1)
        return self.described(self.whole(self.layers(sample_rings(seen, self.sampler)))[:, :, 0])


def rotation_removed(
    around: Tensor, pull: Tensor, cosines: Tensor, sines: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Rotation-invariant harmonics (n, c, 2 h - 1) of features around the rings (n, c, a).

    pull (n, 1, a): how much each angle draws the direction of the patch towards it; cosines, sines (a, h): of
    ``harmonics``. Also returns the direction (n, 2) and the logarithm of its strength (n,).
    """
    even, odd = around @ cosines, around @ sines
    x, y = (pull @ cosines[:, 1:2])[:, 0, 0], (pull @ sines[:, 1:2])[:, 0, 0]
    strength = torch.sqrt(x * x + y * y + 1e-6)
    c, s = x / strength, y / strength
    angle_c, angle_s = [torch.ones_like(c)], [torch.zeros_like(s)]
    for _ in range(HARMONICS - 1):
        last_c, last_s = angle_c[-1], angle_s[-1]
        angle_c.append(last_c * c - last_s * s)
        angle_s.append(last_s * c + last_c * s)
    cos_k, sin_k = torch.stack(angle_c, dim=1)[:, None], torch.stack(angle_s, dim=1)[:, None]
    real = even * cos_k + odd * sin_k
    imaginary = odd * cos_k - even * sin_k
    direction = torch.stack([c, s], dim=1)
    return torch.cat([real, imaginary[:, :, 1:]], dim=2), direction, torch.log(strength)


class RingConvolution(nn.Module):
    """Convolution over rings and angles, circular along the rings; batch normalisation, ReLU."""

    def __init__(self, before: int, after: int, stride: tuple[int, int] = (1, 1), reach: int = 1) -> None:
        super().__init__()
        self.reach = reach
        self.convolve = nn.Conv2d(before, after, 2 * reach + 1, stride, bias=False)
        self.scale = nn.BatchNorm2d(after)

    def forward(self, x: Tensor) -> Tensor:
        """Features (n, c, rings, angles) to features of the next layer."""
        reach = self.reach
        closed = torch.cat([x[..., -reach:], x, x[..., :reach]], dim=3)
        convolved = self.convolve(functional.pad(closed, (0, 0, reach, reach)))
        return functional.relu(self.scale(convolved))


def normalise_patches(patches: Tensor) -> Tensor:
    """Patches (n, 1, s, s) with mean zero and contrast one, weighted by a Gaussian around the centre."""
    weight = _window(patches.shape[-1]).to(patches)
    mean = (patches * weight).sum(dim=(2, 3), keepdim=True)
    away = patches - mean
    contrast = torch.sqrt((away * away * weight).sum(dim=(2, 3), keepdim=True) + 1.0)
    return torch.clamp(away / contrast, -4.0, 4.0)


def sample_rings(patches: Tensor, sampler: Tensor) -> Tensor:
    """Patches (n, c, s, s) sampled on rings (n, c, rings, angles); sampler (s * s, rings * angles)."""
    around: Tensor = patches.flatten(2) @ sampler
    return around.reshape(*around.shape[:2], RINGS, ANGLES)


def _sampler() -> Tensor:
    """Bilinear interpolation on the rings as a matrix (s * s, rings * angles), which is faster."""
    single = torch.eye(PATCH_PX * PATCH_PX).reshape(-1, 1, PATCH_PX, PATCH_PX)
    positions = _ring_positions().expand(len(single), -1, -1, -1)
    # Samples are two pixels apart on the outer rings: pixels between them are averaged.
    framed = functional.pad(single, (1, 1, 1, 1), "replicate")
    wide = functional.avg_pool2d(functional.avg_pool2d(framed, 2, 1), 2, 1)
    inner, outer = positions.split(RINGS // 2, dim=1)
    parts = [
        functional.grid_sample(image, points, mode="bilinear", padding_mode="border", align_corners=False)
        for image, points in ((single, inner), (wide, outer))
    ]
    return torch.cat(parts, dim=2).flatten(1)


@cache
def _window(side: int) -> Tensor:
    """Gaussian weights (side, side) of sum one; standard deviation a quarter of the side."""
    x = (2.0 * torch.arange(side) + 1.0) / side - 1.0
    window = torch.exp(-(x[:, None] ** 2 + x[None, :] ** 2) / (2.0 * 0.5**2))
    return window / window.sum()


def _ring_positions() -> Tensor:
    """Positions (rings, angles, 2) in the patch, from -1 to 1."""
    radius = INNERMOST + (OUTERMOST - INNERMOST) * torch.arange(RINGS) / (RINGS - 1.0)
    angle = torch.arange(ANGLES) * (2.0 * math.pi / ANGLES)
    return radius[:, None, None] * torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)


def harmonics(angles: int) -> tuple[Tensor, Tensor]:
    """Cosines and sines (angles, harmonics), divided by the number of angles."""
    angle = torch.arange(angles) * (2.0 * math.pi / angles)
    phase = angle[:, None] * torch.arange(HARMONICS)
    return torch.cos(phase) / angles, torch.sin(phase) / angles
