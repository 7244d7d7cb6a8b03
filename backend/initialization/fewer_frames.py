"""First motions from fewer frames, for when some frames contradict the others.

A body whose sides look alike, by a third of a turn about the axis of a dish say, is put into a wrong attitude
where few features are seen, or after a long absence. The frames that were put so agree among themselves, and
no motion fits them and the others. Fitted from fewer frames, the motion carries into the rest by Euler's
equation; what agrees with it there counts again, what does not is left out.
"""

from dataclasses import replace

import numpy as np

from polhode.backend.initialization.gaps import long_gaps
from polhode.backend.initialization.initialize import frame_rates
from polhode.records import Bools, InitialMotion, Ints, StereoTracks

SHARE, LEAST = 0.3, 12
"""Of what the richest tenth of the frames shows, and observations: less is little."""
ENOUGH_FRAMES = 6
MOST_STRETCHES = 2
"""Between long gaps, those that show most first."""


def from_fewer_frames(tracks: StereoTracks, initial: InitialMotion) -> list[InitialMotion]:
    """First motions with fewer known poses: those of frames that show much, of stretches between gaps."""
    seen = np.bincount(tracks.frame, minlength=tracks.n_frames)
    out: list[Bools] = []
    for known in (_strong(seen, initial.connected), *_stretches(tracks, initial, seen)):
        told = known.sum() >= ENOUGH_FRAMES and not np.array_equal(known, initial.connected)
        if told and not any(np.array_equal(known, other) for other in out):
            out.append(known)
    # the other poses stay where they were: in a first fit with loose steps their frames then pull at nothing
    return [replace(initial, connected=known) for known in out]


def _strong(seen: Ints, connected: Bools) -> Bools:
    rich = float(np.quantile(seen[connected], 0.9))
    return np.asarray(connected & (seen >= max(SHARE * rich, LEAST)))


def _stretches(tracks: StereoTracks, initial: InitialMotion, seen: Ints) -> list[Bools]:
    w_G = frame_rates(tracks.time_s, tracks.X_NR @ initial.X_RG, initial.connected)
    starts = [gap.after for gap in long_gaps(tracks.time_s, initial.connected, w_G) if gap.after is not None]
    stretch = np.searchsorted(starts, np.arange(tracks.n_frames), side="right")
    shown = np.bincount(stretch, seen * initial.connected)
    most = np.argsort(-shown, kind="stable")[:MOST_STRETCHES]
    return [np.asarray(initial.connected & (stretch == n)) for n in most]
