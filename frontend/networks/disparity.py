"""The network that refines a classical disparity: a U-Net on half-size images, and what its output means.

At each pixel it weighs six hypotheses (``disparity_start``), corrects each, and says how uncertain each is:
a mixture of Laplace distributions. Its mode is the disparity, so that edges stay sharp where a mean would
lie between near and far (Tosi and others, "SMD-Nets", 2021). One more output: whether the right camera sees
the pixel's surface at all. Full size comes back by pixel shuffle (Shi and others, 2016).
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.frontend.disparity.evidence import CHANNELS, HYPOTHESES

WIDTHS = (48, 64, 96, 128)
STRIDE = 16
"""Sides of the input are multiples of this."""
_LEAST_SCALE_PX = 0.02
_MOST_SCALE_PX = 12.0
_LEAST_SIGMA_PX = 0.02
_MOST_SIGMA_PX = 64.0
_ONE_SIGMA = 0.6827
OUTPUTS = 3 * HYPOTHESES + 1


@dataclass(frozen=True)
class Mixture:
    """Distribution of each pixel's disparity (B, k, ...), and the logit of being seen by both (B, ...)."""

    log_weight: Tensor
    mean: Tensor
    """[px]"""
    scale: Tensor
    """[px] of the Laplace distributions"""
    visible: Tensor

    def log_density(self, disparity: Tensor) -> Tensor:
        """Of disparities (B, ...)."""
        distance = (disparity[:, None] - self.mean).abs()
        return torch.logsumexp(self.log_weight - distance / self.scale - torch.log(2 * self.scale), dim=1)

    def mass_within(self, disparity: Tensor, radius: Tensor) -> Tensor:
        """Probability of [disparity - radius, disparity + radius], all (B, ...)."""
        below = disparity[:, None] - radius[:, None] - self.mean
        above = disparity[:, None] + radius[:, None] - self.mean
        share = _cumulative(above / self.scale) - _cumulative(below / self.scale)
        return (self.log_weight.exp() * share).sum(dim=1)

    def mode(self, window_px: float = 0.5) -> Tensor:
        """(B, ...) the component's mean that has most probability around it [px]."""
        radius = torch.full_like(self.visible, window_px)
        mass = torch.stack(
            [self.mass_within(self.mean[:, k], radius) for k in range(self.mean.shape[1])], dim=1
        )
        return self.mean.gather(1, mass.argmax(dim=1, keepdim=True))[:, 0]

    def sigma(self, disparity: Tensor, rounds: int = 6) -> Tensor:
        """Half the width (B, ...) [px] of the interval around ``disparity`` that holds 68 %.

        By bisection of its logarithm, and linear interpolation in the last interval.
        """
        low, high = (torch.full_like(disparity, end).log() for end in (_LEAST_SIGMA_PX, _MOST_SIGMA_PX))
        mass_low, mass_high = torch.zeros_like(disparity), torch.ones_like(disparity)
        for _ in range(rounds):
            middle = 0.5 * (low + high)
            mass = self.mass_within(disparity, middle.exp())
            inside = mass > _ONE_SIGMA
            low, mass_low = torch.where(inside, low, middle), torch.where(inside, mass_low, mass)
            high, mass_high = torch.where(inside, middle, high), torch.where(inside, mass, mass_high)
        share = (_ONE_SIGMA - mass_low) / (mass_high - mass_low).clamp(min=1e-6)
        return (low + share.clamp(0.0, 1.0) * (high - low)).exp()

    def strongest(self, count: int) -> "Mixture":
        """The components of largest weight only, which then make up the whole."""
        log_weight, chosen = self.log_weight.topk(count, dim=1)
        return Mixture(
            functional.log_softmax(log_weight, dim=1),
            self.mean.gather(1, chosen),
            self.scale.gather(1, chosen),
            self.visible,
        )


def _cumulative(x: Tensor) -> Tensor:
    """Of the Laplace distribution of scale 1."""
    return 0.5 + 0.5 * torch.sign(x) * -torch.expm1(-x.abs())


class _Block(nn.Module):
    """Two convolutions beside a straight way."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.second(functional.relu(self.first(functional.relu(x))))
        return out


class DisparityNet(nn.Module):
    """Evidence (B, CHANNELS, h, w) to raw outputs (B, OUTPUTS, h, w); h and w multiples of ``STRIDE``."""

    sigma_scale: Tensor

    def __init__(self, widths: tuple[int, ...] = WIDTHS) -> None:
        super().__init__()
        self.stem = nn.Conv2d(4 * CHANNELS, widths[0], 1)
        self.enter = nn.ModuleList(_Block(w) for w in widths)
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in pairs)
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairs)
        self.leave = nn.ModuleList(_Block(a) for a, _ in pairs)
        self.head = nn.Conv2d(widths[0], 4 * OUTPUTS, 1)
        # Not learned: measured on held-out bodies, so that sigma holds for what comes out in the end.
        self.register_buffer("sigma_scale", torch.ones(()))
        for block in [*self.enter, *self.leave]:
            assert isinstance(block, _Block)
            nn.init.zeros_(block.second.weight)
        nn.init.zeros_(self.head.weight)
        # Channels last: convolutions on a CPU take half the time.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, channels: Tensor) -> Tensor:
        x = self.enter[0](self.stem(functional.pixel_unshuffle(channels, 2)))
        skipped = []
        for down, enter in zip(self.down, list(self.enter)[1:], strict=True):
            skipped.append(x)
            x = enter(down(x))
        for up, leave in zip(reversed(self.up), reversed(self.leave), strict=True):
            # Narrow first: a 1x1 convolution and an enlargement may change places.
            wide = functional.interpolate(up(x), scale_factor=2.0, mode="bilinear", align_corners=False)
            x = leave(wide + skipped.pop())
        out: Tensor = functional.pixel_shuffle(self.head(functional.relu(x)), 2)
        return out


def read_mixture(raw: Tensor, hypotheses: Tensor) -> Mixture:
    """Meaning of raw outputs (B, OUTPUTS, ...) at hypotheses (B, k, ...) [px]."""
    k = HYPOTHESES
    raw = raw.float()
    # At first, with all outputs zero, the filled disparity is believed most.
    preference = torch.zeros_like(raw[:, :k])
    preference[:, 0] = 2.0
    log_weight = functional.log_softmax(raw[:, :k] + preference, dim=1)
    scale = _LEAST_SCALE_PX + functional.softplus(raw[:, 2 * k : 3 * k] - 1.5).clamp(max=_MOST_SCALE_PX)
    return Mixture(log_weight, hypotheses + raw[:, k : 2 * k], scale, raw[:, 3 * k])
