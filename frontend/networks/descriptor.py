"""Descriptor of surface patches: 128 numbers, whatever way the patch is turned, and how far to trust them.

The patch is sampled on rings around its middle, where a turn is a shift along the rings (as in Ebel et al.,
"Beyond Cartesian representations for local descriptors", 2019). Convolutions that close around the rings keep
it one. It sees the grey values and their logarithm: what the Sun burns out and what lies in the dark.
What the convolutions give is expanded in harmonics of the angle, and one learned direction, which turns with
the patch, takes the turn out of them: the network finds the orientation, where others decide by a histogram
of gradients (Lowe 2004 keeps one or two peaks).
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
"""Radii of the rings, over half a side; evenly spaced, since places are known to a pixel and no better."""
HARMONICS = 6
"""Harmonics 0 to 5 of the angle are kept."""


class Described(NamedTuple):
    """What the network tells of n patches."""

    descriptor: Tensor
    """(n, 128) unit length"""
    reliability: Tensor
    """(n,) logit of the probability that the descriptor finds its partner"""
    direction: Tensor
    """(n, 2) cosine and sine of an angle in the patch, from x (right) to y (down), which turns with it"""


class DescriptorNet(nn.Module):
    """Patches (n, 1, 32, 32) of grey values 0..255 -> ``Described``."""

    sampler: Tensor
    cosines: Tensor
    sines: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("sampler", _sampler(), persistent=False)
        cosines, sines = _harmonics(ANGLES // 2)
        self.register_buffer("cosines", cosines, persistent=False)
        self.register_buffer("sines", sines, persistent=False)
        self.layers = nn.Sequential(
            Around(2, 24, (2, 2), reach=2),
            Around(24, 32),
            Around(32, 64, (2, 1)),
            Around(64, 64),
            Around(64, 64, (2, 1)),
        )
        self.whole = nn.Sequential(nn.Conv2d(64, 96, (2, 1), bias=False), nn.BatchNorm2d(96), nn.ReLU())
        self.direction = nn.Conv1d(96, 1, 1)
        self.project = nn.Linear(96 * (2 * HARMONICS - 1), DIMENSIONS)
        self.reliability = nn.Sequential(nn.Linear(2 * 96 + 1, 48), nn.ReLU(), nn.Linear(48, 1))

        for weight in self.parameters():
            if weight.ndim == 4:
                # A fifth faster on a CPU.
                weight.data = weight.data.contiguous(memory_format=torch.channels_last)

    def forward(self, patches: Tensor) -> Described:
        """Patches (n, 1, 32, 32), grey values 0..255."""
        logarithm = 32.0 * torch.log1p(patches.clamp(min=0.0) / 4.0)
        seen = torch.cat([normalised(patches), normalised(logarithm)], dim=1)
        around = self.whole(self.layers(on_rings(seen, self.sampler)))[:, :, 0]
        with torch.autocast(patches.device.type, enabled=False):
            # Angles need all their digits.
            turned, direction, strength = self._turned_back(around.float())
        descriptor = functional.normalize(self.project(turned.flatten(1)).float(), dim=1)
        clues = torch.cat([around.mean(dim=2), around.amax(dim=2), strength[:, None]], dim=1)
        return Described(descriptor, self.reliability(clues)[:, 0], direction)

    def _turned_back(self, around: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Harmonics (n, c, 2 h - 1) of features around the rings (n, c, a), the patch's turn taken out.

        Beside it the direction (n, 2) that tells the turn, and how clear it is (n,).
        """
        even, odd = around @ self.cosines, around @ self.sines
        pull = self.direction(around)
        x, y = (pull @ self.cosines[:, 1:2])[:, 0, 0], (pull @ self.sines[:, 1:2])[:, 0, 0]
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


class Around(nn.Module):
    """Convolution over rings and angles, which closes around the rings; normalised, rectified."""

    def __init__(self, before: int, after: int, stride: tuple[int, int] = (1, 1), reach: int = 1) -> None:
        super().__init__()
        self.reach = reach
        self.convolve = nn.Conv2d(before, after, 2 * reach + 1, stride, bias=False)
        self.scale = nn.BatchNorm2d(after)

    def forward(self, x: Tensor) -> Tensor:
        """(n, c, rings, angles)"""
        reach = self.reach
        closed = torch.cat([x[..., -reach:], x, x[..., :reach]], dim=3)
        convolved = self.convolve(functional.pad(closed, (0, 0, reach, reach)))
        return functional.relu(self.scale(convolved))


def normalised(patches: Tensor) -> Tensor:
    """Patches (n, 1, s, s) of mean zero and contrast one; the middle counts more."""
    weight = _window(patches.shape[-1]).to(patches)
    mean = (patches * weight).sum(dim=(2, 3), keepdim=True)
    away = patches - mean
    contrast = torch.sqrt((away * away * weight).sum(dim=(2, 3), keepdim=True) + 1.0)
    return torch.clamp(away / contrast, -4.0, 4.0)


def on_rings(patches: Tensor, sampler: Tensor) -> Tensor:
    """Patches (n, c, s, s) on rings (n, c, rings, angles); sampler (s * s, rings * angles)."""
    around: Tensor = patches.flatten(2) @ sampler
    return around.reshape(*around.shape[:2], RINGS, ANGLES)


def _sampler() -> Tensor:
    """Bilinear interpolation at the rings' places as a matrix (s * s, rings * angles): it is faster."""
    single = torch.eye(PATCH_PX * PATCH_PX).reshape(-1, 1, PATCH_PX, PATCH_PX)
    places = _ring_places().expand(len(single), -1, -1, -1)
    # Angles are two pixels apart on the outer rings: what lies between them is averaged.
    framed = functional.pad(single, (1, 1, 1, 1), "replicate")
    wide = functional.avg_pool2d(functional.avg_pool2d(framed, 2, 1), 2, 1)
    inner, outer = places.split(RINGS // 2, dim=1)
    parts = [
        functional.grid_sample(seen, where, mode="bilinear", padding_mode="border", align_corners=False)
        for seen, where in ((single, inner), (wide, outer))
    ]
    return torch.cat(parts, dim=2).flatten(1)


@cache
def _window(side: int) -> Tensor:
    place = (2.0 * torch.arange(side) + 1.0) / side - 1.0
    window = torch.exp(-(place[:, None] ** 2 + place[None, :] ** 2) / (2.0 * 0.5**2))
    return window / window.sum()


def _ring_places() -> Tensor:
    """(rings, angles, 2)"""
    radius = INNERMOST + (OUTERMOST - INNERMOST) * torch.arange(RINGS) / (RINGS - 1.0)
    angle = torch.arange(ANGLES) * (2.0 * math.pi / ANGLES)
    return radius[:, None, None] * torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)


def _harmonics(angles: int) -> tuple[Tensor, Tensor]:
    """Cosines and sines (angles, harmonics), over the number of angles."""
    angle = torch.arange(angles) * (2.0 * math.pi / angles)
    phase = angle[:, None] * torch.arange(HARMONICS)
    return torch.cos(phase) / angles, torch.sin(phase) / angles
