"""Reading images from disk as 8-bit grey, and detecting damaged or empty ones.

Pillow, not OpenCV: a damaged file raises, where OpenCV's decoder also prints to standard error, and it
decodes outside the interpreter's lock.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from polhode.lie import Array
from polhode.records import Bools

Grey = NDArray[np.uint8]

BLOCK_PX = 4
CONTENT_LEVELS = 8.0
CONTENT_BLOCKS = 8
CONTENT_SPREAD_LEVELS = 24.0


class UnreadableImage(Exception):
    """The file is missing, damaged, or of the wrong size, as the message states."""


@contextmanager
def _opened(path: Path, width_px: int, height_px: int) -> Iterator[Image.Image]:
    """The image file, for decoding in the block. Raises UnreadableImage."""
    try:
        with Image.open(path) as image:
            if image.size != (width_px, height_px):
                wrong = f"{image.size[0]}x{image.size[1]} px instead of {width_px}x{height_px} px"
                raise UnreadableImage(f"wrong size, {wrong}")
            yield image
    except FileNotFoundError:
        raise UnreadableImage("file missing") from None
    except UnidentifiedImageError:
        raise UnreadableImage("not an image") from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError):
        # Pillow reports damage by any of these, after the chunk in which it finds it.
        raise UnreadableImage("damaged or truncated") from None


def read_raw(path: Path, width_px: int, height_px: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decode the whole image (H, W): 8-bit grey, or 16-bit grey as stored. Colour becomes grey.

    Raises UnreadableImage.
    """
    with _opened(path, width_px, height_px) as image:
        if image.mode.startswith("I"):
            return np.asarray(image).astype(np.uint16)
        return np.asarray(image.convert("L"), dtype=np.uint8)


def bit_depth(largest_value: int) -> int:
    """Depth of the sensor behind 16-bit files: the smallest common one that contains the largest value."""
    return next(bits for bits in (8, 10, 12, 14, 16) if largest_value < 2**bits)


def to_grey(raw: NDArray[np.uint8] | NDArray[np.uint16], bits: int) -> Grey:
    """Drop the bits of a 16-bit image that do not fit 8; ``bits`` is the same for a whole sequence."""
    if raw.dtype == np.uint8:
        return raw.astype(np.uint8, copy=False)
    return (raw >> max(bits - 8, 0)).astype(np.uint8)


def read_mask(path: Path, width_px: int, height_px: int) -> Bools:
    """A mask (H, W), true where the file is not zero. Raises UnreadableImage."""
    with _opened(path, width_px, height_px) as image:
        # The index of a palette is the label; converted to grey, labels could become black.
        pixels = np.asarray(image)
        if image.mode in ("RGBA", "LA"):
            pixels = pixels[..., :-1]
        mask = pixels.any(axis=-1) if pixels.ndim == 3 else pixels != 0
        return np.asarray(mask, dtype=np.bool_)


def has_content(grey: Grey) -> bool:
    """False for a frame that is black or uniform except for sensor noise and single hot pixels.

    Works on means of 4x4 blocks, where noise of a few levels is averaged out: content is a handful of
    blocks well above the median, or a wide spread over the image.
    """
    blocks = _block_means(grey)
    median = float(np.median(blocks))
    scatter = 1.4826 * float(np.median(np.abs(blocks - median)))
    bright = blocks > median + max(CONTENT_LEVELS, 5.0 * scatter)
    if int(bright.sum()) >= CONTENT_BLOCKS:
        return True
    low, high = np.percentile(blocks, [2.0, 98.0])
    return bool(high - low > CONTENT_SPREAD_LEVELS)


def _block_means(grey: Grey) -> Array:
    rows, columns = (max(size // BLOCK_PX, 1) for size in grey.shape)
    cut = grey[: rows * BLOCK_PX, : columns * BLOCK_PX].astype(np.float64)
    height, width = cut.shape
    return np.asarray(cut.reshape(rows, height // rows, columns, width // columns).mean(axis=(1, 3)))
