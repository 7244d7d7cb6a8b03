"""What the user chose for an import."""

import math
from dataclasses import dataclass
from pathlib import Path

from polhode.importers.times import TimeUnit
from polhode.records.range_images import RangeModel
from polhode.runtime.errors import InputError


@dataclass(frozen=True)
class Crop:
    """The part of an image that is kept [px]."""

    left: int
    top: int
    width: int
    height: int

    def require_inside(self, size_px: tuple[int, int]) -> None:
        """Raise InputError unless images of this width and height contain the part."""
        if self.left + self.width > size_px[0] or self.top + self.height > size_px[1]:
            raise InputError(
                f"--crop {self.left},{self.top},{self.width},{self.height}: reaches beyond the images of "
                f"{size_px[0]}x{size_px[1]} px; give a part inside them"
            )


@dataclass(frozen=True)
class ImportOptions:
    """Choices of the user; the defaults take what there is."""

    calibration: tuple[Path, ...] = ()
    """Files or a folder; empty: the recording's own"""
    unit_m: float = 1.0
    """Unit of T in OpenCV's files [m]"""
    stamps: tuple[Path, ...] = ()
    """Tables of timestamps, for images and videos that have none: one for both cameras, or one each"""
    time_unit: TimeUnit | None = None
    """Of times in tables and names; None: by header, size and intervals"""
    rate_hz: float | None = None
    """Frames a second, for numbered images, and for videos instead of their own times"""
    left_topic: str | None = None
    right_topic: str | None = None
    poses: str | None = None
    """Topic of the inspector's poses, ``tf:FRAME``, or ``none``; None: odometry that fits"""
    pose_of: str | None = None
    """The frame whose pose the topic states; ``left``: the left camera"""
    tolerance_s: float | None = None
    """Largest difference of the stamps of a pair, beyond the offset [s]; None: a hundredth of the interval"""
    offset_s: float | None = None
    """What the right camera's stamps are later than the left's [s]; None: found from the stamps"""
    start_s: float = 0.0
    """Of the part that is imported, after the first pair"""
    end_s: float = math.inf
    every: int = 1
    """Each n-th pair is imported"""
    crop: Crop | None = None
    range_scale_m: float | None = None
    """Metres per unit of depth images; None: that of the format"""
    range_sigma_m: float | None = None
    """Their noise [m], and"""
    range_growth_per_m: float | None = None
    """what grows with the square of the depth [1/m]; None: that of the format's usual sensor"""

    @property
    def states_ranges(self) -> bool:
        """Whether the options say what the values of depth images mean."""
        return not (self.range_scale_m is self.range_sigma_m is self.range_growth_per_m is None)

    def range_model(self) -> RangeModel | None:
        """What the options alone say of depth images; None: nothing.

        Raises InputError for unit without noise, or noise without unit.
        """
        if not self.states_ranges:
            return None
        if self.range_scale_m is None or self.range_sigma_m is None:
            raise InputError(
                "--range-scale-m and --range-sigma-m: give both for depth images, the metres per unit (0.001 "
                "for millimetres) and the standard deviation of a pixel [m]"
            )
        return RangeModel(self.range_scale_m, self.range_sigma_m, self.range_growth_per_m or 0.0)


def parse_crop(text: str) -> Crop:
    """LEFT,TOP,WIDTH,HEIGHT [px]. Raises InputError."""
    try:
        left, top, width, height = (int(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--crop {text}: give LEFT,TOP,WIDTH,HEIGHT in whole pixels") from None
    if left < 0 or top < 0 or width < 1 or height < 1:
        raise InputError(f"--crop {text}: left and top must be at least 0, width and height at least 1")
    return Crop(left, top, width, height)
