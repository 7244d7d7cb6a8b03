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
    files = (_images_in(left), _images_in(right))
    if options.stamps:
        both = options.stamps if len(options.stamps) == 2 else options.stamps * 2
        stamps = tuple(
            _from_table(folder, names, table)
            for folder, names, table in zip((left, right), files, both, strict=True)
        )
    else:
        stamps = tuple(
            _from_names(folder, names, options.rate_hz)
            for folder, names in zip((left, right), files, strict=True)
        )
    sorted_files, sorted_ns = [], []
    for folder, names, times in zip((left, right), files, stamps, strict=True):
        order = np.argsort(times, kind="stable")
        sorted_files.append(tuple(names[k] for k in order))
        sorted_ns.append(times[order])
        require_increasing(folder, times[order])
    return ImageFiles(
        f"{left} and {right}",
        (sorted_files[0], sorted_files[1]),
        Contents((sorted_ns[0], sorted_ns[1]), None, ranges=options.range_model()),
    )


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


def _from_table(folder: Path, files: list[Path], table: Path) -> Ints:
    stamps = read_stamps(table)
    if len(stamps) != len(files):
        raise InputError(
            f"{table}: {len(stamps)} timestamps for the {len(files)} images of {folder}; give one row an "
            "image, in the natural order of their names"
        )
    return stamps


def _from_names(folder: Path, files: list[Path], rate_hz: float | None) -> Ints:
    if rate_hz is None:
        times = [stamp_of_name(path.stem) for path in files]
        if None in times:
            wrong = files[times.index(None)].name
            raise InputError(
                f"{folder}: the name {wrong} is no time; give --rate-hz for numbered images, or --stamps FILE"
            )
        return np.array(times, dtype=np.int64)
    numbers = [re.findall(r"\d+", path.stem) for path in files]
    if any(not found or len(found[-1]) > 9 for found in numbers):
        wrong = next(
            path.name for path, found in zip(files, numbers, strict=True) if not found or len(found[-1]) > 9
        )
        raise InputError(
            f"{folder}: the name {wrong} ends in no number; give --stamps FILE instead of --rate-hz"
        )
    last = np.array([int(found[-1]) for found in numbers], dtype=np.int64)
    return np.array([round(int(number) * 1e9 / rate_hz) for number in last], dtype=np.int64)
