"""Images of the board: pairs from two sets of files, or from a recording that ``polhode import`` reads."""

import glob
import logging
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.files.foreign_files import read_bytes
from polhode.files.images import (
    SUFFIXES,
    Grey,
    Raw,
    UnreadableImage,
    bit_depth,
    decode_upright,
    read_header,
    to_grey,
)
from polhode.importers.options import ImportOptions
from polhode.importers.sources.image_folders import IMAGE_BYTES, natural_key
from polhode.importers.sources.open_recording import Recording, opened_recording
from polhode.importers.sources.recording import DecodedImage
from polhode.records.pairing import pair_by_time
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress

_log = logging.getLogger(__name__)
SIDES = ("left", "right")
MAX_PAIRS = 200
"""Of a recording, spread over it."""
Names = tuple[tuple[str | None, ...], tuple[str | None, ...]]
"""(K,) of the left and the right images, for messages; None: there is none"""


@dataclass(frozen=True)
class BoardImage:
    """One image."""

    camera: int
    """0 left, 1 right"""
    pair: int
    pixels: Grey | None
    """(H, W); None: it cannot be read"""
    fault: str = ""


@dataclass(frozen=True)
class ImagePairs:
    """Pairs of images of a board."""

    names: Names
    images: Callable[[], Iterator[BoardImage]]
    """All images that there are, each once"""
    is_dense: bool = False
    """Whether images follow each other so closely that they show the board at the same place"""


def _read(content: bytes) -> Grey:
    return _grey(decode_upright(content, *read_header(content).size_px))


def _grey(raw: Raw) -> Grey:
    return np.ascontiguousarray(to_grey(raw, bit_depth(int(raw.max()))))


def pairs_of_files(left: Sequence[str], right: Sequence[str]) -> ImagePairs:
    """Pairs of the files that two lists of patterns, files or folders name, in natural order.

    Files whose names have numbers in common are paired by the last number in the name. Raises InputError: no
    images, one camera alone, the same files twice, different numbers of files that cannot be paired.
    """
    for words, other, side in ((left, right, "left"), (right, left, "right")):
        if not words:
            given = "no images were" if not other else "only one camera's images were"
            raise InputError(f"{given} given: a stereo rig needs --left and --right; --{side} is missing")
    files = (_files(left, "left"), _files(right, "right"))
    if set(files[0]) & set(files[1]):
        both = min(set(files[0]) & set(files[1]))
        raise InputError(f"{both} is an image of --left and of --right: give each camera its own images")
    sides = _by_number(files) or (tuple(files[0]), tuple(files[1]))
    if len(sides[0]) != len(sides[1]):
        raise InputError(
            f"{len(files[0])} left and {len(files[1])} right images, whose names have no numbers in common: "
            "name the images of a pair alike"
        )
    first, second = (tuple(None if path is None else str(path) for path in side) for side in sides)

    def images() -> Iterator[BoardImage]:
        for pair, paths in enumerate(zip(first, second, strict=True)):
            for camera, path in enumerate(paths):
                if path is None:
                    continue
                try:
                    yield BoardImage(camera, pair, _read(read_bytes(Path(path), IMAGE_BYTES, "an image")))
                except (UnreadableImage, InputError) as error:
                    yield BoardImage(camera, pair, None, str(error).removeprefix(f"{path} "))

    return ImagePairs((first, second), images)


def _files(words: Sequence[str], side: str) -> list[Path]:
    """The images that patterns, files and folders name, in natural order."""
    found: set[Path] = set()
    for word in words:
        path = Path(word)
        if path.is_dir():
            names = [each for each in path.iterdir() if each.is_file() and not each.name.startswith(".")]
        else:
            # a pattern may be absolute, which Path.glob refuses
            matches = glob.glob(word, recursive=True)  # noqa: PTH207
            names = [path] if path.is_file() else [Path(each) for each in matches]
        images = [each for each in names if each.suffix.lower() in SUFFIXES and each.is_file()]
        if not images:
            raise InputError(
                f"--{side} {word}: no images there ({', '.join(SUFFIXES)}); give a folder or a pattern"
            )
        found.update(images)
    return sorted(found, key=lambda path: [natural_key(part) for part in path.parts])


def _by_number(
    files: tuple[list[Path], list[Path]],
) -> tuple[tuple[Path | None, ...], tuple[Path | None, ...]] | None:
    """Pairs of files with the same last number; None: the numbers do not say which belong together."""
    digits = [[re.findall(r"\d+", path.stem) for path in side] for side in files]
    if not all(map(all, digits)):
        return None
    left, right = (
        {int(found[-1]): path for found, path in zip(own, side, strict=True)}
        for own, side in zip(digits, files, strict=True)
    )
    is_unique = (len(left), len(right)) == tuple(map(len, files))
    if not is_unique or len(left.keys() & right.keys()) < 0.5 * min(len(left), len(right)):
        return None
    every = sorted(left.keys() | right.keys())
    return tuple(left.get(k) for k in every), tuple(right.get(k) for k in every)


@contextmanager
def opened_pairs(
    sources: Sequence[Path],
    left: Sequence[str],
    right: Sequence[str],
    options: ImportOptions,
    progress: Progress,
) -> Iterator[ImagePairs]:
    """The pairs of two sets of files, or of the recording ``sources``. Raises InputError."""
    if left or right:
        if sources:
            raise InputError(f"{sources[0]}: give a recording, or --left and --right, not both")
        yield pairs_of_files(left, right)
        return
    if len(sources) == 2 and all(path.is_dir() for path in sources):
        yield pairs_of_files([str(sources[0])], [str(sources[1])])
        return
    if not sources:
        raise InputError("images of a board are missing: give --left and --right, or a recording")
    with opened_recording(sources, options, progress) as recording:
        yield _pairs_of_recording(recording, options)


def _pairs_of_recording(recording: Recording, options: ImportOptions) -> ImagePairs:
    """Some pairs of a recording, which are named by the number of the frame."""
    left_ns, right_ns = recording.contents.stamps_ns
    for line in recording.contents.warnings:
        _log.warning(line)
    tolerance_ns = None if options.tolerance_s is None else round(1e9 * options.tolerance_s)
    offset_ns = None if options.offset_s is None else round(1e9 * options.offset_s)
    pairing = pair_by_time(left_ns, right_ns, tolerance_ns, offset_ns)
    if not len(pairing.left):
        raise InputError(f"{recording.name}: no left image has a right one at its time; give --tolerance-s")
    since_s = 1e-9 * (left_ns[pairing.left] - left_ns[pairing.left[0]])
    chosen = np.flatnonzero((since_s >= options.start_s) & (since_s <= options.end_s))[:: options.every]
    if len(chosen) > MAX_PAIRS:
        chosen = chosen[np.unique(np.linspace(0, len(chosen) - 1, MAX_PAIRS).astype(int))]
    left, right = (side[chosen].tolist() for side in (pairing.left, pairing.right))

    def images() -> Iterator[BoardImage]:
        pair_of = [{index: k for k, index in enumerate(side)} for side in (left, right)]
        for each in recording.images((frozenset(left), frozenset(right))):
            pair, image = pair_of[each.camera][each.index], each.image
            try:
                pixels = _grey(image.pixels) if isinstance(image, DecodedImage) else _read(image.content)
                yield BoardImage(each.camera, pair, pixels)
            except UnreadableImage as error:
                yield BoardImage(each.camera, pair, None, str(error))

    names = (tuple(f"left image {k}" for k in left), tuple(f"right image {k}" for k in right))
    return ImagePairs(names, images, is_dense=True)
