"""Which images of two cameras belong together, from their timestamps alone.

Cameras of one rig are triggered together, but their stamps come from clocks or drivers of their own: they may
differ by a constant, and scatter about it. The constant is the median of the differences between nearest
stamps; a pair is accepted within a tolerance about it.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Ints

TOLERANCE = 0.01
"""Of the usual interval between frames. A feature that moves by 30 px from frame to frame moves by 0.3 px in
it, which is the noise of a feature; hardware triggers scatter by a hundredth of it."""
MAX_OFFSET = 0.45
"""Of the interval: beyond it the next image is nearly as near."""


@dataclass(frozen=True)
class Pairing:
    """Pairs of the stamps of two cameras, P of them, in order of time."""

    left: Ints
    """(P,) indices into the left camera's stamps"""
    right: Ints
    """(P,) into the right one's"""
    offset_ns: int
    """What the right stamps are later than the left ones, throughout"""
    tolerance_ns: int
    """Largest accepted deviation from it"""
    interval_ns: int
    """Usual interval between frames of the left camera; 0: a single frame"""
    nearest_ns: Ints
    """(L,) difference of each left stamp to the nearest right one, right minus left, without the offset"""


def pair_by_time(
    left_ns: Ints, right_ns: Ints, tolerance_ns: int | None = None, offset_ns: int | None = None
) -> Pairing:
    """Pair stamps (L,), (R,) [ns], each strictly increasing: mutually nearest ones within a tolerance.

    ``tolerance_ns``: by default a hundredth of the usual interval. ``offset_ns`` of the right clock: by
    default the median difference of mutually nearest stamps, and exactly 0 where most are equal, or where
    that would be more than ``MAX_OFFSET`` intervals. Stamps alone leave whole intervals open.
    """
    left_ns, right_ns = np.asarray(left_ns, np.int64), np.asarray(right_ns, np.int64)
    stamps = left_ns if len(left_ns) > 1 else right_ns
    interval_ns = int(np.median(np.diff(stamps))) if len(stamps) > 1 else 0
    if tolerance_ns is None:
        tolerance_ns = int(TOLERANCE * interval_ns)
    if offset_ns is None:
        left, right = _mutually_nearest(left_ns, right_ns)
        # a difference that occurs, so that equal stamps have no offset at all
        differences = np.sort(right_ns[right] - left_ns[left])
        offset_ns = int(differences[(len(differences) - 1) // 2]) if len(left) else 0
        if abs(offset_ns) > MAX_OFFSET * interval_ns:
            offset_ns = 0
    left, right = _mutually_nearest(left_ns, right_ns - offset_ns)
    near = np.abs(right_ns[right] - offset_ns - left_ns[left]) <= tolerance_ns
    # where there is no image to be near
    nearest = np.full(len(left_ns), 2**62, np.int64)
    if len(right_ns):
        nearest = right_ns[_nearest(right_ns - offset_ns, left_ns)] - offset_ns - left_ns
    return Pairing(left[near], right[near], offset_ns, tolerance_ns, interval_ns, nearest)


def time_in_words(time_ns: float) -> str:
    """The size of a difference of times: '4 us', '12.5 ms', '0.2 s'."""
    size = abs(time_ns)
    for unit, name in ((1e9, "s"), (1e6, "ms"), (1e3, "us")):
        if size >= 0.1 * unit and (size >= unit or name == "s"):
            return f"{size / unit:.4g} {name}"
    return f"{size:.4g} ns"


def offset_in_words(offset_ns: float, interval_ns: float, camera: str = "cam1", other: str = "cam0") -> str:
    """'the stamps of cam1 are 0.2 s (0.4 frames) after those of cam0'."""
    frames = f" ({abs(offset_ns) / interval_ns:.2g} frames)" if interval_ns else ""
    order = "after" if offset_ns > 0 else "before"
    return f"the stamps of {camera} are {time_in_words(offset_ns)}{frames} {order} those of {other}"


def _mutually_nearest(left_ns: Ints, right_ns: Ints) -> tuple[Ints, Ints]:
    if not (len(left_ns) and len(right_ns)):
        none = np.empty(0, np.int64)
        return none, none
    to_right, to_left = _nearest(right_ns, left_ns), _nearest(left_ns, right_ns)
    left = np.flatnonzero(to_left[to_right] == np.arange(len(left_ns)))
    return left, to_right[left]


def _nearest(among_ns: Ints, stamps_ns: Ints) -> Ints:
    """(n,) index of the stamp in ``among_ns`` that is nearest to each; the earlier one of two."""
    after = np.clip(np.searchsorted(among_ns, stamps_ns), 0, len(among_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_before = stamps_ns - among_ns[before] <= among_ns[after] - stamps_ns
    return np.where(is_before & (among_ns[before] <= stamps_ns), before, after)


def differences_in_words(differences_ns: Array | Ints) -> str:
    """'by 1.2 ms to 8 ms, 4 ms in the median'."""
    sizes = np.abs(np.asarray(differences_ns))
    if not len(sizes):
        return "by nothing that can be stated"
    low, middle, high = (time_in_words(float(each)) for each in (sizes.min(), np.median(sizes), sizes.max()))
    return f"by {low}" if low == high else f"by {low} to {high}, {middle} in the median"
