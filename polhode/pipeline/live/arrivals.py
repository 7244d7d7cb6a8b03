"""What becomes of pairs that come late, twice or not at all: the policy, and the warnings that name them.

- late, or with the time of the latest pair: not used, as its place in the past is taken;
- an image of the pair before, bit for bit: nothing is measured in it, the dynamics bridge it;
- missing: nothing needs to be done, the dynamics bridge the gap;
- dropped, as the queue was full, unpaired or unreadable: likewise.
"""

import logging
from collections import defaultdict
from typing import Literal

import numpy as np

Kind = Literal["late", "same time", "repeated", "missing", "dropped", "unusable"]
SENTENCES: dict[Kind, str] = {
    "late": "not used: earlier than the pair before",
    "same time": "not used: the time of the pair before",
    "repeated": "not measured: an image of the pair before, bit for bit",
    "missing": "pairs are missing before these",
    "dropped": "dropped from the full queue: they came faster than they were processed",
    "unusable": "not used: without a partner, unreadable, or without a pose of the inspector",
}
LONG_GAP = 1.5
"""An interval of more usual ones means that pairs are missing."""
MIN_INTERVALS = 3
"""Number of intervals from which the usual one is known."""
NAMED = 10
"""Pairs that a sentence of the summary names."""

_log = logging.getLogger(__name__)


class Arrivals:
    """Judges the time of each pair, and keeps what was odd."""

    def __init__(self) -> None:
        self._odd: dict[Kind, list[str]] = defaultdict(list)
        self._latest_ns: int | None = None
        self._intervals_ns: list[int] = []

    def accepts(self, timestamp_ns: int) -> bool:
        """Whether a pair is to be used; gaps before it are noted."""
        if self._latest_ns is None:
            self._latest_ns = timestamp_ns
            return True
        interval_ns = timestamp_ns - self._latest_ns
        if interval_ns <= 0:
            late = f"{timestamp_ns} ns"
            self.note("same time" if interval_ns == 0 else "late", late)
            return False
        if len(self._intervals_ns) >= MIN_INTERVALS:
            usual_ns = float(np.median(self._intervals_ns))
            if interval_ns > LONG_GAP * usual_ns:
                missing = round(interval_ns / usual_ns) - 1
                self.note("missing", f"{timestamp_ns} ns (about {max(missing, 1)})")
        self._intervals_ns.append(interval_ns)
        self._latest_ns = timestamp_ns
        return True

    def note(self, kind: Kind, pair: str) -> None:
        """Keep what was odd about a pair, and warn of it at once."""
        self._odd[kind].append(pair)
        _log.warning("live: %s: %s", SENTENCES[kind], pair)

    def count(self, kind: Kind) -> int:
        """How often it has happened."""
        return len(self._odd[kind])

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each kind of what was odd."""
        lines = []
        for kind, pairs in self._odd.items():
            if pairs:
                named = ", ".join(pairs[:NAMED]) + (", ..." if len(pairs) > NAMED else "")
                lines.append(f"live: {SENTENCES[kind]} ({len(pairs)}): {named}")
        return tuple(lines)
