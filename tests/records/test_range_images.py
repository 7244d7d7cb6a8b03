"""Sequences with range images instead of a second camera: what is read, and one line for each bad input."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_range_sensor
from polhode.records.range_images import VIRTUAL_SIGMA_PX, RangeModel
from polhode.runtime.errors import InputError

START_NS, STEP_NS, COUNT = 1_600_000_000_000_000_000, 500_000_000, 6
STAMPS = [START_NS + k * STEP_NS for k in range(COUNT)]
SCALE_M, SIGMA_M, DEPTH_M = 0.0005, 0.002, 1.5


@pytest.fixture
def ranged(small_sequence: Path) -> Path:
    """The small sequence with ranges of 1.5 m on its patch instead of the second camera."""
    mav0, rng = small_sequence / "mav0", np.random.default_rng(8)
    shutil.rmtree(mav0 / "cam1")
    write_range_sensor(mav0 / "range0", SCALE_M, SIGMA_M)
    write_camera_csv(mav0 / "range0", STAMPS)
    for stamp in STAMPS:
        raw = np.zeros((48, 64), dtype=np.uint16)
        raw[12:36, 20:44] = np.round((DEPTH_M + rng.normal(0.0, SIGMA_M, (24, 24))) / SCALE_M)
        write_png(image_path(mav0 / "range0", stamp), raw)
    return small_sequence


def message_of(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_sequence(folder)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_ranges_are_read_in_metres_and_take_the_place_of_the_second_camera(ranged: Path) -> None:
    sequence = open_sequence(ranged)
    assert (len(sequence), sequence.dropped, sequence.warnings) == (COUNT, (), ())
    assert sequence.has_ranges
    range_m = sequence.read_range(2)
    assert np.isnan(range_m[0, 0]) and np.isfinite(range_m).sum() == 24 * 24
    assert np.nanmean(range_m) == pytest.approx(DEPTH_M, abs=4.0 * SIGMA_M / 24)
    pair = sequence.read_pair(2)
    assert pair.left.any() and not pair.right.any() and pair.mask_right is not None
    # the virtual camera makes the noise of ranges that of disparities
    calibration = sequence.calibration
    baseline_m = calibration.X_BC1[0, 3] - calibration.X_BC0[0, 3]
    sigma_px = 50.5 * baseline_m * SIGMA_M / DEPTH_M**2
    assert sigma_px == pytest.approx(VIRTUAL_SIGMA_PX, rel=0.01)
    np.testing.assert_array_equal(calibration.K1, calibration.K0)
    np.testing.assert_array_equal(calibration.dist1, calibration.dist0)


def test_the_usual_range_is_that_of_the_target_by_masks_or_before_a_background(ranged: Path) -> None:
    mav0 = ranged / "mav0"

    def baseline_m(behind_m: float, range_m: float, patch: slice) -> float:
        for stamp in STAMPS:
            raw = np.full((48, 64), round(behind_m / SCALE_M), dtype=np.uint16)
            raw[patch, 28:36] = round(range_m / SCALE_M)
            raw[0, 0] = stamp // STEP_NS % 1000 + 1
            write_png(image_path(mav0 / "range0", stamp), raw)
        return float(open_sequence(ranged).calibration.X_BC1[0, 3])

    assert baseline_m(6.0, 1.2, slice(8, 40)) == pytest.approx(baseline_m(0.0, 1.2, slice(8, 40)), rel=1e-6)
    far = baseline_m(6.0, 0.5, slice(20, 28))
    mask = np.zeros((48, 64), dtype=np.bool_)
    mask[20:28, 28:36] = True
    for stamp in STAMPS:
        write_png(mav0 / "masks0" / f"{stamp}.png", mask)
    near = open_sequence(ranged).calibration.X_BC1[0, 3]
    assert far / near == pytest.approx((6.0 / 0.5) ** 2, rel=1e-6)
    for stamp in STAMPS:
        raw = np.where(mask, 0, 900 + stamp // STEP_NS % 1000).astype(np.uint16)
        write_png(image_path(mav0 / "range0", stamp), raw)
    assert "no pixel of the target, as the masks give it, has a measurement" in message_of(ranged)


def test_two_cameras_are_used_before_ranges_with_a_warning(ranged: Path, tmp_path: Path) -> None:
    mav0 = ranged / "mav0"
    shutil.copytree(mav0 / "cam0", mav0 / "cam1")
    sensor = mav0 / "cam1" / "sensor.yaml"
    sensor.write_text(sensor.read_text().replace("[1.0, 0.0, 0.0, 0.0,", "[1.0, 0.0, 0.0, 0.09,"))
    sequence = open_sequence(ranged)
    assert not sequence.has_ranges
    assert "range0 is not used, since there are two cameras" in sequence.warnings[0]


def test_missing_small_and_8_bit_range_images_are_dropped_by_name(ranged: Path) -> None:
    folder = ranged / "mav0" / "range0"
    # a frame without a measurement stays
    write_png(image_path(folder, STAMPS[3]), np.zeros((48, 64), dtype=np.uint16))
    assert len(open_sequence(ranged)) == COUNT
    assert not np.isfinite(open_sequence(ranged).read_range(3)).any()
    image_path(folder, STAMPS[0]).unlink()
    write_png(image_path(folder, STAMPS[2]), np.full((24, 32), 900, dtype=np.uint16))
    write_png(image_path(folder, STAMPS[4]), np.full((48, 64), 90, dtype=np.uint8))
    sequence = open_sequence(ranged)
    assert sequence.dropped == (
        (STAMPS[0], "range0 image: file missing"),
        (STAMPS[2], "range0 image: wrong size, 32x24 px instead of 64x48 px"),
        (
            STAMPS[4],
            "range0 image: 8 bits or colours, where 16-bit grey is needed; save ranges with their full depth",
        ),
    )
    assert len(sequence.warnings) == 1


def _sensor(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        path = folder / "range0" / "sensor.yaml"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return change


def _all_images(image: np.ndarray) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        for stamp in STAMPS:
            write_png(image_path(folder / "range0", stamp), image)

    return change


BAD: dict[str, tuple[Callable[[Path], None], str]] = {
    "no scale": (_sensor("scale_m: 0.0005, ", ""), "lacks the key 'scale_m': give the metres per unit"),
    "scale of no unit": (_sensor("scale_m: 0.0005", "scale_m: 0.0"), "'scale_m': 0, expected 1e-07 to 10"),
    "scale NaN": (_sensor("scale_m: 0.0005", "scale_m: .nan"), "'scale_m': contains NaN"),
    "no sigma": (_sensor("sigma_m: 0.002, ", ""), "lacks the key 'sigma_m'"),
    "sigma negative": (_sensor("sigma_m: 0.002", "sigma_m: -1.0"), "'sigma_m': -1, expected"),
    "growth negative": (_sensor("per_m: 0.0", "per_m: -2.0"), "'sigma_growth_per_m': -2, expected 0"),
    "along nothing": (_sensor("along: axis", "along: z"), "key 'along': expected axis"),
    "no sensor": (lambda mav0: (mav0 / "range0" / "sensor.yaml").unlink(), "need their scale_m and sigma_m"),
    "no list": (lambda mav0: (mav0 / "range0" / "data.csv").unlink(), "range0/data.csv"),
    "all zero": (_all_images(np.zeros((48, 64), np.uint16)), "no image has a measurement, all pixels are 0"),
    "all of 8 bits": (_all_images(np.ones((48, 64), np.uint8)), "where 16-bit grey is needed"),
    "no calibration": (lambda mav0: (mav0 / "cam0" / "sensor.yaml").unlink(), "cam0/sensor.yaml is missing"),
    "no camera": (lambda mav0: shutil.rmtree(mav0 / "cam0"), "cam0 is missing"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_ranges_are_refused_in_a_line(ranged: Path, name: str) -> None:
    change, words = BAD[name]
    change(ranged / "mav0")
    assert words in message_of(ranged)


def test_the_noise_grows_with_the_square_of_the_range() -> None:
    model = RangeModel(0.001, 0.003, 0.002)
    np.testing.assert_allclose(
        model.sigma_at(np.array([0.0, 1.0, 3.0])), np.hypot(0.003, [0.0, 0.002, 0.018])
    )
    np.testing.assert_array_equal(model.metres(np.array([[0, 1500]], np.uint16)), [[np.nan, 1.5]])
