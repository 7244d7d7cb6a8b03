"""Images: damage of any kind is found; noise alone is not content."""

from pathlib import Path

import numpy as np
import pytest

from polhode.files.images import UnreadableImage, bit_depth, has_content, read_mask, read_raw, to_grey
from polhode.records.dataset_writer import write_png


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    path = tmp_path / "picture.png"
    write_png(path, np.random.default_rng(3).integers(0, 255, (96, 128)).astype(np.uint8))
    return path


@pytest.mark.parametrize("share", [0.0, 0.001, 0.01, 0.1, 0.5, 0.9, 0.99])
def test_a_truncated_png_is_unreadable_wherever_it_ends(picture: Path, share: float) -> None:
    content = picture.read_bytes()
    picture.write_bytes(content[: int(share * len(content))])
    for read in (read_raw, read_mask):
        with pytest.raises(UnreadableImage):
            read(picture, 128, 96)


def test_damage_and_what_is_no_image_are_told_apart(picture: Path) -> None:
    content = bytearray(picture.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 40] = bytes(40)
    for damaged, message in ((bytes(content), "damaged or truncated"), (b"404 not found", "not an image")):
        picture.write_bytes(damaged)
        with pytest.raises(UnreadableImage, match=message):
            read_raw(picture, 128, 96)


def test_the_largest_value_tells_the_bits_of_the_sensor() -> None:
    assert [bit_depth(value) for value in (0, 255, 256, 1023, 4095, 4096, 16383, 65535)] == [
        8, 8, 10, 10, 12, 14, 14, 16,
    ]  # fmt: skip


def test_sixteen_bits_become_eight_without_wrapping() -> None:
    raw = np.array([[0, 15, 16, 4095]], dtype=np.uint16)
    np.testing.assert_array_equal(to_grey(raw, bits=12), [[0, 0, 1, 255]])


@pytest.mark.parametrize("sigma", [0.0, 1.0, 3.0, 8.0])
@pytest.mark.parametrize("level", [0.0, 16.0])
def test_noise_and_hot_pixels_are_no_content(sigma: float, level: float) -> None:
    rng = np.random.default_rng(5)
    frame = rng.normal(level, sigma, (480, 640)).clip(0, 255)
    frame[rng.integers(0, 480, 6), rng.integers(0, 640, 6)] = 255.0
    assert not has_content(frame.astype(np.uint8))


@pytest.mark.parametrize("side_px", [16, 200, 480])
def test_a_dim_target_in_noise_is_content(side_px: int) -> None:
    rng = np.random.default_rng(5)
    frame = rng.normal(2.0, 1.5, (480, 640))
    texture = rng.uniform(10.0, 80.0, (side_px // 4, side_px // 4)).repeat(4, axis=0).repeat(4, axis=1)
    frame[:side_px, 40 : 40 + side_px] += texture
    assert has_content(frame.clip(0, 255).astype(np.uint8))
