"""Rows of left and right image: each tilt of the right camera is found with its size, a yaw is not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.frontend.features.row_offsets import RowOffsets
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import exp_so3
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.rig_tilt import fit_rows, regions, tilt_checks
from polhode.pipeline.checkout.sample import Sample

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480, 12.0)
PAIRS, POINTS = 8, 60


class Pair:
    """The part of ``ExaminedPair`` that the check reads."""

    def __init__(self, rows: RowOffsets) -> None:
        self.rows, self.right = rows, object()


def sample(
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), stretch: float = 0.0, points: int = POINTS
) -> Any:
    """Points before a right camera that is turned by these angles about its x, y and z."""
    rng = np.random.default_rng(5)
    R = exp_so3(np.deg2rad(tilt_deg))
    pairs = []
    for _ in range(PAIRS):
        p = rng.uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.1], (points, 3))
        uvd = RIG.project(p)
        # in the turned camera
        q = (p - [RIG.baseline_m, 0.0, 0.0]) @ R
        u = RIG.focal_px * q[:, 0] / q[:, 2] + RIG.cx_px - RIG.disparity_offset_px
        v = RIG.focal_px * (1.0 + stretch) * q[:, 1] / q[:, 2] + RIG.cy_px
        offset = uvd[:, 1] - v + 0.15 * rng.standard_normal(points)
        wrong = rng.random(points) < 0.1
        offset[wrong] += rng.uniform(-5.0, 5.0, int(wrong.sum()))
        pairs.append(Pair(RowOffsets(uvd[:, :2], uvd[:, 0] - u, offset)))
    return Sample(tuple(pairs), np.zeros((0, 2), np.int64), ())  # type: ignore[arg-type]


def checks(data: Any) -> dict[str, CheckoutCheck]:
    return {check.name: check for check in tilt_checks(data, RIG, fit_rows(data, RIG))}


def test_a_rig_as_calibrated_passes_with_sigmas_that_hold() -> None:
    found = checks(sample())
    assert {check.status for check in found.values()} == {"PASS"}
    for name in ("pitch of the right camera", "roll of the right camera", "difference of the focal lengths"):
        value, sigma = found[name].value, found[name].sigma
        assert value is not None and sigma is not None and 0.0 <= value < 4.0 * sigma


@pytest.mark.parametrize("degrees", [0.06, 0.2, -0.2, 0.6])
def test_pitch_is_found_with_its_sign(degrees: float) -> None:
    check = checks(sample((degrees, 0.0, 0.0)))["pitch of the right camera"]
    assert check.value is not None and check.sigma is not None
    assert abs(check.value - abs(degrees)) < 4.0 * check.sigma + 1e-3
    assert check.status == ("FAIL" if abs(degrees) > 0.1 else "WARN")
    assert ("up" if degrees > 0 else "down") in check.finding
    assert check.advice.startswith("Calibrate the rig again")


@pytest.mark.parametrize("degrees", [0.4, -0.4])
def test_roll_is_found_with_its_sign_beside_a_pitch(degrees: float) -> None:
    found = checks(sample((0.1, 0.0, degrees)))
    roll, pitch = found["roll of the right camera"], found["pitch of the right camera"]
    assert roll.value == pytest.approx(abs(degrees), abs=0.03) and roll.status == "WARN"
    assert (" clockwise" if degrees > 0 else "anticlockwise") in roll.finding
    assert pitch.value == pytest.approx(0.1, abs=0.01)


def test_a_difference_of_focal_lengths_is_found_and_a_yaw_does_not_show_which_is_said() -> None:
    check = checks(sample(stretch=0.01))["difference of the focal lengths"]
    assert check.value == pytest.approx(1.0, abs=0.05)
    assert check.status == "WARN" and "longer" in check.finding
    found = checks(sample((0.0, 0.2, 0.0)))
    assert {check.status for check in found.values()} == {"PASS"}
    assert "A yaw would not show" in found["pitch of the right camera"].finding


def test_a_part_of_the_image_that_differs_is_named() -> None:
    data = sample()
    moved = []
    for pair in data.pairs:
        rows = pair.rows
        corner = (rows.uv_px < [640 / 3, 480 / 3]).all(axis=1)
        moved.append(Pair(replace(rows, offset_px=rows.offset_px + 0.6 * corner)))
    data = replace(data, pairs=tuple(moved))
    fit = fit_rows(data, RIG)
    assert fit is not None
    median, count = regions(fit, RIG, fit.offset_px)
    assert median[0, 0] == pytest.approx(0.6, abs=0.15) and abs(median[2, 2]) < 0.15 and count.sum() > 300
    assert checks(data)["residual vertical disparity of the worst region of the image"].status == "WARN"


def test_exchanged_images_fail() -> None:
    data = sample()
    turned = [Pair(replace(pair.rows, disparity_px=24.0 - pair.rows.disparity_px)) for pair in data.pairs]
    found = checks(replace(data, pairs=tuple(turned)))["pairs with left and right exchanged"]
    assert (found.value, found.status) == (100.0, "FAIL")


def test_too_few_matches_are_not_judged() -> None:
    found = checks(sample(points=4))
    assert {(check.value, check.status) for check in found.values()} == {(None, "WARN")}
    assert "too few" in found["vertical disparity"].finding
