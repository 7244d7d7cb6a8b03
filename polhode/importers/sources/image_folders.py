"""Two folders of images, the left camera's and the right one's, or a camera's and its depth images.

Times come from the names of the files (nanoseconds, microseconds, milliseconds, or seconds with a point,
since 1970), from a table (--stamps), or from the number at the end of each name and a rate (--rate-hz).
Images are copied as they are.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.files.foreign_files import MIB, read_bytes
from polhode.geometry.lie import Ints
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents, FramedImage, StoredImage, Wanted
from polhode.importers.sources.stamp_files import read_stamps, require_increasing, stamp_of_name
from polhode.runtime.errors import InputError

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
IMAGE_BYTES = 528 * MIB
"""Of an image of 64 million pixels, as polhode.files.images allows."""


@dataclass(frozen=True)
class ImageFiles:
    """Images in files, of both cameras."""

    name: str
    files: tuple[tuple[Path, ...], tuple[Path, ...]]
    """In order of time"""
    contents: Contents

    def images(self, wanted: Wanted) -> Iterator[FramedImage]:
        """The files, pair by pair."""
        todo = [(index, camera) for camera in (0, 1) for index in wanted[camera]]
        for index, camera in sorted(todo):
            path = self.files[camera][index]
            content = read_bytes(path, IMAGE_BYTES, "an image")
            yield FramedImage(camera, index, StoredImage(content, path.suffix.lower()), str(path))


def open_folders(left: Path, right: Path, options: ImportOptions) -> ImageFiles:
    """The images of two folders; the second one's are depth if the options state its unit.

    Raises InputError for folders without images, and images without times.
    """
    if left.resolve() == right.resolve():
        raise InputError(
            f"{left} and {right} are the same folder: give those of the left and the right camera"
        )
    tables = options.stamps * (2 // len(options.stamps)) if options.stamps else (None, None)
    files, stamps = [], []
    for folder, table in zip((left, right), tables, strict=True):
        names = _images_in(folder)
        times = _times(folder, names, table, options.rate_hz)
        order = np.argsort(times, kind="stable")
        files.append(tuple(names[k] for k in order))
        stamps.append(times[order])
        require_increasing(folder, times[order])
    contents = Contents((stamps[0], stamps[1]), None, ranges=options.range_model())
    return ImageFiles(f"{left} and {right}", (files[0], files[1]), contents)


def natural_key(name: str) -> list[tuple[int, str]]:
    """A key by which img2 comes before img10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part]


def _images_in(folder: Path) -> list[Path]:
    """Image files, in natural order of their names."""
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder: give a folder of images for each camera")
    found = [
        path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    ]
    if not found:
        raise InputError(f"{folder} holds no images ({', '.join(SUFFIXES)}): give the folder that does")
    return sorted(found, key=lambda path: natural_key(path.name))


def _times(folder: Path, files: list[Path], table: Path | None, rate_hz: float | None) -> Ints:
    """(n,) times of images [ns]: from a table, from the numbers in their names and a rate, or their names."""
    if table is not None:
        stamps = read_stamps(table)
        if len(stamps) != len(files):
            raise InputError(
                f"{table}: {len(stamps)} timestamps for the {len(files)} images of {folder}; give one row an "
                "image, in the natural order of their names"
            )
        return stamps
    times: list[int] = []
    for path in files:
        if rate_hz is None:
            time = stamp_of_name(path.stem)
            wrong, advice = "is no time", "give --rate-hz for numbered images, or --stamps FILE"
        else:
            digits = re.findall(r"\d+", path.stem)
            is_number = bool(digits) and len(digits[-1]) <= 9
            time = round(int(digits[-1]) * 1e9 / rate_hz) if is_number else None
            wrong, advice = "ends in no number", "give --stamps FILE instead of --rate-hz"
        if time is None:
            raise InputError(f"{folder}: the name {path.name} {wrong}; {advice}")
        times.append(time)
    return np.array(times, dtype=np.int64)
