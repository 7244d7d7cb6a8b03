"""The tail of a distribution of which some draws are known: levels that are seldom exceeded.

Excesses over a high threshold follow a generalized Pareto distribution (Pickands, Annals of Statistics 3,
1975). Its shape and scale are uncertain after few draws; the probability that a further draw exceeds a level
is its mean over their posterior, so that a bound holds on average with the stated probability. Where enough
draws lie beyond the bound, it is an order statistic (split conformal prediction: Vovk, Gammerman, Shafer
2005).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from polhode.geometry.lie import Array

TAIL_SHARE = 0.15
"""Of the draws, those that make the tail"""
LEAST_BEYOND = 10.0
"""Draws that must be expected beyond a bound for an order statistic"""
SHAPE_MEAN, SHAPE_SIGMA = 0.05, 0.2
"""Prior of the shape: 0 for Gaussian errors, above 0 for longer tails"""
SHAPES = np.linspace(-0.6, 1.2, 73)
SCALES = np.exp(np.linspace(-2.5, 2.5, 81))
"""Over the mean excess"""


@dataclass(frozen=True)
class ScoreTail:
    """Of n scores: the tail beyond a threshold, as a mixture of generalized Pareto distributions."""

    scores: Array
    """(n,) ascending"""
    threshold: float
    share: float
    """of a further score to exceed the threshold"""
    weight: Array
    """(shapes, scales) posterior"""
    scale: Array
    """(scales,)"""

    @classmethod
    def of(cls, scores: Array) -> "ScoreTail":
        """scores (n,), at least 20."""
        ascending = np.sort(scores)
        count = max(int(TAIL_SHARE * len(scores)), min(20, len(scores) // 2))
        threshold = float(ascending[-count - 1])
        excess = ascending[-count:] - threshold
        mean = max(float(excess.mean()), 1e-12)
        scale = mean * SCALES
        xi, sigma = SHAPES[:, None, None], scale[None, :, None]
        inner = 1.0 + xi * excess / sigma
        with np.errstate(divide="ignore", invalid="ignore"):
            # the exponential distribution where the shape vanishes
            each = np.where(
                np.abs(xi) < 1e-9, excess / sigma, (1.0 / xi + 1.0) * np.log(np.maximum(inner, 1e-300))
            )
        log = -count * np.log(scale) - each.sum(axis=2)
        log = np.where((inner > 0.0).all(axis=2), log, -np.inf)
        log -= 0.5 * ((SHAPES[:, None] - SHAPE_MEAN) / SHAPE_SIGMA) ** 2
        weight = np.exp(log - log.max())
        return cls(ascending, threshold, (count + 0.5) / (len(scores) + 1.0), weight / weight.sum(), scale)

    def exceeded(self, level: float) -> float:
        """The probability that a further score exceeds a level."""
        n = len(self.scores)
        if level <= self.threshold:
            return (n - int(np.searchsorted(self.scores, level, side="right")) + 0.5) / (n + 1.0)
        return self._beyond(level - self.threshold)

    def bound(self, miss: float) -> float:
        """The level that a further score exceeds with the probability ``miss``."""
        n = len(self.scores)
        if miss * n >= LEAST_BEYOND:
            return float(self.scores[int(np.ceil((n + 1) * (1.0 - miss))) - 1])
        if miss >= self.share:
            return self.threshold
        high = float(self.scale[-1])
        while self._beyond(high) > miss:
            high *= 2.0
        return self.threshold + float(brentq(lambda x: self._beyond(x) - miss, 0.0, high, xtol=1e-6 * high))

    def sigma(self, miss: float) -> float:
        """Standard deviation of the level that is truly exceeded with the probability ``miss``."""
        n = len(self.scores)
        if miss * n >= LEAST_BEYOND:
            # of an order statistic, by those a standard deviation of their number farther in and out
            at, off = (n + 1) * (1.0 - miss), np.sqrt(n * miss)
            low, high = np.interp([at - off, at + off], np.arange(1, n + 1), self.scores)
            return float(0.5 * (high - low))
        rarer = np.log(max(self.share / miss, 1.0))
        xi = np.where(np.abs(SHAPES) < 1e-9, 1e-9, SHAPES)[:, None]
        level = self.scale * np.expm1(xi * rarer) / xi
        mean = float((self.weight * level).sum())
        return float(np.sqrt((self.weight * (level - mean) ** 2).sum()))

    def _beyond(self, excess: float) -> float:
        """The probability that a further score exceeds the threshold by more than this."""
        xi = np.where(np.abs(SHAPES) < 1e-9, 1e-9, SHAPES)[:, None]
        survival = np.maximum(1.0 + xi * excess / self.scale, 0.0) ** (-1.0 / xi)
        return self.share * float((self.weight * survival).sum())
