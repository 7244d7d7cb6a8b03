"""How long a whole run still takes, from the shares of its stages in the runs that were measured.

The shares differ from sequence to sequence; what has passed of the run at hand corrects them with each step.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

MIN_SHARE = 0.03
"""Of the whole run, since its first stage: before it has passed, nothing is said."""


@dataclass(frozen=True)
class StageShare:
    """When a stage begins and ends, as shares of the duration of the whole."""

    title: str
    """Without what stands in brackets"""
    begins: float
    ends: float


RUN_SHARES = (
    StageShare("features", 0.03, 0.17),
    StageShare("matching frames", 0.17, 0.25),
    StageShare("first motion", 0.28, 0.35),
    StageShare("motion and inertia", 0.35, 0.43),
    StageShare("motion and inertia", 0.44, 0.48),
    StageShare("fusing depth", 0.49, 0.65),
    StageShare("checks and pictures", 0.97, 0.97),
    StageShare("report", 0.97, 1.00),
)
"""Of ``polhode run``, a stage that comes twice standing twice; means over runs of the sample and of ts38"""


class TimeLeft:
    """Estimates the time until the end of the whole while its stages follow one another."""

    def __init__(
        self, shares: Sequence[StageShare] = RUN_SHARES, now: Callable[[], float] = perf_counter
    ) -> None:
        self._shares, self._now = shares, now
        self._times = [time for share in shares for time in (share.begins, share.ends)]
        self._seen: Counter[str] = Counter()
        self._first: tuple[float, float] | None = None
        """Share and time [s] at which the first stage began: libraries may take long to load before it, and
        what a resumed run skips takes no time"""
        self._stage: StageShare | None = None
        self.share = 0.0
        """Of the whole that has passed"""
        self._left_s: float | None = None
        self._as_of = 0.0

    def begin(self, title: str) -> None:
        """A stage begins."""
        name = title.partition(" (")[0]
        known = [share for share in self._shares if share.title == name]
        self._stage = known[min(self._seen[name], len(known) - 1)] if known else None
        self._seen[name] += 1
        self.advance(0.0)

    def seconds(self) -> float | None:
        """Until the end of the whole; None: not known yet."""
        if self._left_s is None:
            return None
        # what follows this stage, or the pause after it, is still to come, however long it takes
        reached = min((time for time in self._times if time > self.share), default=1.0)
        at_least = self._left_s * (1.0 - reached) / (1.0 - self.share) if self.share < 1.0 else 0.0
        return max(self._left_s - (self._now() - self._as_of), at_least)

    def advance(self, done: float) -> None:
        """So much of the stage is done, from 0 to 1."""
        if self._stage is None:
            return
        now = self._now()
        share = self._stage.begins + done * (self._stage.ends - self._stage.begins)
        if self._first is None:
            self._first = (share, now)
        # a stage that comes once more than expected does not set the clock back
        self.share = max(self.share, share)
        before, since = self._first
        if self.share - before > MIN_SHARE:
            self._left_s = (now - since) * (1.0 - self.share) / (self.share - before)
            self._as_of = now
