"""The network that judges places of an image: is a point there found again, and how far does its place
scatter?

A detector finds marks of the surface, but also edges of shadows, highlights, and outlines, whose places move
with the light and the view. Which of them it is cannot be seen in a small patch; here the image around is
looked at, by a pyramid of convolutions whose levels are added on the way back to fine resolution (Lin et al.,
"Feature pyramid networks for object detection", 2017). A point takes the features at its place, and what is
known of it besides: the scale of its mark, the inclination of the surface, the sharpness of the texture.

Trained on the same surfaces under several Suns (``train.surface``): the probability that the most similar
descriptor of another image is the right one, and the variance of the place of those that are. The kind of
light on every pixel, a by-product, helps the features.
"""

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

WIDTHS = (12, 24, 48, 64, 96)
"""Channels of the levels; each has half the resolution of the one before."""
FEATURES = 32
"""Channels of the sum of the levels, at half the resolution of the image."""
KINDS_OF_LIGHT = 4
"""Sunlit, in a shadow of another part, turned from the Sun, highlight."""
KNOWN = 3
"""Numbers that are known of a point besides its image."""
STRIDE_PX = 16
"""Sides of the images are multiples of this [px]."""
MIN_SCALE_PX, MIN_SIGMA_LS_PX = 0.1, 1e-3
_LOG_SIGMA_RANGE = (-4.0, 2.0)


class Judgement(NamedTuple):
    """Output of the network for n points."""

    reliability: Tensor
    """(n,) logit of the probability that the most similar descriptor of another image is right"""
    log_sigma: Tensor
    """(n,) of the scatter of the place between images, each axis [px]"""


class SurfaceNet(nn.Module):
    """Images (b, 1, H, W) of grey values 0..255, black off the target, and points in them."""

    def __init__(self) -> None:
        super().__init__()
        self.first = _convolution(2, WIDTHS[0])
        self.down = nn.ModuleList(
            nn.Sequential(_convolution(before, after, 2), _convolution(after, after))
            for before, after in pairwise(WIDTHS)
        )
        self.lateral = nn.ModuleList(nn.Conv2d(width, FEATURES, 1) for width in WIDTHS[1:])
        self.smooth = nn.ModuleList(_convolution(FEATURES, FEATURES) for _ in range(2))
        self.light = nn.Conv2d(FEATURES, KINDS_OF_LIGHT, 1)
        self.point = nn.Sequential(nn.Linear(FEATURES + WIDTHS[0] + KNOWN, 64), nn.ReLU(), nn.Linear(64, 2))

    def forward(
        self, images: Tensor, owner: Tensor, uv_px: Tensor, known: Tensor
    ) -> tuple[Judgement, Tensor]:
        """Judge points at uv_px (n, 2) of the images owner (n,), of which ``known`` (n, 3) is known.

        Also returns logits (b, kinds, H / 2, W / 2) of the kind of light on every second pixel.
        """
        fine, features = self._features(images)
        with torch.autocast(images.device.type, enabled=False):
            fine, features = fine.float(), features.float()
            at = torch.cat([sample(features, owner, uv_px, 2), sample(fine, owner, uv_px, 1), known], dim=1)
            reliability, log_sigma = self.point(at).unbind(dim=1)
            return Judgement(reliability, log_sigma.clamp(*_LOG_SIGMA_RANGE)), self.light(features)

    def _features(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Features at the resolution of the images, and the sum of the levels at half of it."""
        fine = self.first(_channels(images))
        levels, level = [], fine
        for down in self.down:
            level = down(level)
            levels.append(level)
        total = self.lateral[-1](levels[-1])
        for k in range(len(levels) - 2, -1, -1):
            wider = functional.interpolate(total, scale_factor=2, mode="bilinear", align_corners=False)
            total = wider + self.lateral[k](levels[k])
            if k < len(self.smooth):
                total = self.smooth[k](total)
        return fine, total


def known_of_points(scale_px: Tensor, cosine: Tensor, sigma_ls_px: Tensor) -> Tensor:
    """What is known of points (n, 3): logarithms of scale and sharpness, and the inclination of the surface.

    cosine (n,): between normal and ray; sigma_ls_px (n,): as ``features.stereo.texture_sigma``.
    """
    return torch.stack(
        [
            torch.log(scale_px.clamp(min=MIN_SCALE_PX)),
            cosine,
            torch.log(sigma_ls_px.clamp(min=MIN_SIGMA_LS_PX)).clamp(max=1.0) + 2.0,
        ],
        dim=1,
    )


def sample(maps: Tensor, owner: Tensor, uv_px: Tensor, stride: int) -> Tensor:
    """Bilinear samples (n, c) of maps (b, c, h, w) whose pixels are ``stride`` pixels of the image wide.

    uv_px (n, 2): pixel centres are integers; beyond the border its values are repeated.
    """
    height, width = maps.shape[2:]
    at = (uv_px + 0.5) / stride - 0.5
    u, v = at[:, 0].clamp(0.0, width - 1.0), at[:, 1].clamp(0.0, height - 1.0)
    left, top = u.floor().long().clamp(max=max(width - 2, 0)), v.floor().long().clamp(max=max(height - 2, 0))
    right, below = (left + 1).clamp(max=width - 1), (top + 1).clamp(max=height - 1)
    s, t = (u - left)[:, None], (v - top)[:, None]
    last = maps.permute(0, 2, 3, 1)
    upper = (1.0 - s) * last[owner, top, left] + s * last[owner, top, right]
    lower = (1.0 - s) * last[owner, below, left] + s * last[owner, below, right]
    return (1.0 - t) * upper + t * lower


def _channels(images: Tensor) -> Tensor:
    """Square roots relative to the brightest, where noise is uniform, and logarithms, for what is dark."""
    root = torch.sqrt(images.clamp(min=0.0))
    brightest = root.amax(dim=(2, 3), keepdim=True).clamp(min=4.0)
    return torch.cat(
        [2.0 * root / brightest - 1.0, 0.4 * torch.log1p(images.clamp(min=0.0) / 4.0) - 0.8], dim=1
    )


def _convolution(before: int, after: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, padding=1, bias=False), nn.BatchNorm2d(after), nn.ReLU()
    )
