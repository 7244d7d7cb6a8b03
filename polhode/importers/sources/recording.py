"""What every kind of recording holds: timestamps and calibration, and images."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from polhode.files.images import Raw
from polhode.geometry.lie import Array, Ints
from polhode.importers.calibrations.rig import Rig
from polhode.records.range_images import RangeModel

Wanted = tuple[frozenset[int], frozenset[int]]
"""Indices of the images that are wanted, of the left and the right camera."""


@dataclass(frozen=True)
class StoredImage:
    """An image as a file has it, to be copied as it is."""

    content: bytes
    suffix: str
    """.png, .jpg, ..."""


@dataclass(frozen=True)
class DecodedImage:
    """Pixels, (H, W) 8 or 16 bits grey."""

    pixels: Raw


@dataclass(frozen=True)
class FramedImage:
    """One image of a recording."""

    camera: int
    """0 left, 1 right"""
    index: int
    """Into the camera's timestamps"""
    image: StoredImage | DecodedImage
    name: str
    """For messages"""


@dataclass(frozen=True)
class Poses:
    """Poses of the inspector's body B in N, M of them."""

    timestamps_ns: Ints
    """(M,) strictly increasing"""
    X_NB: Array
    """(M, 4, 4)"""
    sigma_p_m: float = 0.0
    sigma_theta_rad: float = 0.0
    X_BC0: Array | None = None
    """(4, 4) left camera in B; None: B is the body that the calibration refers to"""


@dataclass(frozen=True)
class Contents:
    """What a recording holds besides its images."""

    stamps_ns: tuple[Ints, Ints]
    """(L,), (R,) of the left and the right images, each strictly increasing"""
    rig: Rig | None
    """Its own calibration; None: it has none"""
    poses: Poses | None = None
    bits: int | None = None
    """Depth of 16-bit images, if known"""
    tables: Mapping[str, Path] = field(default_factory=dict)
    """Files of a dataset that are copied as they are, by their name below mav0"""
    masks: tuple[Path | None, Path | None] = (None, None)
    """Folders of masks"""
    files: tuple[Mapping[int, str], Mapping[int, str]] = field(default_factory=lambda: ({}, {}))
    """Where there are masks: timestamp of each image [ns] -> its file"""
    ranges: RangeModel | None = None
    """The right images are ranges of the left ones' pixels; None: they are a second camera's"""
    calibration: tuple[Path, ...] = ()
    """Files of a calibration that lie beside the images"""
    left_out: int = 0
    """Images of other parts of a recording whose clock was set back"""
    times: str = "nanoseconds, as the format has them"
    """What the times were written in, and how that is known"""
    notes: tuple[str, ...] = ()
    """What was chosen among several things, for the user"""
    warnings: tuple[str, ...] = ()
