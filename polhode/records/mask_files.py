"""Which file is the mask of which image, and what is odd about the masks of a camera.

A mask is called by the timestamp of its image, or as the image's file; ``masks0/data/`` is looked at as well.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from polhode.files.images import FORMATS, SUFFIXES, UnreadableImage, read_mask
from polhode.geometry.lie import Bools
from polhode.runtime.errors import InputError

SAMPLE = 8
"""Masks of a camera whose values are looked at"""
INVERTED_BORDER = 0.95
"""Share of the border of an image that an inverted mask covers, at least"""
MANY_LABELS = 16
"""More values than masks of parts have are soft outlines"""


def stem_of(name: str) -> str:
    """The name of an image without its suffixes: ``1.png.png`` is 1."""
    path = Path(name)
    while path.suffix.lower() in SUFFIXES:
        path = path.with_suffix("")
    return path.name


def find_masks(folder: Path, images: Mapping[int, str], others: Iterable[int] = ()) -> dict[str, Path]:
    """The masks in a folder by their names without suffix; empty: there is no such folder.

    images: timestamp [ns] -> file name, of the camera; others: timestamps that masks may have as well. Raises
    InputError where files are there and none belongs to an image.
    """
    if not folder.is_dir():
        return {}
    files = _images_in(folder) or (_images_in(folder / "data") if (folder / "data").is_dir() else [])
    if not files and any(not path.name.startswith(".") for path in folder.iterdir()):
        raise InputError(
            f"{folder}: no masks in it ({', '.join(SUFFIXES)}, here or in data/); put them there, or "
            "remove the folder"
        )
    found = {stem_of(path.name): path for path in files}
    if len(unused_masks(found, images, others)) == len(files) > 0:
        first, image = files[0].name, next(iter(images.values()))
        raise InputError(
            f"{folder}: none of its {len(files)} masks belongs to an image: masks are called {first}, images "
            f"{image} at {next(iter(images))} ns; name each mask by the timestamp of its image, or as its "
            "file"
        )
    return found


def unused_masks(
    found: Mapping[str, Path], images: Mapping[int, str], others: Iterable[int] = ()
) -> list[str]:
    """Names of masks that belong to no image."""
    known = {*map(str, images), *map(stem_of, images.values()), *map(str, others)}
    return [path.name for stem, path in sorted(found.items()) if stem not in known]


def mask_file(masks: Mapping[str, Path], stamps_ns: Sequence[int], image: Path) -> Path | None:
    """The mask of an image by its timestamps or its name; None: it has none."""
    names = (*map(str, stamps_ns), stem_of(image.name))
    return next((masks[name] for name in names if name in masks), None)


def doubts_of_masks(found: Mapping[str, Path], size_px: tuple[int, int]) -> list[str]:
    """What is odd about the values of masks, by some of them: a third value; masks that look inverted."""
    paths = sorted(found.values())
    chosen = [paths[k] for k in np.unique(np.linspace(0, len(paths) - 1, SAMPLE).round().astype(int))]
    values: set[int] = set()
    inverted, whole, empty = 0, 0, 0
    for path in chosen:
        try:
            mask = read_mask(path, *size_px)
            with Image.open(path, formats=FORMATS) as image:
                if image.format != "JPEG" and image.mode in ("L", "P", "I;16", "I"):
                    found_values = {*np.unique(np.asarray(image)).tolist()}
                    values |= found_values if len(found_values) > 2 else set()
        except (UnreadableImage, OSError, ValueError):
            # it is counted by those who read all masks
            continue
        inverted += is_inverted(mask)
        whole += bool(mask.all())
        empty += not mask.any()
    doubts = []
    if 2 < len(values) <= MANY_LABELS:
        shown = ", ".join(map(str, sorted(values)))
        doubts.append(f"have the values {shown}: all but 0 count as target, set what is void or unknown to 0")
    if chosen and whole > 0.5 * len(chosen):
        doubts.append("cover whole images: all but 0 counts as target, so the background must be 0")
    if chosen and empty > 0.5 * len(chosen):
        doubts.append("are empty: all is 0, and the target must be other than 0")
    if chosen and inverted > 0.5 * len(chosen):
        doubts.append(
            "cover the border of the images and leave their middle out: they look inverted, the target must "
            "be other than 0"
        )
    return doubts


def other_mask_folders(mav0: Path) -> list[str]:
    """Folders that look like those of masks and are none, relative to the sequence."""
    root = mav0.parent
    found = [*root.glob("*mask*"), *mav0.glob("*mask*"), *mav0.glob("cam?/*mask*")]
    known = {mav0 / "masks0", mav0 / "masks1"}
    return sorted(path.relative_to(root).as_posix() for path in {*found} - known if path.is_dir())


def is_inverted(mask: Bools) -> bool:
    """Whether a mask (H, W) covers the border and leaves out something in the middle."""
    border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
    return bool(border.mean() > INVERTED_BORDER and not mask.all())


def _images_in(folder: Path) -> list[Path]:
    return sorted(
        path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    )
