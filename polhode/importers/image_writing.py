"""Images of a recording into the dataset: as they are, or cropped; each is decoded at most once.

An image that is there already is not read again, so an interrupted import goes on where it stopped.
"""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from polhode.files.atomic import write_bytes, write_text
from polhode.files.images import Raw, UnreadableImage, decode_raw, decode_upright, read_header, read_mask
from polhode.importers.calibrations.rig import Rig
from polhode.importers.imported_dataset import ImportedDataset
from polhode.importers.options import Crop
from polhode.importers.pairs import ChosenPairs
from polhode.importers.sources.open_recording import Recording
from polhode.importers.sources.recording import DecodedImage, FramedImage, StoredImage
from polhode.records.dataset_writer import write_png
from polhode.records.mask_files import doubts_of_masks, find_masks, mask_file
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress


@dataclass
class WrittenImages:
    """What is in the dataset."""

    names: tuple[dict[int, str], dict[int, str]] = field(default_factory=lambda: ({}, {}))
    """Timestamp of the pair [ns] -> file, of each camera"""
    sizes: list[tuple[int, int] | None] = field(default_factory=lambda: [None, None])
    """Of the recorded images [px]; None: all of them were there already"""
    unreadable: list[str] = field(default_factory=list)
    """Images that are none, and why"""
    turned: int = 0
    """Number of images that were turned as their files say"""

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done to the images, for the user."""
        return (f"{self.turned} images were turned as their EXIF orientation says",) if self.turned else ()

    @property
    def stamps(self) -> list[int]:
        """Timestamps of the pairs of which both images are there."""
        return sorted(self.names[0].keys() & self.names[1].keys())


def write_images(
    recording: Recording,
    pairs: ChosenPairs,
    rig: Rig,
    crop: Crop | None,
    dataset: ImportedDataset,
    progress: Progress,
) -> WrittenImages:
    """Write the images of the pairs that are not there yet.

    Raises InputError for images of another size than the calibration's or than the one before.
    """
    written = WrittenImages()
    stamp_of: list[dict[int, int]] = []
    missing: list[frozenset[int]] = []
    for camera, indices in enumerate((pairs.left, pairs.right)):
        stamps = dict(zip(indices.tolist(), pairs.stamps_ns.tolist(), strict=True))
        there = dataset.images_there(camera)
        names = {stamp: there[str(stamp)] for stamp in stamps.values() if str(stamp) in there}
        written.names[camera].update(names)
        missing.append(frozenset(index for index, stamp in stamps.items() if stamp not in names))
        stamp_of.append(stamps)
        (dataset.folder(camera) / "data").mkdir(parents=True, exist_ok=True)
    total = len(missing[0]) + len(missing[1])
    there_already = 2 * len(pairs.stamps_ns) - total
    title = f"images ({there_already} were there)" if there_already else "images"
    waiting: deque[Future[None]] = deque()
    # Pillow compresses outside of the interpreter's lock
    with progress.stage(title, total) as advance, ThreadPoolExecutor(4) as pool:
        try:
            for framed in recording.images((missing[0], missing[1])):
                stamp = stamp_of[framed.camera][framed.index]
                try:
                    name, write = _prepared(framed, stamp, rig, crop, written)
                    place = dataset.folder(framed.camera) / "data" / name
                    waiting.append(pool.submit(write, place))
                    written.names[framed.camera][stamp] = name
                except UnreadableImage as error:
                    written.unreadable.append(f"{framed.name}: {error}")
                while len(waiting) > 16:
                    waiting.popleft().result()
                advance()
            while waiting:
                waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
    return written


def _prepared(
    framed: FramedImage, stamp: int, rig: Rig, crop: Crop | None, written: WrittenImages
) -> tuple[str, Callable[[Path], None]]:
    """Name of the file of an image, and what writes it. Raises UnreadableImage, and InputError for another
    size than the calibration's or than that of the images before."""
    image, camera = framed.image, framed.camera
    if isinstance(image, StoredImage):
        header = read_header(image.content)
        size = header.size_px
        if header.is_turned:
            image = DecodedImage(decode_upright(image.content, *size))
            written.turned += 1
    if isinstance(image, DecodedImage):
        size = (image.pixels.shape[1], image.pixels.shape[0])
    before = written.sizes[camera]
    if before is None:
        rig.cameras[camera].sized(size)
        written.sizes[camera] = size
    elif before != size:
        raise InputError(
            f"{framed.name}: {size[0]}x{size[1]} px, where the images before it have "
            f"{before[0]}x{before[1]}; import images of one size"
        )
    if isinstance(image, StoredImage) and crop is None:
        return f"{stamp}{image.suffix}", partial(write_bytes, content=image.content)
    pixels = decode_raw(image.content, *size) if isinstance(image, StoredImage) else image.pixels
    return f"{stamp}.png", partial(_write_png, pixels=_part(pixels, crop))


def _part(pixels: NDArray[Any], crop: Crop | None) -> NDArray[Any]:
    if crop is None:
        return pixels
    crop.require_inside((pixels.shape[1], pixels.shape[0]))
    return pixels[crop.top : crop.top + crop.height, crop.left : crop.left + crop.width]


def _write_png(path: Path, pixels: Raw) -> None:
    stream = BytesIO()
    Image.fromarray(np.ascontiguousarray(pixels)).save(stream, format="PNG")
    write_bytes(path, stream.getvalue())


def first_size(recording: Recording) -> tuple[int, int]:
    """Width and height of the first left image [px]. Raises InputError: it cannot be read."""
    image = next(recording.images((frozenset({0}), frozenset()))).image
    if isinstance(image, DecodedImage):
        return image.pixels.shape[1], image.pixels.shape[0]
    try:
        return read_header(image.content).size_px
    except UnreadableImage as error:
        raise InputError(f"{recording.name}: the first image cannot be read: {error}") from None


def write_listings(dataset: ImportedDataset, written: WrittenImages) -> None:
    """Write ``data.csv`` of both cameras, and remove images whose partner could not be read."""
    stamps = written.stamps
    for camera, names in enumerate(written.names):
        folder = dataset.folder(camera)
        for stamp in names.keys() - set(stamps):
            (folder / "data" / names[stamp]).unlink()
        lines = ["#timestamp [ns],filename", *(f"{stamp},{names[stamp]}" for stamp in stamps)]
        write_text(folder / "data.csv", "\n".join(lines) + "\n")


def copy_masks(
    folders: tuple[Path | None, Path | None],
    images: tuple[Mapping[int, str], Mapping[int, str]],
    own_ns: tuple[Mapping[int, int], Mapping[int, int]],
    rig: Rig,
    crop: Crop | None,
    mav0: Path,
) -> tuple[str, ...]:
    """Copy or crop the masks of the pairs; warnings about them.

    images: timestamp of an image [ns] -> its file, of each camera; own_ns: timestamp of a pair -> that of its
    image. Raises InputError for masks that cannot be read, and for those none of which belongs to an image.
    """
    warnings: list[str] = []
    for camera, folder in enumerate(folders):
        if folder is None:
            continue
        masks = find_masks(folder, images[camera], own_ns[camera])
        size = rig.cameras[camera].size_px
        assert size is not None
        warnings += [f"{folder}: masks {words}" for words in doubts_of_masks(masks, size)] if masks else []
        for stamp, own in own_ns[camera].items():
            source = mask_file(masks, (own, stamp), Path(images[camera].get(own, "")))
            if source is None:
                continue
            try:
                mask = read_mask(source, *size)
            except UnreadableImage as error:
                raise InputError(f"{source}: {error}; repair it, or remove the folder of masks") from None
            write_png(mav0 / f"masks{camera}" / f"{stamp}.png", _part(mask, crop))
    return tuple(warnings)
