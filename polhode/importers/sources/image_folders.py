"""Two folders of images, the left camera's and the right one's, or a camera's and its depth images.

Times come from a table (--stamps), from the names of the files, from a table that lies beside them as KITTI
and EuRoC have it, or from the numbers in their names and a rate (--rate-hz). Images are copied as they are.
"""

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.files.foreign_files import MIB, read_bytes
from polhode.files.images import SUFFIXES
from polhode.importers.options import ImportOptions
from polhode.importers.sources.recording import Contents, FramedImage, StoredImage, Wanted
from polhode.importers.times import (
    RATE_AGREES,
    Times,
    numbers_of_names,
    read_times,
    require_increasing,
    times_of_names,
)
from polhode.runtime.errors import InputError

IMAGE_BYTES = 528 * MIB
"""Of an image of 64 million pixels, as polhode.files.images allows."""
TABLES = ("timestamps.txt", "times.txt", "data.csv")
"""Of times, in the folder of the images or the one above: KITTI's, and EuRoC's"""


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
    given = options.stamps
    tables = given * (2 // len(given)) if given else (None, None)
    files, found = [], []
    for folder, table in zip((left, right), tables, strict=True):
        names = _images_in(folder)
        times = _times(folder, names, table, options)
        order = np.argsort(times.stamps_ns, kind="stable")
        files.append(tuple(names[k] for k in order))
        found.append(Times(times.stamps_ns[order], times.origin))
        require_increasing(folder, found[-1].stamps_ns)
    origins = [times.origin.partition(",")[0].partition(" (")[0] for times in found]
    if origins[0] != origins[1]:
        raise InputError(
            f"{left} has times in {origins[0]}, {right} in {origins[1]}: give --stamps, a table for each"
        )
    stamps = found[0].stamps_ns, found[1].stamps_ns
    contents = Contents(stamps, None, ranges=options.range_model(), times=found[0].origin)
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


def _times(folder: Path, files: list[Path], table: Path | None, options: ImportOptions) -> Times:
    """Times of images (n,): from a table, from their names, from a table beside them, or from the numbers in
    their names and a rate.
    """
    names, unit, rate_hz = [path.stem for path in files], options.time_unit, options.rate_hz
    listed = [path.name for path in files]
    if table is not None:
        times = read_times(table, unit, rate_hz, listed)
        if len(times.stamps_ns) != len(files):
            raise InputError(
                f"{table}: {len(times.stamps_ns)} timestamps for the {len(files)} images of {folder}; give "
                "one row an image, in the natural order of their names"
            )
        _require_as_named(folder, names, times, table)
        return times
    if (named := times_of_names(folder, names, unit, rate_hz)) is not None:
        return named
    whole = folder.resolve()
    for place in (above / name for above in (whole, whole.parent) for name in TABLES):
        # a table of more images is not that of these
        if place.is_file() and len((times := read_times(place, unit, rate_hz, listed)).stamps_ns) == len(
            files
        ):
            return Times(times.stamps_ns, f"{times.origin}, of {place.name} beside them")
    if rate_hz is None:
        raise InputError(
            f"{folder}: the name {files[0].name} states no time; give --rate-hz for numbered images, "
            "--stamps FILE for a table, or --time-unit if the numbers are times"
        )
    numbers = numbers_of_names(names)
    if numbers is None:
        raise InputError(
            f"{folder}: names such as {files[0].name} have no number of the image; give --stamps FILE "
            "instead of --rate-hz"
        )
    stamps_ns = np.array([round(number * 1e9 / rate_hz) for number in numbers], dtype=np.int64)
    return Times(stamps_ns, "numbers in the names and --rate-hz")


def _require_as_named(folder: Path, names: list[str], times: Times, table: Path) -> None:
    """Raise InputError for times of a table whose intervals are not those that the names state."""
    named = None
    with suppress(InputError):
        named = times_of_names(folder, names)
    if named is None or len(names) < 2:
        return
    in_table, in_names = (
        float(np.median(np.diff(np.sort(each)))) for each in (times.stamps_ns, named.stamps_ns)
    )
    if in_names and not 1.0 / RATE_AGREES < in_table / in_names < RATE_AGREES:
        raise InputError(
            f"{table}: images {1e-9 * in_table:.4g} s apart (times in {times.origin}), but the names of "
            f"{folder} say {1e-9 * in_names:.4g} s ({named.origin}); state the unit of the table with "
            "--time-unit, or correct it"
        )
