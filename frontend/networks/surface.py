"""The surface network: one pyramid of convolutions finds points of the surface, judges and describes them.

From the image of the target, the *pyramid* (levels added on the way back to full resolution: Lin et al.,
"Feature pyramid networks for object detection", 2017) gives for each pixel

- the score of a landmark there, its place within the pixel (Zhou et al., "Objects as points", 2019), and the
  standard deviation of that place between images, to which moving light contributes most;
- the kind of light that falls on it;
- a few channels that depend on the surface more than on its light.

The *descriptor* samples the image and these channels on rings around a point, in the tangent plane of the
surface, where a rotation in the plane is a shift along the rings (as in Ebel et al., "Beyond Cartesian
representations for local descriptors", 2019). The features are expanded in harmonics of the angle, and a
learned direction that rotates with the surface removes the rotation from them.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.frontend.networks.descriptor import (
    DIMENSIONS,
    HARMONICS,
    DescriptorOutput,
    RingConvolution,
    RotationFree,
    harmonics,
)
from polhode.frontend.networks.grouping import Grouping

WIDTHS = (16, 32, 48, 64)
"""Channels of the levels; each has half the resolution of the one before."""
JUDGED = 24
"""Channels from which all that is known of a pixel is read."""
STRIDE_PX = 8
"""Sides of the images are multiples of this [px]."""
KINDS_OF_LIGHT = 4
"""Sunlit, in a shadow of another part, turned from the Sun, more mirrored than scattered sunlight."""
LEARNED_CHANNELS = 6
CHANNELS = 2 + LEARNED_CHANNELS
"""Of the rings: two of the image, and the learned ones."""
RINGS, ANGLES = 12, 32
INNERMOST, OUTERMOST = 0.07, 0.97
"""Radii of the rings, over half a side of the patch; evenly spaced."""
SMOOTH_FROM = 6
"""First ring that is sampled from the smoothed channels, since its samples are two pixels apart."""
LOG_SIGMA_RANGE = (-2.5, 2.0)
"""Of the places' standard deviations [log px]."""


class DenseOutput(NamedTuple):
    """Output of the pyramid for images (b, 1, H, W)."""

    score: Tensor
    """(b, H, W) logit of a landmark in the pixel"""
    offset_px: Tensor
    """(b, 2, H, W) its place (u, v) less the pixel's centre [px]"""
    log_sigma: Tensor
    """(b, H, W) of the place between images, each axis [log px]"""
    light: Tensor
    """(b, kinds, H, W) logits"""
    channels: Tensor
    """(b, c, H, W) for the rings"""


class SurfaceNet(RotationFree):
    """``dense`` on images, then ``describe`` on the rings around points."""

    def __init__(self) -> None:
        super().__init__()
        first, second, third, fourth = WIDTHS
        self.first = nn.Sequential(_convolution(4, first), _convolution(first, first))
        self.second = nn.Sequential(_convolution(first, second, 2), _convolution(second, second))
        self.third = nn.Sequential(_convolution(second, third, 2), _convolution(third, third))
        self.fourth = nn.Sequential(
            _convolution(third, fourth, 2), _convolution(fourth, fourth), _convolution(fourth, fourth, 1, 2)
        )
        self.lateral = nn.ModuleList(
            nn.Conv2d(before, after, 1)
            for before, after in ((fourth, third), (third, second), (second, first))
        )
        self.back = nn.ModuleList(_convolution(width, width) for width in (third, second, first))
        self.judge = _convolution(first, JUDGED)
        self.heads = nn.Conv2d(JUDGED, 4 + KINDS_OF_LIGHT + LEARNED_CHANNELS, 1)
        self.rings = nn.Sequential(
            RingConvolution(CHANNELS, 32, (2, 1)), RingConvolution(32, 48, (2, 2)), RingConvolution(48, 64)
        )
        self.whole = nn.Sequential(
            nn.Conv2d(64, 96, (RINGS // 4, 1), bias=False), nn.BatchNorm2d(96), nn.ReLU()
        )
        self.direction = nn.Conv1d(96, 1, 1)
        self.project = nn.Linear(96 * (2 * HARMONICS - 1), DIMENSIONS)
        self.reliability = nn.Sequential(nn.Linear(2 * 96 + 1, 48), nn.ReLU(), nn.Linear(48, 1))
        cosines, sines = harmonics(ANGLES // 2)
        self.register_buffer("cosines", cosines, persistent=False)
        self.register_buffer("sines", sines, persistent=False)
        # few pixels have a landmark; places scatter by half a pixel
        begin = torch.zeros(4 + KINDS_OF_LIGHT + LEARNED_CHANNELS)
        begin[0], begin[3] = -3.0, -0.7
        self.heads.bias = nn.Parameter(begin)
        for weight in self.parameters():
            if weight.ndim == 4:
                # With channels last, a CPU takes a fifth less time.
                weight.data = weight.data.contiguous(memory_format=torch.channels_last)

    def dense(self, images: Tensor) -> DenseOutput:
        """Images (b, 1, H, W) of grey values 0..255, zero off the target."""
        seen = image_channels(images)
        framed = torch.cat([seen, local_contrast(seen)], dim=1).contiguous(memory_format=torch.channels_last)
        levels = [self.first(framed)]
        for down in (self.second, self.third, self.fourth):
            levels.append(down(levels[-1]))
        total = levels.pop()
        for lateral, back in zip(self.lateral, self.back, strict=True):
            total = functional.interpolate(
                lateral(total), scale_factor=2.0, mode="bilinear", align_corners=False
            )
            total = back(total + levels.pop())
        out = self.heads(self.judge(total)).float()
        place, light, learned = out.split([4, KINDS_OF_LIGHT, LEARNED_CHANNELS], dim=1)
        return DenseOutput(
            place[:, 0],
            place[:, 1:3],
            place[:, 3].clamp(*LOG_SIGMA_RANGE),
            light,
            torch.cat([seen.float(), torch.tanh(learned)], dim=1),
        )

    def describe(self, rings: Tensor) -> DescriptorOutput:
        """Describe points by their rings (n, c, rings, angles)."""
        return self.described(self.whole(self.rings(normalise_rings(rings)))[:, :, 0])


def image_channels(images: Tensor) -> Tensor:
    """Square roots relative to the brightest, where noise is uniform, and logarithms, for what is dark:
    (b, 2, H, W)."""
    root = torch.sqrt(images.clamp(min=0.0))
    brightest = root.amax(dim=(2, 3), keepdim=True).clamp(min=4.0)
    return torch.cat(
        [2.0 * root / brightest - 1.0, 0.4 * torch.log1p(images.clamp(min=0.0) / 4.0) - 0.8], dim=1
    )


def local_contrast(channels: Tensor) -> Tensor:
    """Channels (b, c, H, W) less their means around each pixel, over their standard deviations there.

    Marks of a few grey levels count as much as strong ones.
    """
    away = channels - _mean_around(channels)
    # A grey level is 0.01 to 0.1 of these units.
    return torch.clamp(away / torch.sqrt(_mean_around(away * away) + 0.01**2), -3.0, 3.0)


def _mean_around(channels: Tensor) -> Tensor:
    """Means over the nine by nine pixels around each, of the image alone."""
    columns = functional.avg_pool2d(channels, (9, 1), 1, (4, 0), count_include_pad=False)
    return functional.avg_pool2d(columns, (1, 9), 1, (0, 4), count_include_pad=False)


@dataclass(frozen=True)
class Places:
    """n landmarks of one image, the highest score first."""

    uv_px: Tensor
    """(n, 2)"""
    log_sigma: Tensor
    """(n,) of the place, each axis [log px]"""
    score: Tensor
    """(n,) logit"""


def find_places(dense: DenseOutput, image: int, mask: Tensor, count: int, min_score: float = -2.2) -> Places:
    """The ``count`` landmarks with the highest score on the mask (H, W) of an image of the batch.

    min_score: smallest logit of a landmark, by default of a probability of a tenth.
    """
    score = dense.score[image]
    # the highest score within a pixel along both axes
    highest = functional.max_pool2d(score[None, None], 3, 1, 1)[0, 0]
    row, column = torch.nonzero((score >= highest) & mask & (score > min_score), as_tuple=True)
    value = score[row, column]
    order = value.argsort(descending=True, stable=True)[:count]
    row, column = row[order], column[order]
    offset = dense.offset_px[image, :, row, column].T
    uv = torch.stack([column, row], dim=1) + offset.clamp(-1.5, 1.5)
    return Places(uv, dense.log_sigma[image, row, column], value[order])


def smoothed_channels(channels: Tensor) -> Tensor:
    """Channels (b, c, H, W), each pixel the binomial mean of three by three."""
    framed = functional.pad(channels, (1, 1, 1, 1), "replicate")
    return functional.avg_pool2d(functional.avg_pool2d(framed, 2, 1), 2, 1)


def sample_rings(channels: Tensor, owner: Tensor, uv_px: Tensor, affine_px: Tensor) -> Tensor:
    """Rings (n, c, rings, angles) around uv_px (n, 2) of the images ``owner`` (n,), by maps (n, 2, 2) of the
    patches.

    channels (b, c, H, W); beyond the border its values are repeated.
    """
    height, width = channels.shape[2:]
    at = uv_px[:, None, None] + torch.einsum("nij,raj->nrai", affine_px, ring_positions().to(affine_px))
    images = Grouping.of(owner, len(channels))
    grid = images.spread((2.0 * at + 1.0) / at.new_tensor([width, height]) - 1.0)
    inner, outer = grid.split([SMOOTH_FROM, RINGS - SMOOTH_FROM], dim=2)
    rings = [_sampled(channels, inner), _sampled(smoothed_channels(channels), outer)]
    return torch.cat([images.gather(each) for each in rings], dim=2)


def _sampled(channels: Tensor, grid: Tensor) -> Tensor:
    """Samples (b, n, c, rings, angles) of channels (b, c, H, W) at grid (b, n, rings, angles, 2)."""
    b, n, rings, angles, _ = grid.shape
    flat = functional.grid_sample(
        channels, grid.reshape(b, n * rings, angles, 2), "bilinear", "border", align_corners=False
    )
    return flat.reshape(b, -1, n, rings, angles).transpose(1, 2)


def normalise_rings(rings: Tensor) -> Tensor:
    """Rings (n, c, rings, angles); the channels of the image with mean zero and contrast one.

    Weights are the areas of the rings under a Gaussian around the centre.
    """
    radius = torch.linspace(INNERMOST, OUTERMOST, RINGS, device=rings.device)
    weight = radius * torch.exp(-(radius**2) / (2.0 * 0.5**2))
    weight = (weight / (weight.sum() * ANGLES))[:, None]
    image, learned = rings.split([2, rings.shape[1] - 2], dim=1)
    mean = (image * weight).sum(dim=(2, 3), keepdim=True)
    away = image - mean
    # A grey level is 0.01 to 0.1 of these units.
    contrast = torch.sqrt((away * away * weight).sum(dim=(2, 3), keepdim=True) + 0.02**2)
    return torch.cat([torch.clamp(away / contrast, -4.0, 4.0), 2.0 * learned], dim=1)


def ring_positions() -> Tensor:
    """Positions (rings, angles, 2) in the patch, from -1 to 1."""
    radius = torch.linspace(INNERMOST, OUTERMOST, RINGS)
    angle = torch.arange(ANGLES) * (2.0 * math.pi / ANGLES)
    return radius[:, None, None] * torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)


def _convolution(before: int, after: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, dilation, dilation, bias=False), nn.BatchNorm2d(after), nn.ReLU()
    )
