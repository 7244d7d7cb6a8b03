"""Images of every kind that Pillow writes: read as stored, or refused with their reason, before decoding."""

import io
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from polhode.files.images import MAX_PIXELS, UnreadableImage, parallel_decodes, read_mask, read_raw

WIDTH, HEIGHT = 12, 8
GREY = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) * 2).astype(np.uint8)
DEEP = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) * 600).astype(np.uint16)
WHOLE = DEEP.astype(np.int32)


def _saved(path: Path, image: Image.Image, **options: Any) -> Path:
    image.save(path, **options)
    return path


def _read(path: Path) -> np.ndarray[Any, Any]:
    return np.asarray(read_raw(path, WIDTH, HEIGHT))


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        *((name, mode) for name in ("a.png", "a.tif", "a.bmp") for mode in ("L", "RGB", "P", "1")),
        *(("a.pgm", mode) for mode in ("L", "RGB", "1")),
    ],
)
def test_grey_colour_palette_and_one_bit_are_read(tmp_path: Path, name: str, mode: str) -> None:
    image = Image.fromarray(GREY).convert(mode)
    path = _saved(tmp_path / (name if mode != "RGB" else name.replace("pgm", "ppm")), image)
    np.testing.assert_array_equal(_read(path), np.asarray(image.convert("L")))


def test_transparency_is_ignored_and_deep_values_come_as_stored(tmp_path: Path) -> None:
    for name, mode in (("a.png", "LA"), ("a.png", "RGBA"), ("a.tif", "LA"), ("a.tif", "RGBA")):
        image = Image.fromarray(GREY).convert(mode)
        image.putalpha(Image.fromarray(GREY[::-1].copy()))
        path = _saved(tmp_path / name, image)
        np.testing.assert_array_equal(_read(path), GREY)
        np.testing.assert_array_equal(read_mask(path, WIDTH, HEIGHT), GREY > 0)
    for name in ("a.png", "a.tif", "a.pgm"):
        np.testing.assert_array_equal(_read(_saved(tmp_path / name, Image.fromarray(DEEP))), DEEP)
    path = _saved(tmp_path / "a.jpg", Image.fromarray(GREY), quality=95)
    assert np.abs(_read(path).astype(int) - GREY).max() < 20
    image = Image.frombytes("I;16B", (WIDTH, HEIGHT), DEEP.astype(">u2").tobytes())
    np.testing.assert_array_equal(_read(_saved(tmp_path / "a.tif", image)), DEEP)
    np.testing.assert_array_equal(_read(_saved(tmp_path / "b.tif", Image.fromarray(WHOLE))), DEEP)
    values = (DEEP >> 4).astype(">u2")
    (tmp_path / "a.pgm").write_bytes(b"P5 %d %d 4095\n" % (WIDTH, HEIGHT) + values.tobytes())
    np.testing.assert_array_equal(_read(tmp_path / "a.pgm"), values)


REFUSED = {
    "floating point": (Image.fromarray(np.full((HEIGHT, WIDTH), np.nan, np.float32)), {}, "floating"),
    "CMYK": (Image.new("CMYK", (WIDTH, HEIGHT)), {}, "colours of the kind CMYK"),
    "LAB": (Image.new("LAB", (WIDTH, HEIGHT)), {}, "colours of the kind LAB"),
    "negative": (Image.fromarray(WHOLE - np.int32(1)), {}, "negative values"),
    "above 16 bits": (Image.fromarray(WHOLE + np.int32(2**16)), {}, "values of more than 16 bits"),
    # Pillow ignores the tag
    "white as zero": (Image.fromarray(DEEP), {"tiffinfo": {262: 0}}, "zero is white"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_pixels_that_cannot_be_grey_are_refused(tmp_path: Path, case: str) -> None:
    image, options, message = REFUSED[case]
    path = _saved(tmp_path / "a.tif", image, **options)
    for read in (read_raw, read_mask) if case.startswith(("floating", "CMYK", "LAB")) else (read_raw,):
        with pytest.raises(UnreadableImage, match=message):
            read(path, WIDTH, HEIGHT)


def _png(colour: int, depth: int, row: bytes, size: tuple[int, int] = (WIDTH, HEIGHT)) -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", *size, depth, colour, 0, 0, 0))
    body = chunk(b"IDAT", zlib.compress((b"\0" + row) * size[1]))
    return b"\x89PNG\r\n\x1a\n" + head + body + chunk(b"IEND", b"")


@pytest.mark.parametrize("colour", [2, 4, 6])
def test_colours_of_16_bits_are_refused(tmp_path: Path, colour: int) -> None:
    # Pillow keeps their upper bytes alone: an image of a 12-bit camera would become black.
    channels = {2: 3, 4: 2, 6: 4}[colour]
    path = tmp_path / "a.png"
    path.write_bytes(_png(colour, 16, b"\0\1" * channels * WIDTH))
    with pytest.raises(UnreadableImage, match="colours of 16 bits"):
        _read(path)


def test_only_the_first_page_is_read(tmp_path: Path) -> None:
    pages = [Image.fromarray(np.full((HEIGHT, WIDTH), level, np.uint8)) for level in (10, 20)]
    path = _saved(tmp_path / "a.tif", pages[0], save_all=True, append_images=pages[1:])
    assert (_read(path) == 10).all()
    path = _saved(tmp_path / "a.png", pages[0], save_all=True, append_images=pages[1:])
    assert (_read(path) == 10).all()


@pytest.mark.parametrize("name", ["a.eps", "a.gif", "a.webp", "a.pdf", "a.tga"])
def test_other_formats_are_not_tried_whatever_their_name(tmp_path: Path, name: str) -> None:
    content = io.BytesIO()
    Image.fromarray(GREY).save(content, format=Image.registered_extensions()[Path(name).suffix])
    path = tmp_path / "a.png"
    path.write_bytes(content.getvalue())
    with pytest.raises(UnreadableImage, match="not an image in PNG, TIFF, JPEG, BMP or PGM"):
        _read(path)


@pytest.mark.parametrize("read", [read_raw, read_mask])
def test_the_size_is_compared_before_anything_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read: Callable[[Path, int, int], object]
) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(_png(0, 8, bytes(13_000), (13_000, 13_000)))
    monkeypatch.setattr(Image.Image, "load", lambda _: pytest.fail("decoded"))
    monkeypatch.setattr(PngImagePlugin.PngImageFile, "load", lambda _: pytest.fail("decoded"))
    with pytest.raises(UnreadableImage, match="wrong size, 13000x13000 px instead of 640x480 px"):
        read(path, 640, 480)


def test_what_costs_more_than_its_pixels_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pgm"
    path.write_bytes(b"P2 %d %d 255\n" % (WIDTH, HEIGHT) + b"7 " * WIDTH * HEIGHT)
    with pytest.raises(UnreadableImage, match="plain text or run lengths"):
        _read(path)
    path = _saved(tmp_path / "a.png", Image.fromarray(GREY))
    os.truncate(path, 10**9)
    with pytest.raises(UnreadableImage, match=r"has 1 GB, more than the 16\.8 MB that an image of 12x8 px"):
        _read(path)
    path = _saved(tmp_path / "a.jpg", Image.fromarray(GREY), progressive=True)
    content = path.read_bytes()
    scan = content.rindex(b"\xff\xda")
    path.write_bytes(content[:scan] + content[scan:-2] * 500 + content[-2:])
    with pytest.raises(UnreadableImage, match=r"a JPEG of 50\d scans"):
        _read(path)
    texts = PngImagePlugin.PngInfo()
    texts.add_text("bomb", "0" * 10**7, zip=True)
    path = _saved(tmp_path / "b.png", Image.fromarray(GREY), pnginfo=texts)
    with pytest.raises(UnreadableImage, match="damaged or truncated"):
        _read(path)


def test_large_images_are_read_in_strips(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 2**12, (2100, 3000)).astype(np.uint16)
    path = _saved(tmp_path / "a.tif", Image.fromarray(values))
    np.testing.assert_array_equal(read_raw(path, 3000, 2100), values)
    np.testing.assert_array_equal(read_mask(path, 3000, 2100), values > 0)
    # few large images are decoded at once
    assert parallel_decodes(8000, MAX_PIXELS // 8000) == 1 and parallel_decodes(640, 480) >= 8
