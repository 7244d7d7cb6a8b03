"""Rectification: the maps must send each rectified pixel to where the real camera saw that point."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.calibration import StereoCalibration
from polhode.errors import InputError
from polhode.frontend.rectification import Crop, Image, make_rectifier, target_crop, target_mask
from polhode.lie import Array, exp_so3, inverse_pose, make_pose, transform_points

K0 = np.array([[467.0, 0.0, 322.0], [0.0, 465.0, 238.0], [0.0, 0.0, 1.0]])
K1 = np.array([[470.0, 0.0, 318.0], [0.0, 471.0, 244.0], [0.0, 0.0, 1.0]])
DIST0 = np.array([-0.12, 0.05, 1e-3, -5e-4])
DIST1 = np.array([-0.10, 0.04, -8e-4, 3e-4])


def rig(X_CD: Array, K_left: Array = K0, K_right: Array = K1, distorted: bool = True) -> StereoCalibration:
    """A rig whose body is turned against the left camera; X_CD is the right camera in the left one."""
    X_BC0 = make_pose(exp_so3([0.2, -0.1, 1.3]), [0.05, 0.02, -0.03])
    none = np.zeros(4)
    return StereoCalibration(
        K_left,
        K_right,
        DIST0 if distorted else none,
        DIST1 if distorted else none,
        X_BC0,
        X_BC0 @ X_CD,
        640,
        480,
    )


RIGS = {
    "toed_in": make_pose(exp_so3([0.01, -0.09, 0.02]), [0.09, 0.004, -0.006]),
    "swapped": make_pose(exp_so3([0.0, 0.04, 0.0]), [-0.12, 0.0, 0.0]),
    "stacked": make_pose(exp_so3([0.03, 0.0, 0.01]), [0.002, 0.1, 0.0]),
}


@pytest.mark.parametrize("name", RIGS)
def test_rectified_pixels_come_from_where_the_camera_saw_them(name: str) -> None:
    calibration = rig(RIGS[name])
    rectifier = make_rectifier(calibration)
    assert rectifier.maps is not None
    rng = np.random.default_rng(1)
    p_C = np.column_stack(
        [rng.uniform(-0.12, 0.12, 200), rng.uniform(-0.12, 0.12, 200), rng.uniform(0.6, 1.5, 200)]
    )
    uvd = rectifier.rig.project(transform_points(inverse_pose(rectifier.X_CR), p_C))
    p_D = transform_points(inverse_pose(RIGS[name]), p_C)
    for side, (p, K, dist) in enumerate(((p_C, K0, DIST0), (p_D, K1, DIST1))):
        seen = cv2.projectPoints(p, np.zeros(3), np.zeros(3), K, dist)[0][:, 0]
        u, v = (uvd[:, 0] - side * uvd[:, 2]).astype(np.float32), uvd[:, 1].astype(np.float32)
        mapped = np.stack(
            [cv2.remap(m, u[None], v[None], cv2.INTER_LINEAR)[0] for m in rectifier.maps[side]], axis=1
        )
        inside = (u > 1) & (v > 1) & (u < rectifier.rig.width_px - 2) & (v < rectifier.rig.height_px - 2)
        assert inside.mean() > 0.5
        assert np.abs(mapped - seen)[inside].max() < 0.05


def test_the_disparity_of_a_rectified_point_gives_its_place_back() -> None:
    rectifier = make_rectifier(rig(RIGS["toed_in"]))
    p_R = np.array([[0.05, -0.02, 0.7], [-0.1, 0.1, 2.0]])
    np.testing.assert_allclose(rectifier.rig.triangulate(rectifier.rig.project(p_R)), p_R, rtol=1e-12)


def test_an_ideal_pair_is_not_resampled() -> None:
    K = np.array([[467.0, 0.0, 319.5], [0.0, 467.0, 239.5], [0.0, 0.0, 1.0]])
    shifted = K + np.array([[0.0, 0.0, 7.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    rectifier = make_rectifier(rig(make_pose(np.eye(3), [0.09, 0.0, 0.0]), K, shifted, distorted=False))
    image = np.arange(640 * 480, dtype=np.uint8).reshape(480, 640)
    assert rectifier.maps is None
    assert rectifier(image, 0) is image
    assert rectifier.rig.disparity_offset_px == pytest.approx(-7.0)
    assert rectifier.rig.baseline_m == pytest.approx(0.09)


def test_cameras_that_look_apart_are_refused_in_one_line() -> None:
    with pytest.raises(InputError, match="do not look in the same direction") as caught:
        make_rectifier(rig(make_pose(exp_so3([0.0, np.pi, 0.0]), [0.09, 0.0, 0.0])))
    assert "\n" not in str(caught.value)


def scene(seed: int = 0) -> Image:
    """Read noise, a few stars, one bright disk at (200, 150) of 60 px radius, half of it in shadow."""
    rng = np.random.default_rng(seed)
    image = rng.normal(2.0, 1.5, (300, 400))
    for u, v in rng.integers(5, 295, (12, 2)):
        if np.hypot(u - 200, v - 150) > 80:
            image[v, u] = 220.0
    v, u = np.mgrid[0:300, 0:400]
    disk = np.hypot(u - 200, v - 150) < 60
    image[disk & (u < 205)] += 120.0
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def test_the_mask_holds_the_lit_target_and_no_star() -> None:
    mask = target_mask(scene())
    v, u = np.mgrid[0:300, 0:400]
    lit = (np.hypot(u - 200, v - 150) < 57) & (u < 203)
    far = np.hypot(u - 200, v - 150) > 66
    assert mask[lit].mean() > 0.99
    assert not mask[far].any()


def test_two_parts_of_one_craft_are_kept() -> None:
    image = np.zeros((300, 400), dtype=np.uint8)
    cv2.rectangle(image, (50, 100), (150, 200), 90, -1)
    cv2.rectangle(image, (180, 120), (230, 180), 90, -1)
    mask = target_mask(image)
    assert mask[150, 100]
    assert mask[150, 205]


def test_a_given_mask_is_taken_as_it_is() -> None:
    given = np.zeros((300, 400), dtype=bool)
    given[10:20, 30:50] = True
    assert target_mask(scene(), given) is given
    assert target_crop(given, margin_px=5) == Crop(25, 5, 55, 25)


def test_black_sky_has_no_target() -> None:
    noise = np.clip(np.random.default_rng(0).normal(1.0, 0.8, (300, 400)), 0, 255).astype(np.uint8)
    assert target_crop(target_mask(noise)) is None
    assert target_crop(target_mask(np.zeros((300, 400), dtype=np.uint8))) is None


@pytest.mark.parametrize("k1", [-1e6, -3.0])
def test_a_distortion_that_folds_the_image_is_refused_in_one_line(k1: float) -> None:
    folded = replace(rig(make_pose(np.eye(3), [0.09, 0.0, 0.0])), dist0=np.array([k1, 0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match="folds the border of the image over itself") as caught:
        make_rectifier(folded)
    assert "\n" not in str(caught.value)
