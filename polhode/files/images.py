"""Reading images from disk as 8-bit grey, and detecting damaged or empty ones.

Pillow, not OpenCV: a damaged file raises, where OpenCV's decoder also prints to standard error, and it
decodes outside the interpreter's lock. Only the formats that stereo cameras record are tried; size, kind of
pixels and decoder are known from the header, and what does not fit is refused before anything is decoded.
"""

import ctypes
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, UnidentifiedImageError

from polhode.files.foreign_files import MIB, MissingFile, open_regular
from polhode.geometry.lie import Bools
from polhode.runtime.errors import InputError

Grey = NDArray[np.uint8]
Raw = NDArray[np.uint8] | NDArray[np.uint16]

FORMATS = ("PNG", "TIFF", "JPEG", "BMP", "PPM")
"""As Pillow calls them; PPM includes PGM and PBM."""
SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm")
"""Of their files"""
MAX_PIXELS = 64_000_000
"""Of one image; the largest sensors of machine vision with a global shutter have some 25 million."""
ORIENTATION = 0x0112
"""Tag of EXIF: how an image is to be turned for showing it"""
GREY_OR_COLOUR = ("1", "L", "LA", "La", "P", "PA", "RGB", "RGBA", "RGBa", "RGBX")
"""Modes of 8 bits or fewer; transparency is ignored."""


# Let libtiff print nothing: what it says of damage, Pillow raises as well. Only wheels of Pillow are looked
# at, whose library nothing else uses.
for _library in Path(Image.__file__).parent.with_name("pillow.libs").glob("libtiff-*.so*"):
    with suppress(OSError, AttributeError):
        _libtiff = ctypes.CDLL(str(_library))
        for _name in ("TIFFSetErrorHandler", "TIFFSetWarningHandler"):
            getattr(_libtiff, _name).argtypes = [ctypes.c_void_p]
            getattr(_libtiff, _name)(None)
# What Pillow warns of (a large header, odd metadata) is either refused here or without effect on the pixels.
warnings.filterwarnings("ignore", module=r"PIL\.")


class UnreadableImage(Exception):
    """The file is missing, damaged, of the wrong size or an unsuitable kind, as the message states."""


def parallel_decodes(width_px: int, height_px: int) -> int:
    """How many images of this size may be decoded at once, so that memory stays below 1 GiB; at least 1."""
    # Pillow keeps up to 64 MiB of texts of a hostile PNG, and 4 bytes per pixel beside the array.
    return max(1, 768 * MIB // (64 * MIB + 12 * width_px * height_px))


@contextmanager
def _errors_named() -> Iterator[None]:
    """Errors of opening and decoding are UnreadableImage, with the reason."""
    try:
        yield
    except UnreadableImage:
        raise
    except UnidentifiedImageError:
        raise UnreadableImage("not an image in PNG, TIFF, JPEG, BMP or PGM") from None
    except Exception as error:
        # Pillow reports damage by errors of any type.
        raise UnreadableImage("damaged or truncated") from error


@contextmanager
def _opened(path: Path, width_px: int, height_px: int) -> Iterator[ImageFile.ImageFile]:
    """The image file, for decoding its first frame in the block. Raises UnreadableImage."""
    limit_bytes = 8 * width_px * height_px + 16 * MIB
    try:
        stream = open_regular(path, limit_bytes, f"an image of {width_px}x{height_px} px")
    except MissingFile:
        raise UnreadableImage("file missing") from None
    except InputError as error:
        raise UnreadableImage(str(error).removeprefix(f"{path} ")) from None
    with stream, _decodable(stream, width_px, height_px) as image:
        yield image


@contextmanager
def _decodable(stream: BinaryIO, width_px: int, height_px: int) -> Iterator[ImageFile.ImageFile]:
    """The same for an opened file."""
    with _errors_named(), Image.open(stream, formats=FORMATS) as image:
        if image.size != (width_px, height_px):
            wrong = f"{image.size[0]}x{image.size[1]} px instead of {width_px}x{height_px} px"
            raise UnreadableImage(f"wrong size, {wrong}")
        assert isinstance(image, ImageFile.ImageFile)
        if image.format == "JPEG":
            # Within compressed data no byte 0xff is followed by 0xda.
            position = stream.tell()
            stream.seek(0)
            scans = stream.read().count(b"\xff\xda")
            stream.seek(position)
            # Of a progressive JPEG; usual ones have ten, and each costs a pass over the whole image.
            if scans > 100:
                raise UnreadableImage(f"a JPEG of {scans} scans, where {100} are allowed; save it again")
        _require_known_pixels(image)
        yield image


def _require_known_pixels(image: ImageFile.ImageFile) -> None:
    """Set up the decoder so that values come as stored. Raises UnreadableImage for unsuitable pixels."""
    for index, tile in enumerate(image.tile):
        if tile.codec_name == "ppm" and image.mode == "I":
            # Pillow would scale 12-bit values to 16 bits, a pixel at a time.
            image.tile[index] = tile._replace(codec_name="raw", args=("I;16B", 0, 1))
        elif tile.codec_name == "ppm":
            raise UnreadableImage(
                "a largest value other than 255 and 65535, or colours of 16 bits; save it as PNG"
            )
        elif tile.codec_name not in ("raw", "zip", "jpeg", "libtiff"):
            # Not in C: those for plain text and run lengths take seconds for an image.
            raise UnreadableImage("pixels as plain text or run lengths; save it as PNG")
        words = (tile.args,) if isinstance(tile.args, str) else tile.args or ()
        deep = any(isinstance(word, str) and ";16" in word for word in words)
        if deep and not image.mode.startswith("I"):
            raise UnreadableImage("colours of 16 bits; save it as 16-bit grey or 8-bit colour")
    if image.mode == "F":
        raise UnreadableImage("floating-point values, whose scale is unknown; save it with 8 or 16 bits")
    if image.mode not in GREY_OR_COLOUR and not image.mode.startswith("I"):
        raise UnreadableImage(f"colours of the kind {image.mode}; save it as grey or RGB")
    if image.format == "TIFF":
        # Pillow ignores what two tags say of the values.
        tags = getattr(image, "tag_v2", {})
        if tags.get(262) == 0 and image.mode.startswith("I"):
            raise UnreadableImage("16-bit grey where zero is white; save it with zero as black")
        if 2 in tuple(tags.get(339, ())) and image.mode == "L":
            raise UnreadableImage("signed 8-bit values; save it with unsigned ones")


def read_raw(path: Path, width_px: int, height_px: int) -> Raw:
    """Decode the whole image (H, W): 8-bit grey, or 16-bit grey as stored. Colour becomes grey.

    Raises UnreadableImage.
    """
    with _opened(path, width_px, height_px) as image:
        return _raw_of(image)


def decode_raw(content: bytes, width_px: int, height_px: int) -> Raw:
    """The same for the content of a file."""
    with _decodable(BytesIO(content), width_px, height_px) as image:
        return _raw_of(image)


@dataclass(frozen=True)
class ImageHeader:
    """What the header of an image file says."""

    size_px: tuple[int, int]
    """Width and height as stored"""
    is_turned: bool
    """Whether its EXIF orientation is another than that of the pixels, which ``read_raw`` does not look at"""


def read_header(content: bytes) -> ImageHeader:
    """The header of an image file's content. Raises UnreadableImage, also for pixels that are not read."""
    with _errors_named(), Image.open(BytesIO(content), formats=FORMATS) as image:
        assert isinstance(image, ImageFile.ImageFile)
        _require_known_pixels(image)
        # Pillow itself turns TIFF
        is_turned = image.format != "TIFF" and image.getexif().get(ORIENTATION, 1) in range(2, 9)
        return ImageHeader(image.size, is_turned)


def decode_upright(content: bytes, width_px: int, height_px: int) -> Raw:
    """As ``decode_raw``, turned as the EXIF orientation says; width and height as stored."""
    with _decodable(BytesIO(content), width_px, height_px) as image:
        orientation = image.getexif().get(ORIENTATION, 1)
        raw = _raw_of(image)
    turned: Raw = raw.T if orientation in (5, 6, 7, 8) else raw
    rows, columns = (
        slice(None, None, -1 if orientation in back else 1) for back in ((3, 4, 7, 8), (2, 3, 6, 7))
    )
    upright: Raw = turned[rows, columns].copy()
    return upright


def _raw_of(image: ImageFile.ImageFile) -> Raw:
    deep = image.mode.startswith("I")
    shape = (image.size[1], image.size[0])
    raw: Raw = np.empty(shape, np.uint16) if deep else np.empty(shape, np.uint8)
    for rows, part in _strips(image):
        if deep:
            values = np.asarray(part)
            if values.min() < 0 or values.max() >= 2**16:
                what = "negative values" if values.min() < 0 else "values of more than 16 bits"
                raise UnreadableImage(f"{what}; save it with 8 or 16 bits")
            raw[rows] = values
        else:
            raw[rows] = np.asarray(part.convert("L"))
    return raw


def _strips(image: Image.Image) -> Iterator[tuple[slice, Image.Image]]:
    """The decoded image by groups of rows, so that copies stay small."""
    image.load()
    width, height = image.size
    step = max(1, 4_000_000 // width)
    for top in range(0, height, step):
        bottom = min(top + step, height)
        whole = (top, bottom) == (0, height)
        yield slice(top, bottom), image if whole else image.crop((0, top, width, bottom))


def bit_depth(largest_value: int) -> int:
    """Depth of the sensor behind 16-bit files: the smallest common one that contains the largest value."""
    return next(bits for bits in (8, 10, 12, 14, 16) if largest_value < 2**bits)


def to_grey(raw: Raw, bits: int) -> Grey:
    """Drop the bits of a 16-bit image that do not fit 8; ``bits`` is the same for a whole sequence."""
    if raw.dtype == np.uint8:
        return raw.astype(np.uint8, copy=False)
    return (raw >> max(bits - 8, 0)).astype(np.uint8)


def read_mask(path: Path, width_px: int, height_px: int) -> Bools:
    """A mask (H, W), true where the file is not zero, of JPEG half of white. Raises UnreadableImage."""
    with _opened(path, width_px, height_px) as image:
        mask: Bools = np.empty((height_px, width_px), np.bool_)
        # JPEG scatters small values around an outline
        least = 128 if image.format == "JPEG" else 1
        for rows, part in _strips(image):
            # The index of a palette is the label; converted to grey, labels could become black.
            pixels = np.asarray(part)
            if part.mode in ("RGBA", "RGBa", "LA", "La", "PA"):
                colours, alpha = pixels[..., :-1], pixels[..., -1:]
                # a cut-out has its mask in the transparency, its colours are anything
                pixels = alpha if (colours >= least).any(axis=-1).all() and not alpha.all() else colours
            mask[rows] = (pixels >= least).any(axis=-1) if pixels.ndim == 3 else pixels >= least
        return mask


def has_content(grey: Grey) -> bool:
    """False for a frame that is black or uniform except for sensor noise and single hot pixels.

    Works on means of 4x4 blocks, where noise of a few levels is averaged out: content is a handful of
    blocks well above the median, or a wide spread over the image.
    """
    rows, columns = (max(size // 4, 1) for size in grey.shape)
    cut = grey[: rows * 4, : columns * 4]
    parts = cut.reshape(rows, cut.shape[0] // rows, columns, cut.shape[1] // columns)
    blocks = parts.mean(axis=(1, 3), dtype=np.float64)
    median = float(np.median(blocks))
    scatter = 1.4826 * float(np.median(np.abs(blocks - median)))
    bright = blocks > median + max(8.0, 5.0 * scatter)
    if int(bright.sum()) >= 8:
        return True
    low, high = np.percentile(blocks, [2.0, 98.0])
    return bool(high - low > 24.0)
