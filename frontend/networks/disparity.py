"""The network that refines a classical disparity: a U-Net at half resolution, and the meaning of its output.

At each pixel it weights, corrects and estimates the uncertainty of six hypotheses of the disparity
(``frontend.disparity.learned``): a mixture of Laplace distributions. Its mode is the disparity, so that
edges stay sharp where a mean would lie between near and far (Tosi et al., "SMD-Nets", 2021). A further output
is whether the right camera sees the pixel's surface. Full resolution is restored by pixel shuffle (Shi et
al., 2016).
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

OFFSETS_PX = (-3.0, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0, 3.0)
"""Disparities of the slice of the cost volume that the network sees, relative to the first hypothesis."""
HYPOTHESES = 6
"""Hypotheses of the disparity at each pixel."""
CHANNELS = len(OFFSETS_PX) + 2 * (HYPOTHESES - 1) + 16
"""Input channels, which ``frontend.disparity.learned`` computes."""
OUTPUTS = 3 * HYPOTHESES + 1
"""Output channels: weight, correction and scale of each hypothesis, and the visibility."""
WIDTHS = (48, 64, 96, 128)
STRIDE = 16
"""Sides of the input are multiples of this."""
_MIN_SCALE_PX = 0.02
_MAX_SCALE_PX = 12.0
_MIN_SIGMA_PX = 0.02
_MAX_SIGMA_PX = 64.0
_ONE_SIGMA_PROBABILITY = 0.6827


@dataclass(frozen=True)
class DisparityMixture:
    """Distribution of each pixel's disparity, a mixture of k Laplace distributions (B, k, ...)."""

    log_weight: Tensor
    mean: Tensor
    """[px]"""
    scale: Tensor
    """[px]"""
    visible: Tensor
    """(B, ...) logit of the probability that both cameras see the surface"""

    def log_density(self, disparity: Tensor) -> Tensor:
        """Logarithm of the density (B, ...) of disparities (B, ...)."""
        distance = (disparity[:, None] - self.mean).abs()
        return torch.logsumexp(self.log_weight - distance / self.scale - torch.log(2 * self.scale), dim=1)

    def mass_within(self, disparity: Tensor, radius: Tensor) -> Tensor:
        """Probability of [disparity - radius, disparity + radius], all (B, ...)."""
        below = disparity[:, None] - radius[:, None] - self.mean
        above = disparity[:, None] + radius[:, None] - self.mean
        share = _cumulative(above / self.scale) - _cumulative(below / self.scale)
        return (self.log_weight.exp() * share).sum(dim=1)

    def mode(self, window_px: float = 0.5) -> Tensor:
        """(B, ...) the mean of a component with the largest probability in a window around it [px]."""
        radius = torch.full_like(self.visible, window_px)
        best = self.mean[:, 0]
        most = self.mass_within(best, radius)
        for mean in self.mean.unbind(dim=1)[1:]:
            mass = self.mass_within(mean, radius)
            best, most = torch.where(mass > most, mean, best), torch.maximum(mass, most)
        return best

    def sigma(self, disparity: Tensor, rounds: int = 6) -> Tensor:
        """Half the width (B, ...) [px] of the interval around ``disparity`` with a probability of 68 %.

        By bisection of its logarithm, and linear interpolation in the last interval.
        """
        low, high = (torch.full_like(disparity, end).log() for end in (_MIN_SIGMA_PX, _MAX_SIGMA_PX))
        mass_low, mass_high = torch.zeros_like(disparity), torch.ones_like(disparity)
        for _ in range(rounds):
            middle = 0.5 * (low + high)
            mass = self.mass_within(disparity, middle.exp())
            inside = mass > _ONE_SIGMA_PROBABILITY
            low, mass_low = torch.where(inside, low, middle), torch.where(inside, mass_low, mass)
            high, mass_high = torch.where(inside, middle, high), torch.where(inside, mass, mass_high)
        share = (_ONE_SIGMA_PROBABILITY - mass_low) / (mass_high - mass_low).clamp(min=1e-6)
        return (low + share.clamp(0.0, 1.0) * (high - low)).exp()

    def strongest(self, count: int) -> "DisparityMixture":
        """The ``count`` components of largest weight, renormalised."""
        log_weight, chosen = self.log_weight.topk(count, dim=1)
        return DisparityMixture(
            functional.log_softmax(log_weight, dim=1),
            self.mean.gather(1, chosen),
            self.scale.gather(1, chosen),
            self.visible,
        )


def _cumulative(x: Tensor) -> Tensor:
    """Cumulative Laplace distribution of scale 1."""
    return 0.5 + 0.5 * torch.sign(x) * -torch.expm1(-x.abs())


class _ResidualBlock(nn.Module):
    """Two convolutions with a skip connection."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = x + self.second(functional.relu(self.first(functional.relu(x))))
        return out


class DisparityNet(nn.Module):
    """Input channels (B, CHANNELS, h, w) to raw outputs (B, OUTPUTS, h, w); h, w multiples of ``STRIDE``."""

    sigma_scale: Tensor

    def __init__(self, widths: tuple[int, ...] = WIDTHS) -> None:
        super().__init__()
        self.stem = nn.Conv2d(4 * CHANNELS, widths[0], 1)
        self.enter = nn.ModuleList(_ResidualBlock(w) for w in widths)
        pairs = list(pairwise(widths))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 2, stride=2) for a, b in pairs)
        self.up = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in pairs)
        self.leave = nn.ModuleList(_ResidualBlock(a) for a, _ in pairs)
        self.head = nn.Conv2d(widths[0], 4 * OUTPUTS, 1)
        # Not learned but calibrated on held-out bodies, for the sigma of the final disparity.
        self.register_buffer("sigma_scale", torch.ones(()))
        for block in [*self.enter, *self.leave]:
            assert isinstance(block, _ResidualBlock)
            nn.init.zeros_(block.second.weight)
        nn.init.zeros_(self.head.weight)
        # With channels last, convolutions on a CPU take half the time.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, channels: Tensor) -> Tensor:
        x = self.enter[0](self.stem(functional.pixel_unshuffle(channels, 2)))
        skipped = []
        for down, enter in zip(self.down, list(self.enter)[1:], strict=True):
            skipped.append(x)
            x = enter(down(x))
        for up, leave in zip(reversed(self.up), reversed(self.leave), strict=True):
            # A 1x1 convolution and an enlargement commute: fewer channels are enlarged.
            wide = functional.interpolate(up(x), scale_factor=2.0, mode="bilinear", align_corners=False)
            x = leave(wide + skipped.pop())
        # corrections of a hundredth of a pixel need more digits than the layers before
        with torch.autocast("cpu", enabled=False):
            out: Tensor = functional.pixel_shuffle(
                self.head(functional.relu(x).to(self.head.weight.dtype)), 2
            )
        return out


def mixture_from_outputs(raw: Tensor, hypotheses: Tensor) -> DisparityMixture:
    """Distribution from raw outputs (B, OUTPUTS, ...) and hypotheses (B, k, ...) [px]."""
    k = HYPOTHESES
    raw = raw.float()
    # Before training all outputs are zero: the first hypothesis then has the largest weight.
    preference = torch.zeros_like(raw[:, :k])
    preference[:, 0] = 2.0
    log_weight = functional.log_softmax(raw[:, :k] + preference, dim=1)
    scale = _MIN_SCALE_PX + functional.softplus(raw[:, 2 * k : 3 * k] - 1.5).clamp(max=_MAX_SCALE_PX)
    return DisparityMixture(log_weight, hypotheses + raw[:, k : 2 * k], scale, raw[:, 3 * k])
