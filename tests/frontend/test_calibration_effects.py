"""Effects of errors of the calibration: against projecting through the wrong cameras, by OpenCV."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from polhode.frontend.calibration_effects import calibration_effects
from polhode.frontend.rectification import make_rectifier
from polhode.geometry import fisheye
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.records.calibration_prior import (
    CalibrationPrior,
    changed,
    default_prior,
    exact_prior,
    parameter_names,
)
from polhode.records.rig_calibration import StereoCalibration

K = np.array([[900.0, 0.0, 330.0], [0.0, 905.0, 235.0], [0.0, 0.0, 1.0]])


def rig(toe_in_deg: float = 0.0, is_fisheye: bool = False) -> StereoCalibration:
    """A distorted rig on a body; toed in by an angle."""
    dist = np.array([-0.03, 0.004, -0.001, 2e-4] if is_fisheye else [-0.25, 0.09, 8e-4, -6e-4, 0.01])
    X_BC0 = make_pose(exp_so3(np.array([0.3, -0.2, 0.1])), np.array([0.2, 0.1, -0.3]))
    X_01 = make_pose(exp_so3(np.deg2rad([0.2, -toe_in_deg, -0.3])), np.array([0.15, 0.002, -0.003]))
    both = is_fisheye, is_fisheye
    return StereoCalibration(K, 1.01 * K, dist, 0.9 * dist, X_BC0, X_BC0 @ X_01, 640, 480, None, *both)


def measured(true: StereoCalibration, stated: StereoCalibration, p_B: Array, later_B: Array) -> Array:
    """uvd (n, 3) of points (n, 3) in B, where they are ``later_B`` for the right image."""
    rectifier = make_rectifier(stated)
    R_CR = rectifier.X_CR[:3, :3]
    R_DR = (inverse_pose(stated.X_BC1) @ stated.X_BC0)[:3, :3] @ R_CR
    places = []
    for i, (p, X_BC, R) in enumerate(((p_B, true.X_BC0, R_CR), (later_B, true.X_BC1, R_DR))):
        own = (true.K0, true.dist0) if i == 0 else (true.K1, true.dist1)
        given = (stated.K0, stated.dist0) if i == 0 else (stated.K1, stated.dist1)
        p_C = transform_points(inverse_pose(X_BC), p)
        if stated.fisheye0:
            rays = fisheye.rays(fisheye.project(p_C, *own), *given) @ R
            places.append(rays[:, :2] / rays[:, 2:])
            continue
        pixels = cv2.projectPoints(p_C, np.zeros(3), np.zeros(3), *own)[0]
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 100, 1e-14)
        seen = cv2.undistortPoints(
            pixels, *given, R=np.ascontiguousarray(R.T), P=np.eye(3), criteria=criteria
        )
        places.append(np.asarray(seen, dtype=np.float64)[:, 0])
    r = rectifier.rig
    (x, y), right = places[0].T, places[1][:, 0]
    d = r.focal_px * (x - right) + r.disparity_offset_px
    return np.stack([r.focal_px * x + r.cx_px, r.focal_px * y + r.cy_px, d], axis=1)


@pytest.mark.parametrize(("toe_in_deg", "is_fisheye"), [(0.3, False), (9.0, False), (0.3, True)])
def test_the_effects_are_those_of_wrong_cameras(toe_in_deg: float, is_fisheye: bool) -> None:
    stated, rng = rig(toe_in_deg, is_fisheye), np.random.default_rng(3)
    names = parameter_names(stated)
    # independent errors of the default's size, and of what the default takes as exact
    variance = np.diag(default_prior(stated).covariance).copy()
    sizes = {"p": 1e-4, "theta": 1e-4, "clock": 1e-4}
    for n, name in enumerate(names):
        variance[n] = variance[n] or sizes.get(name.partition(".")[2].partition("_")[0], 1e-4) ** 2
    prior = CalibrationPrior(names, np.diag(variance), "test")
    stated = replace(stated, prior=prior)
    rectifier = make_rectifier(stated)
    effects = calibration_effects(stated, rectifier, poses_stated=True)
    assert effects is not None and effects.left.shape[2] == len(names)
    z = rng.uniform(0.8, 1.5, 200)
    r = rectifier.rig
    u, v = rng.uniform(0.25, 0.75, (2, 200)) * [[r.width_px], [r.height_px]]
    p_R = np.stack([(u - r.cx_px) / r.focal_px * z, (v - r.cy_px) / r.focal_px * z, z], axis=1)
    velocity_R = rng.normal(0.0, 0.1, (200, 3))
    X_BR = stated.X_BC0 @ rectifier.X_CR
    drawn = prior.draw(rng)
    p_B = transform_points(X_BR, p_R)
    moved_B = p_B + drawn["cam1.clock_offset"] * velocity_R @ X_BR[:3, :3].T
    direct = measured(changed(stated, drawn), stated, p_B, moved_B) - measured(stated, stated, p_B, p_B)
    # the columns of a diagonal prior's factor are single parameters, of either sign and in another order
    coordinates = np.linalg.lstsq(prior.factor, np.array([drawn[name] for name in names]), rcond=None)[0]
    found = effects.at(r, p_R, velocity_R) @ coordinates
    assert abs(direct).max() > 0.1
    np.testing.assert_allclose(found, direct, atol=0.01 * abs(direct).max())


def test_each_observation_has_its_effects_an_exact_rig_has_none_and_ranges_no_disparity() -> None:
    stated = rig(0.3)
    effects = calibration_effects(stated, make_rectifier(stated), poses_stated=False)
    assert effects is not None and not effects.body_shift_m.any()
    p_R = np.random.default_rng(0).uniform([-0.2, -0.2, 0.8], [0.2, 0.2, 1.2], (500, 3))
    found = effects.at(make_rectifier(stated).rig, p_R)
    assert found.shape == (500, 3, effects.left.shape[2]) and np.isfinite(found).all()
    exact = replace(stated, prior=exact_prior(stated))
    assert calibration_effects(exact, make_rectifier(exact), poses_stated=True) is None
    ranges = calibration_effects(stated, make_rectifier(stated), False, has_ranges=True)
    assert ranges is not None and not ranges.at(make_rectifier(stated).rig, p_R[:9])[:, 2].any()
