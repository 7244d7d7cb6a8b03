"""How long a run will take, and how much memory it needs: an estimate for a machine of two cores.

Time grows with the frames, with the pixels of the target that features are detected in, and with the pairs of
frames that are matched; memory with the frames and with the pixels of an image. ``python -m
lab.checkout.run_cost`` prints the constants, and how far runs lie from the estimate.
"""

from dataclasses import dataclass

from polhode.config.frontend_settings import PairMatching
from polhode.pipeline.checkout.check_table import make_check
from polhode.pipeline.checkout.result import CheckoutCheck

S_PER_FRAME, S_PER_MPX, S_PER_PAIR = 1.2, 2.0, 0.03
"""Per frame; per frame and million pixels of the target's bounding box; per pair of frames that is matched
[s]"""
SPREAD = 2.0
"""Nine of ten runs take between the estimate divided by this and multiplied by it."""
GIB_BASE, GIB_PER_FRAME, GIB_PER_MPX = 2.0, 0.005, 0.2
"""Of all processes together [GiB], per frame, per million pixels of an image."""


@dataclass(frozen=True)
class RunSize:
    """What the cost of a run depends on."""

    frames: int
    image_mpx: float
    """Of one rectified image [million pixels]"""
    target_mpx: float
    """Of the target's bounding box [million pixels]"""
    noun: str = "pairs"
    """What the frames are called"""

    @property
    def matched_pairs(self) -> int:
        """Pairs of frames that the default configuration matches."""
        pairs, every = PairMatching(), self.frames * (self.frames - 1) // 2
        if self.frames <= pairs.exhaustive_frames:
            return every
        return min(every, self.frames * (pairs.neighbours + pairs.retrieved))


def seconds(size: RunSize) -> float:
    """Wall-clock time of ``polhode run`` [s]."""
    return size.frames * (S_PER_FRAME + S_PER_MPX * size.target_mpx) + S_PER_PAIR * size.matched_pairs


def cost_checks(size: RunSize) -> list[CheckoutCheck]:
    """Estimates, each with a limit from which on a user may want to know."""
    minutes = seconds(size) / 60.0
    memory_gib = GIB_BASE + GIB_PER_FRAME * size.frames + GIB_PER_MPX * size.image_mpx
    finding = (
        f"An estimate for two cores: {size.frames} {size.noun}, {size.matched_pairs} pairs of frames to "
        f"match; nine of ten runs take {minutes / SPREAD:.2g} to {minutes * SPREAD:.2g} min."
    )
    return [
        make_check("run time", round(minutes, 1), finding),
        make_check("memory", round(memory_gib, 1), "An estimate for two worker processes."),
    ]
