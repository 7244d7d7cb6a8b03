"""Which images of a recording become pairs of the dataset."""

from dataclasses import dataclass, replace

import numpy as np

from polhode.geometry.lie import Ints
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents
from polhode.records.pairing import (
    Pairing,
    differences_in_words,
    offset_in_words,
    pair_by_time,
    time_in_words,
)
from polhode.runtime.errors import InputError

MIN_PAIRS = 3


@dataclass(frozen=True)
class ChosenPairs:
    """The pairs that are imported, K of them, in order of time."""

    left: Ints
    """(K,) indices into the left timestamps"""
    right: Ints
    """(K,) into the right ones"""
    stamps_ns: Ints
    """(K,) of the pairs: those of the left images"""
    offset_ns: int
    """What the right camera's timestamps were later"""
    interval_ns: int
    """Usual interval between images of the left camera"""
    unpaired: tuple[int, int]
    """Images of the left and the right camera without a partner"""
    warnings: tuple[str, ...]

    @property
    def rate_hz(self) -> float:
        """Pairs a second, as they are imported."""
        step_ns = float(np.median(np.diff(self.stamps_ns))) if len(self.stamps_ns) > 1 else 0.0
        return 1e9 / step_ns if step_ns else 1.0

    def first(self, count: int) -> "ChosenPairs":
        """The first pairs alone."""
        return replace(
            self, left=self.left[:count], right=self.right[:count], stamps_ns=self.stamps_ns[:count]
        )


def choose_pairs(name: str, contents: Contents, options: ImportOptions) -> ChosenPairs:
    """Pairs by nearest time, then the part and the steps that the user wants.

    Raises InputError when there is no common time, or too few pairs are within the tolerance or the part.
    """
    left_ns, right_ns = contents.stamps_ns
    has_ranges = contents.ranges is not None
    given_ns = None if options.offset_s is None else round(1e9 * options.offset_s)
    tolerance_ns = None if options.tolerance_s is None else round(1e9 * options.tolerance_s)
    first_ns, last_ns = (int(right_ns[k]) - (given_ns or 0) for k in (0, -1))
    gap_ns = max(first_ns - int(left_ns[-1]), int(left_ns[0]) - last_ns)
    if gap_ns > 0:
        both = "images and depth images" if has_ranges else "the cameras"
        early, late = ("images", "depth images") if has_ranges else ("left one", "right one")
        begin, end = ("begin", "end") if has_ranges else ("begins", "ends")
        if first_ns < left_ns[0]:
            early, late = late, early
        off_s = 1e-9 * (first_ns - int(left_ns[0]))
        raise InputError(
            f"{name}: {both} have no time in common: the {late} {begin} {time_in_words(gap_ns)} after the "
            f"{early} {end}; if only their clocks differ, give --offset-s {off_s:.9g}"
        )
    pairing = pair_by_time(left_ns, right_ns, tolerance_ns, given_ns)
    # of the camera that has fewer images, what a dataset may have lost
    if len(pairing.left) < max(MIN_PAIRS, 0.4 * min(len(left_ns), len(right_ns))):
        raise _too_few(name, pairing, has_ranges)
    stamps_ns = left_ns[pairing.left]
    since_s = 1e-9 * (stamps_ns - stamps_ns[0])
    chosen = np.flatnonzero((since_s >= options.start_s) & (since_s <= options.end_s))[:: options.every]
    if len(chosen) < MIN_PAIRS:
        raise InputError(
            f"{name}: {len(chosen)} of {len(stamps_ns)} pairs are left by --start, --end and --every; at "
            f"least {MIN_PAIRS} are needed of the {since_s[-1]:.4g} s"
        )
    lone = len(left_ns) - len(pairing.left), len(right_ns) - len(pairing.right)
    warnings = []
    if pairing.offset_ns and given_ns is None:
        two = ("the depth images", "the images") if has_ranges else ("the right camera", "the left one")
        words = offset_in_words(pairing.offset_ns, pairing.interval_ns, *two)
        warnings.append(f"{words}: taken for an offset of their clocks, and removed")
    if any(lone):
        words = differences_in_words(np.delete(pairing.nearest_ns, pairing.left)) if lone[0] else ""
        second = "depth" if has_ranges else "right"
        nearest = f"; the nearest {second} images are off {words}" if words else ""
        warnings.append(
            f"{lone[0]} {'' if has_ranges else 'left '}and {lone[1]} {second} images have no partner within "
            f"{time_in_words(pairing.tolerance_ns)}{nearest} (--tolerance-s)"
        )
    return ChosenPairs(
        pairing.left[chosen],
        pairing.right[chosen],
        stamps_ns[chosen],
        pairing.offset_ns,
        pairing.interval_ns,
        lone,
        tuple(warnings),
    )


def _too_few(name: str, pairing: Pairing, has_ranges: bool) -> InputError:
    """The line about stamps that do not fit each other."""
    raw_ns = pairing.nearest_ns + pairing.offset_ns
    near = raw_ns[2 * np.abs(raw_ns) <= pairing.interval_ns]
    if not len(near):
        which = "image has a depth image" if has_ranges else "left image has a right one"
        clock = "the depth images'" if has_ranges else "the right camera's"
        return InputError(
            f"{name}: no {which} within half of its interval of {time_in_words(pairing.interval_ns)}; give "
            f"the --offset-s of {clock} clock"
        )
    middle_ns = float(np.median(near))
    least, most, usual = (
        ("-" if each < 0 else "") + time_in_words(each) for each in (near.min(), near.max(), middle_ns)
    )
    needed_s = 1.05e-9 * float(np.abs(near - middle_ns).max())
    nearest, advice = "the nearest images of the two cameras", "trigger the cameras together"
    if has_ranges:
        nearest, advice = "images and their nearest depth images", "take them at the same time"
    return InputError(
        f"{name}: {len(pairing.left)} pairs within {time_in_words(pairing.tolerance_ns)} of a constant "
        f"offset: {nearest} differ by {least} to {most}, {usual} in the median; {advice}, or give "
        f"--tolerance-s {needed_s:.3g} to pair them nevertheless"
    )
