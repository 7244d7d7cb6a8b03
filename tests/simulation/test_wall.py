"""The wall behind the target: its parallax, its place, and what it hides; the Earth has none."""

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.render import RenderedLight
from polhode.simulation.sky import Sky
from polhode.simulation.stereo_camera import Camera, build_cameras
from polhode.simulation.wall import Wall

RIG = config.Rig(width_px=96, height_px=72, focal_px=70.0, baseline_m=0.2)
AT_REST = np.eye(4)
LEFT, RIGHT = build_cameras(RIG)


def _wall(**changes: object) -> Wall:
    return Wall(config.Wall.model_validate({"distance_m": 2.0, **changes}), 3)


def _view(wall: Wall, camera: Camera, X_NC: Array = AT_REST) -> Array:
    return wall.level(camera, X_NC @ camera.X_CK)[0]


def test_parallax_of_the_pattern_is_that_of_its_distance() -> None:
    """Focal length times baseline over distance: 7 px at 2 m."""
    left, right = (_view(_wall(), camera) for camera in (LEFT, RIGHT))
    np.testing.assert_allclose(right[:, :-7], left[:, 7:], atol=1e-9)
    assert left.std() > 0.2 * left.mean()
    assert abs(right - left).mean() > 0.1 * left.mean()
    wall = _wall()
    before, after = _view(wall, LEFT), _view(wall, LEFT, make_pose(np.eye(3), [0.0, 0.2, 0.0]))
    np.testing.assert_allclose(after[:-7], before[7:], atol=1e-9)


def test_a_turned_wall_is_nearer_on_one_side_and_has_an_end() -> None:
    wall = _wall(turn_deg=(0.0, 20.0, 0.0))
    p_N = np.array([[-0.5, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, 0.0, 2.0]])
    behind = wall.depth_behind(p_N)
    assert behind[2] == pytest.approx(0.0, abs=1e-12)
    assert behind[0] - behind[1] == pytest.approx(np.sin(np.deg2rad(20.0)))
    wall = _wall(turn_deg=(0.0, 80.0, 0.0))
    level, there = wall.level(LEFT, np.eye(4))
    assert 0.0 < there.mean() < 1.0
    assert level[there == 0.0].max() == 0.0
    assert level[there == 1.0].min() > 0.0


def test_the_wall_hides_the_sky_and_the_target_hides_the_wall() -> None:
    scene = Scene.model_validate(
        {
            "light": {"earth_direction_N": [0, 0, 1], "earth": 0.3},
            "background": {"earth": True, "stars": True, "wall": {"distance_m": 2.0}},
        }
    )
    sky, shape = Sky(scene, 3), (72, 96)
    free = RenderedLight(np.zeros(shape), np.zeros(shape))
    level, stars = sky.background(free, LEFT, np.eye(4), 0.0)
    assert sky.wall is not None
    np.testing.assert_array_equal(level, sky.wall.level(LEFT, np.eye(4))[0])
    assert stars is not None and stars.max() == 0.0
    full = RenderedLight(np.full(shape, 0.5), np.ones(shape))
    np.testing.assert_array_equal(sky.background(full, LEFT, np.eye(4), 0.0)[0], 0.5)


def test_the_earth_has_no_parallax_and_passes_below_as_the_orbit_goes_on() -> None:
    values = {"earth_direction_N": [0, 0.9, 0.6], "earth": 0.3, "sun_direction_N": [0, 0, -1]}
    black = RenderedLight(np.zeros((72, 96)), np.zeros((72, 96)))

    def seen(camera: Camera, t_s: float, **changes: object) -> Array:
        light = {**values, **changes}
        scene = Scene.model_validate({"light": light, "background": {"earth": True}})
        return Sky(scene, 3).background(black, camera, camera.X_CK, t_s)[0]

    start = seen(LEFT, 0.0)
    np.testing.assert_array_equal(seen(RIGHT, 0.0), start)
    np.testing.assert_array_equal(seen(LEFT, 20.0), start)
    rate = (0.0, 0.0, 0.5)
    later = seen(LEFT, 20.0, earth_rate_deg_s=rate)
    turned = exp_so3(np.deg2rad(np.array(rate)) * 20.0) @ np.array(values["earth_direction_N"])
    np.testing.assert_allclose(later, seen(LEFT, 0.0, earth_direction_N=turned.tolist()), atol=1e-9)
    assert abs(later - start).max() > 0.05


def test_a_wall_before_the_target_is_refused() -> None:
    scene = Scene.model_validate(
        {
            "frames": 2,
            "truth_horizon_s": 0,
            "motion": {"position_m": [0, 0, 1.0]},
            "background": {"wall": {"distance_m": 0.8}},
        }
    )
    with pytest.raises(InputError, match=r"background\.wall: the target reaches the wall or is behind it"):
        plan_sequence(scene, 1)
