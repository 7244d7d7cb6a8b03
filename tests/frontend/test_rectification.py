"""Rectification: the maps must send each rectified pixel to where the real camera saw that point."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.frontend.rectification import make_rectifier
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.records.rig_calibration import StereoCalibration
from polhode.runtime.errors import InputError

K0 = np.array([[467.0, 0.0, 322.0], [0.0, 465.0, 238.0], [0.0, 0.0, 1.0]])
K1 = np.array([[470.0, 0.0, 318.0], [0.0, 471.0, 244.0], [0.0, 0.0, 1.0]])
DIST0 = np.array([-0.12, 0.05, 1e-3, -5e-4])
DIST1 = np.array([-0.10, 0.04, -8e-4, 3e-4])


def rig(X_CD: Array, K_left: Array = K0, K_right: Array = K1, distorted: bool = True) -> StereoCalibration:
    """A rig whose body is turned against the left camera; X_CD is the right camera in the left one."""
    X_BC0 = make_pose(exp_so3([0.2, -0.1, 1.3]), [0.05, 0.02, -0.03])
    lenses = (DIST0, DIST1) if distorted else (np.zeros(4), np.zeros(4))
    left, right = lenses
    return StereoCalibration(K_left, K_right, left, right, X_BC0, X_BC0 @ X_CD, 640, 480)


RIGS = {
    "toed_in": make_pose(exp_so3([0.01, -0.09, 0.02]), [0.09, 0.004, -0.006]),
    "swapped": make_pose(exp_so3([0.0, 0.04, 0.0]), [-0.12, 0.0, 0.0]),
    "stacked": make_pose(exp_so3([0.03, 0.0, 0.01]), [0.002, 0.1, 0.0]),
}


def of_two_kinds(name: str) -> StereoCalibration:
    """Toed in: the right camera has finer pixels, both have fisheyes, or both at once; or another rig."""
    if name in RIGS:
        return rig(RIGS[name])
    calibration = rig(RIGS["toed_in"])
    if name != "fisheyes":
        K1_fine = K1 * 1.75
        K1_fine[2, 2] = 1.0
        calibration = replace(calibration, K1=K1_fine, right_size_px=(1120, 840))
    if name != "two resolutions":
        dist0, dist1 = np.array([-0.028, 0.012, -0.009, 0.0016]), np.array([0.02, -0.01, 0.0, 0.0])
        calibration = replace(calibration, fisheye0=True, fisheye1=True, dist0=dist0, dist1=dist1)
    return calibration


@pytest.mark.parametrize("name", [*RIGS, "fisheyes", "two resolutions", "fisheyes of two resolutions"])
def test_rectified_pixels_come_from_where_the_camera_saw_them(name: str) -> None:
    """Rectified pixels lie where OpenCV's own model of the lens saw their points."""
    calibration = of_two_kinds(name)
    rectifier = make_rectifier(calibration)
    assert rectifier.maps is not None
    rng = np.random.default_rng(1)
    reach = 0.12 if name in RIGS else 0.2
    p_C = rng.uniform([-reach, -reach, 0.6], [reach, reach, 1.5], (300, 3))
    uvd = rectifier.rig.project(transform_points(inverse_pose(rectifier.X_CR), p_C))
    p_D = transform_points(inverse_pose(RIGS.get(name, RIGS["toed_in"])), p_C)
    lenses = (
        (p_C, calibration.K0, calibration.dist0, calibration.fisheye0),
        (p_D, calibration.K1, calibration.dist1, calibration.fisheye1),
    )
    for side, (p, K, dist, fisheye) in enumerate(lenses):
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        seen = project(p[:, None], np.zeros(3), np.zeros(3), K, dist)[0][:, 0]
        u, v = (uvd[:, 0] - side * uvd[:, 2]).astype(np.float32), uvd[:, 1].astype(np.float32)
        maps = rectifier.maps[side]
        mapped = np.stack([cv2.remap(m, u[None], v[None], cv2.INTER_LINEAR)[0] for m in maps], axis=1)
        inside = (u > 1) & (v > 1) & (u < rectifier.rig.width_px - 2) & (v < rectifier.rig.height_px - 2)
        assert inside.mean() > 0.5
        assert np.abs(mapped - seen)[inside].max() < 0.05


def test_the_finer_image_is_smoothed_to_the_pixels_of_the_common_one() -> None:
    """Stripes one pixel wide, which the coarser pixels cannot show, do not alias."""
    calibration = of_two_kinds("two resolutions")
    K1_fine = K1 * 3.0
    K1_fine[2, 2] = 1.0
    rectifier = make_rectifier(replace(calibration, K1=K1_fine, right_size_px=(1920, 1440)))
    assert rectifier.rig.focal_px == pytest.approx(np.mean([467.0, 465.0, 3.0 * 470.0, 3.0 * 471.0]))
    assert rectifier.blur_px[0] == 0.0
    stripes = np.tile(np.array([0, 255], dtype=np.uint8), (1440, 960))
    sharp = replace(rectifier, blur_px=(0.0, 0.0))(stripes, 1)
    middle = tuple(slice(side // 3, -side // 3) for side in sharp.shape)
    assert rectifier(stripes, 1)[middle].std() < 0.6 * sharp[middle].std()


def test_a_fisheye_of_a_half_sphere_keeps_what_a_plane_can_show() -> None:
    """Corners that the lens does not show, and rays beside the camera, do not reach the rectified image."""
    K = np.array([[205.0, 0.0, 319.5], [0.0, 205.0, 239.5], [0.0, 0.0, 1.0]])
    parallel = rig(make_pose(np.eye(3), [0.09, 0.0, 0.0]), K, K, distorted=False)
    rectifier = make_rectifier(replace(parallel, fisheye0=True, fisheye1=True))
    assert rectifier.maps is not None
    assert rectifier.rig.width_px <= 1.6 * 640 + 1
    shown = rectifier(np.full((480, 640), 255, dtype=np.uint8), 0)
    assert shown[rectifier.rig.height_px // 2, rectifier.rig.width_px // 2] == 255
    assert (shown == 255).mean() > 0.8


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


@pytest.mark.parametrize("k1", [-1e6, -3.0])
@pytest.mark.parametrize("fisheye", [False, True])
def test_a_distortion_that_folds_the_image_is_refused_in_one_line(fisheye: bool, k1: float) -> None:
    whole = of_two_kinds("fisheyes") if fisheye else rig(make_pose(np.eye(3), [0.09, 0.0, 0.0]))
    with pytest.raises(InputError, match="folds the border of the image over itself") as caught:
        make_rectifier(replace(whole, dist0=np.array([k1, 0.0, 0.0, 0.0])))
    assert "\n" not in str(caught.value)
