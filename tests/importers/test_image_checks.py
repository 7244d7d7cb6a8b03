"""What matches say of the order of the cameras and of their clocks, on points of a known motion."""

import numpy as np
import pytest

from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.importers.calibrations.rig import RADIAL_TANGENTIAL, Camera, Rig
from polhode.importers.image_checks import clock_offset, match_some, require_order
from polhode.importers.stereo_matches import StereoMatches
from polhode.runtime.errors import InputError

FOCAL_PX, INTERVAL_S, NOISE_PX = 467.0, 0.5, 0.3
X_BC1 = make_pose(exp_so3([0.01, -0.1, 0.02]), [0.09, 0.0, 0.003])
RIG = Rig(
    *(
        Camera(
            "test", (FOCAL_PX, FOCAL_PX, 319.5, 239.5), RADIAL_TANGENTIAL, (0.0, 0.0, 0.0, 0.0), X, (640, 480)
        )
        for X in (np.eye(4), X_BC1)
    )
)


def seen(X_BC: Array, p_G: Array, axis: Array, time_s: float, rng: np.random.Generator) -> Array:
    """(n, 2) pixels of points that turn about an axis [rad/s] half a metre before the cameras."""
    p_B = p_G @ exp_so3(axis * time_s).T + np.array([0.02, 0.01, 0.5])
    p_C = transform_points(inverse_pose(X_BC), p_B)
    pixels = FOCAL_PX * p_C[:, :2] / p_C[:, 2:] + np.array([319.5, 239.5])
    return np.asarray(pixels + rng.normal(0.0, NOISE_PX, pixels.shape))


def matches(dt_s: float, axis: Array, seed: int = 1, wrong: float = 0.1) -> list[StereoMatches]:
    """Pairs whose right images were taken dt later."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(6):
        p_G = rng.uniform(-0.08, 0.08, (120, 3))
        t = k * INTERVAL_S
        left = seen(RIG.left.X_BC, p_G, axis, t, rng)
        right = [
            seen(RIG.right.X_BC, p_G, axis, t + dt_s + step * INTERVAL_S, rng) for step in (0.0, -1.0, 1.0)
        ]
        for points in right:
            bad = rng.random(len(points)) < wrong
            points[bad] = rng.uniform([200.0, 100.0], [440.0, 380.0], (int(bad.sum()), 2))
        out.append(StereoMatches(left, right[0], right[1], right[2], -INTERVAL_S, INTERVAL_S))
    return out


@pytest.mark.parametrize("frames", [-0.4, 0.0, 0.1, 0.4, 0.9])
def test_the_offset_is_found_where_the_motion_shows_it(frames: float) -> None:
    axis = np.array([0.3, 0.1, 0.15])
    found = clock_offset(matches(frames * INTERVAL_S, axis), RIG, INTERVAL_S)
    assert found is not None and found.is_observable
    assert abs(found.dt_s - frames * INTERVAL_S) < 0.02 * INTERVAL_S
    assert found.is_apart == (frames != 0.0)


@pytest.mark.parametrize(("frames", "turn_rad"), [(0.4, 0.4), (-0.2, 0.4), (0.0, 0.4), (0.4, 0.1)])
def test_the_stated_sigma_covers_the_error_also_of_fast_turns(frames: float, turn_rad: float) -> None:
    axis = np.array([0.3, 0.1, 0.15]) * turn_rad / (0.35 * INTERVAL_S)
    scaled = []
    for seed in range(8):
        found = clock_offset(matches(frames * INTERVAL_S, axis, seed), RIG, INTERVAL_S)
        assert found is not None and found.is_observable
        assert found.noise_s <= found.sigma_s
        scaled.append((found.dt_s - frames * INTERVAL_S) / found.sigma_s)
    assert 0.4 < np.sqrt(np.mean(np.square(scaled))) < 1.6


def test_what_is_no_offset_is_none() -> None:
    rig_axis = np.array([0.0, 0.0, 0.0])
    found = clock_offset(matches(0.2, rig_axis), RIG, INTERVAL_S)
    assert found is None or not found.is_observable or not found.is_apart
    # a calibration that is slightly wrong is no offset
    pitched = Rig(RIG.left, Camera(**{**vars(RIG.right), "intrinsics": (FOCAL_PX, FOCAL_PX, 319.5, 241.5)}))
    found = clock_offset(matches(0.0, np.array([0.3, 0.1, 0.15])), pitched, INTERVAL_S)
    assert found is not None and not found.is_apart
    # pairs that contradict each other widen the sigma
    axis = np.array([0.3, 0.1, 0.15])
    alike = clock_offset(matches(0.0, axis), RIG, INTERVAL_S)
    shaken = [matches(dt * INTERVAL_S, axis)[k] for k, dt in enumerate((0.1, -0.1, 0.1, -0.1, 0.1, -0.1))]
    apart = clock_offset(shaken, RIG, INTERVAL_S)
    assert alike is not None and apart is not None
    assert apart.sigma_s > 3.0 * alike.sigma_s and not apart.is_apart


def test_exchanged_cameras_are_named() -> None:
    found = matches(0.0, np.array([0.3, 0.1, 0.15]))
    require_order(found, RIG, "a.bag")
    exchanged = [
        StereoMatches(each.right_px, each.left_px, each.left_px, each.left_px, -INTERVAL_S, INTERVAL_S)
        for each in found
    ]
    with pytest.raises(InputError, match=r"^a.bag: the cameras are exchanged: \d+ features fit"):
        require_order(exchanged, RIG, "a.bag")


def test_features_of_images_are_matched_and_images_without_any_are_none() -> None:
    rng = np.random.default_rng(3)
    texture = (255.0 * rng.random((60, 80))).repeat(4, axis=0).repeat(4, axis=1).astype(np.uint8)
    frames = {
        (camera, k): np.roll(texture, (3 * k, 12 * (1 - camera)), (0, 1))
        for camera in (0, 1)
        for k in range(3)
    }
    found = match_some(lambda camera, k: frames[camera, k], 10**9 * np.arange(3, dtype=np.int64))
    assert len(found) == 1 and len(found[0].left_px) > 100
    np.testing.assert_allclose(np.median(found[0].left_px - found[0].right_px, axis=0), [12.0, 0.0], atol=0.1)
    np.testing.assert_allclose(
        np.nanmedian(found[0].after_px - found[0].right_px, axis=0), [0.0, 3.0], atol=0.1
    )
    black = np.zeros((240, 320), dtype=np.uint8)
    empty = match_some(lambda camera, k: black, 10**9 * np.arange(3, dtype=np.int64))
    assert len(empty[0].left_px) == 0 and clock_offset(empty, RIG, 1.0) is None
