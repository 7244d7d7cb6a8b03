"""What is known after a pair has come, and what it took."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from polhode.backend.window.causal_state import OnlineState

Status = Literal["searching", "predicted", "measured"]
RPM = 30.0 / np.pi


@dataclass(frozen=True, kw_only=True)
class LiveState(OnlineState):
    """The state after a pair, from this pair and earlier ones; variances are inf where undetermined.

    G is the frame of the stream: it begins again, as ``restarts`` counts, when the motion was lost.
    """

    number: int
    """Of the pair, counted from 0"""
    status: Status
    """searching: no motion is known yet; predicted: the pair shows nothing that agrees, the dynamics bridge
    it; measured"""
    observations: int
    """Of this pair, that agree with the motion"""
    restarts: int
    sigma_rate: float
    """Standard deviation of the size of w [rad/s], which is known long before the axes are; inf: unknown"""
    seconds: Mapping[str, float]
    """Time of each stage: features, matching, window"""

    @property
    def rate_rpm(self) -> float:
        """Rate of rotation."""
        return float(np.linalg.norm(self.w_P)) * RPM

    @property
    def sigma_rate_rpm(self) -> float:
        """Its standard deviation; inf: unknown."""
        return self.sigma_rate * RPM
