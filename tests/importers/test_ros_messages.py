"""Encodings of images in messages, as grey pixels."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from polhode.importers.sources.recording import DecodedImage
from polhode.importers.sources.ros_messages import RAW, image_of
from polhode.runtime.errors import InputError

RNG = np.random.default_rng(2)
GREY = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
RGB = RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8)
LUMA = np.asarray(Image.fromarray(RGB).convert("L"))


def decoded(pixels: NDArray[Any], encoding: str, padding: int = 0, is_bigendian: int = 0) -> NDArray[Any]:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)))
    message = SimpleNamespace(
        height=len(pixels),
        width=pixels.shape[1],
        step=rows.shape[1],
        encoding=encoding,
        is_bigendian=is_bigendian,
        data=rows.ravel(),
    )
    image = image_of(message, RAW, "a.bag, /left, image 3")
    assert isinstance(image, DecodedImage)
    return image.pixels


def test_grey_colour_sixteen_bits_in_either_order_and_brightness_beside_colours() -> None:
    for padding in (0, 5):
        for encoding in ("mono8", "8UC1"):
            np.testing.assert_array_equal(decoded(GREY, encoding, padding), GREY)
        np.testing.assert_array_equal(decoded(RGB, "rgb8", padding), LUMA)
        np.testing.assert_array_equal(decoded(RGB[..., ::-1], "bgr8", padding), LUMA)
        alpha = np.dstack([RGB[..., ::-1], GREY])
        np.testing.assert_array_equal(decoded(alpha, "bgra8", padding), LUMA)
    deep = RNG.integers(0, 2**16, (6, 8)).astype(np.uint16)
    np.testing.assert_array_equal(decoded(deep.astype("<u2"), "mono16"), deep)
    np.testing.assert_array_equal(decoded(deep.astype(">u2"), "16UC1", is_bigendian=1), deep)
    both = np.dstack([np.full_like(GREY, 128), GREY])
    np.testing.assert_array_equal(decoded(both, "yuv422"), GREY)
    np.testing.assert_array_equal(decoded(both[..., ::-1], "yuv422_yuy2"), GREY)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_patterns_give_the_grey_of_a_uniform_colour(pattern: str) -> None:
    colour = {"r": 200, "g": 120, "b": 40}
    cell = np.array([colour[letter] for letter in pattern], dtype=np.uint8).reshape(2, 2)
    grey = decoded(np.tile(cell, (6, 8)), f"bayer_{pattern}8")
    wanted = 0.299 * 200 + 0.587 * 120 + 0.114 * 40
    assert abs(grey[4:-4, 4:-4].astype(float) - wanted).max() < 1.5


@pytest.mark.parametrize(
    ("encoding", "words"), [("32FC1", "is not supported"), ("mono16", "do not hold 8x6 px")]
)
def test_other_encodings_and_short_data_are_named(encoding: str, words: str) -> None:
    with pytest.raises(InputError, match=r"^a.bag, /left, image 3: ") as caught:
        decoded(GREY, encoding)
    assert words in str(caught.value)
