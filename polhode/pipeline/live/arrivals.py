"""What becomes of pairs that come late, twice or not at all: the policy, and the warnings that name them.

- late, or with the time of the latest pair: not used, as its place in the past is taken;
- an image of the pair before, bit for bit: nothing is measured in it, the dynamics bridge it;
- missing: nothing needs to be done, the dynamics bridge the gap;
- dropped, as the queue was full, unpaired or unreadable: likewise.
"""

import logging
from collections import defaultdict
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from polhode.files.images import bit_depth, has_content, to_grey
from polhode.geometry.lie import Bools
from polhode.records.dataset import StereoImages
from polhode.runtime.errors import InputError

Kind = Literal["late", "same time", "repeated", "missing", "dropped", "unusable"]
SENTENCES: dict[Kind, str] = {
    "late": "not used: earlier than the pair before",
    "same time": "not used: the time of the pair before",
    "repeated": "not measured: an image of the pair before, bit for bit",
    "missing": "pairs are missing before these",
    "dropped": "dropped from the full queue: they came faster than they were processed",
    "unusable": "not used: without a partner, unreadable, or without a pose of the inspector",
}
MIN_PAIRS = 3
NAMED = 10
"""Pairs that a sentence of the summary names."""

_log = logging.getLogger(__name__)


class Arrivals:
    """Judges the pairs of a stream as they come, and keeps what was odd."""

    def __init__(self, bits: int | None = None) -> None:
        """bits: of the images; None: as the first pair shows."""
        self._bits = bits
        self._odd: dict[Kind, list[str]] = defaultdict(list)
        self._latest_ns: int | None = None
        self._intervals_ns: list[int] = []
        self._before: tuple[bytes, bytes] | None = None

    def accepts(self, timestamp_ns: int) -> bool:
        """Whether a pair is to be used; gaps before it are noted."""
        if self._latest_ns is not None:
            interval_ns = timestamp_ns - self._latest_ns
            if interval_ns <= 0:
                self.note("same time" if interval_ns == 0 else "late", f"{timestamp_ns} ns")
                return False
            # from three intervals on the usual one is known
            if len(self._intervals_ns) >= 3:
                usual_ns = float(np.median(self._intervals_ns))
                if interval_ns > 1.5 * usual_ns:
                    missing = round(interval_ns / usual_ns) - 1
                    self.note("missing", f"{timestamp_ns} ns (about {max(missing, 1)})")
            self._intervals_ns.append(interval_ns)
        self._latest_ns = timestamp_ns
        return True

    def images(
        self,
        timestamp_ns: int,
        left: NDArray[Any],
        right: NDArray[Any],
        masks: tuple[Bools | None, Bools | None],
    ) -> StereoImages:
        """The pair in grey levels of 8 bits. If one of its images is that of the pair before, bit for bit, no
        sensor has taken it: the masks are empty, so that nothing is measured."""
        if self._bits is None:
            self._bits = bit_depth(int(max(left.max(), right.max())))
        images = StereoImages(to_grey(left, self._bits), to_grey(right, self._bits), *masks)
        before, self._before = self._before, (left.tobytes(), right.tobytes())
        for k, image in enumerate((images.left, images.right)):
            if before is not None and before[k] == self._before[k] and has_content(image):
                self.note("repeated", f"{timestamp_ns} ns")
                nothing = (np.zeros(each.shape, dtype=np.bool_) for each in (images.left, images.right))
                return StereoImages(images.left, images.right, *nothing)
        return images

    def note(self, kind: Kind, pair: str) -> None:
        """Keep what was odd about a pair, and warn of it at once."""
        self._odd[kind].append(pair)
        _log.warning("live: %s: %s", SENTENCES[kind], pair)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each kind of what was odd."""
        return tuple(
            f"live: {SENTENCES[kind]} ({len(pairs)}): {', '.join(pairs[:NAMED])}"
            + (", ..." if len(pairs) > NAMED else "")
            for kind, pairs in self._odd.items()
        )


def require_pairs(n_pairs: int, where: str) -> None:
    """Raise InputError when too few pairs have come for a motion."""
    if n_pairs < MIN_PAIRS:
        raise InputError(f"{where}: {n_pairs} pairs have come; at least {MIN_PAIRS} are needed")
