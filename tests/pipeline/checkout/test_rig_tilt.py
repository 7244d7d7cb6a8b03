"""Rows of left and right image: each tilt of the right camera is found with its size, a yaw is not."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polhode.frontend.features.epipolar_search import RowOffsets
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import exp_so3
from polhode.pipeline.checkout.rig_tilt import fit_rows, regions, tilt_checks
from polhode.pipeline.checkout.sample import Sample

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480, 12.0)
PITCH, ROLL, STRETCH = (
    "pitch of the right camera",
    "roll of the right camera",
    "difference of the focal lengths",
)


def rows_of(
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), stretch: float = 0.0, points: int = 60
) -> list[RowOffsets]:
    """Points before a right camera that is turned by these angles about its x, y and z."""
    rng, R, pairs = np.random.default_rng(5), exp_so3(np.deg2rad(tilt_deg)), []
    for _ in range(8):
        p = rng.uniform([-0.4, -0.3, 0.8], [0.4, 0.3, 1.1], (points, 3))
        uvd = RIG.project(p)
        # in the turned camera
        q = (p - [RIG.baseline_m, 0.0, 0.0]) @ R
        u = RIG.focal_px * q[:, 0] / q[:, 2] + RIG.cx_px - RIG.disparity_offset_px
        v = RIG.focal_px * (1.0 + stretch) * q[:, 1] / q[:, 2] + RIG.cy_px
        offset = uvd[:, 1] - v + 0.15 * rng.standard_normal(points)
        wrong = rng.random(points) < 0.1
        offset[wrong] += rng.uniform(-5.0, 5.0, int(wrong.sum()))
        pairs.append(RowOffsets(uvd[:, :2], uvd[:, 0] - u, offset))
    return pairs


def checks(rows: list[RowOffsets]) -> dict[str, Any]:
    pairs: Any = tuple(SimpleNamespace(rows=each, right=object()) for each in rows)
    data = Sample(pairs, np.zeros((0, 2), np.int64), ())
    fit = fit_rows(data, RIG)
    found: dict[str, Any] = {check.name: check for check in tilt_checks(data, RIG, fit)}
    return found | {"fit": fit}


def test_a_rig_as_calibrated_passes_and_a_yaw_does_not_show_which_is_said() -> None:
    found, yaw = checks(rows_of()), checks(rows_of((0.0, 0.2, 0.0)))
    for each in (found, yaw):
        assert {check.status for name, check in each.items() if name != "fit"} == {"PASS"}
    assert all(0.0 <= found[name].value < 4.0 * found[name].sigma for name in (PITCH, ROLL, STRETCH))
    assert "A yaw would not show" in yaw[PITCH].finding


@pytest.mark.parametrize("degrees", [0.06, 0.2, -0.2, 0.6])
def test_pitch_is_found_with_its_sign(degrees: float) -> None:
    check = checks(rows_of((degrees, 0.0, 0.0)))[PITCH]
    assert abs(check.value - abs(degrees)) < 4.0 * check.sigma + 1e-3
    assert check.status == ("FAIL" if abs(degrees) > 0.1 else "WARN")
    assert ("up" if degrees > 0 else "down") in check.finding
    assert check.advice.startswith("Calibrate the rig again")


@pytest.mark.parametrize("degrees", [0.4, -0.4])
def test_roll_beside_a_pitch_and_a_difference_of_focal_lengths_are_found(degrees: float) -> None:
    found = checks(rows_of((0.1, 0.0, degrees)))
    assert found[ROLL].value == pytest.approx(abs(degrees), abs=0.03) and found[ROLL].status == "WARN"
    assert (" clockwise" if degrees > 0 else "anticlockwise") in found[ROLL].finding
    assert found[PITCH].value == pytest.approx(0.1, abs=0.01)
    check = checks(rows_of(stretch=np.sign(degrees) * 0.01))[STRETCH]
    assert check.value == pytest.approx(1.0, abs=0.05) and check.status == "WARN"
    assert ("longer" if degrees > 0 else "shorter") in check.finding


def test_a_part_of_the_image_that_differs_exchanged_images_and_too_few_matches() -> None:
    rows = rows_of()
    corner = [0.6 * (each.uv_px < [640 / 3, 480 / 3]).all(axis=1) for each in rows]
    moved = checks([replace(a, offset_px=a.offset_px + b) for a, b in zip(rows, corner, strict=True)])
    median, count = regions(moved["fit"], RIG, moved["fit"].offset_px)
    assert median[0, 0] == pytest.approx(0.6, abs=0.15) and abs(median[2, 2]) < 0.15 and count.sum() > 300
    assert moved["residual vertical disparity of the worst region of the image"].status == "WARN"
    turned = checks([replace(each, disparity_px=24.0 - each.disparity_px) for each in rows])
    exchanged = turned["pairs with left and right exchanged"]
    assert (exchanged.value, exchanged.status) == (100.0, "FAIL")
    few = checks(rows_of(points=4))
    assert few.pop("fit") is None
    assert {(check.value, check.status) for check in few.values()} == {(None, "WARN")}
    assert "too few" in few["vertical disparity"].finding
