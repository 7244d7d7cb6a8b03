"""The background against its laws: stars, the Earth's place, light and cover, the wall's parallax."""

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.render import RenderedLight
from polhode.simulation.sky import Earth, Sky, Stars, Wall, image_of_stars, star_field
from polhode.simulation.stereo_camera import Camera, build_cameras

AT_REST = np.eye(4)[None]


def _camera(**changes: object) -> Camera:
    values = {"width_px": 96, "height_px": 72, "focal_px": 70.0, **changes}
    return build_cameras(config.Rig.model_validate(values))[0]


def _stars_at(camera: Camera, uv: Array, magnitude: float = 0.0) -> Stars:
    return Stars(camera.directions(uv), np.full(len(uv), magnitude))


def _black(camera: Camera, covered: float = 0.0) -> RenderedLight:
    shape = (camera.height_px, camera.width_px)
    return RenderedLight(np.zeros(shape), np.full(shape, covered))


def test_stars_follow_the_catalogue_evenly_and_a_fainter_limit_only_adds() -> None:
    magnitude = np.concatenate([star_field(6.5, seed).magnitude for seed in range(8)])
    for limit, count in ((3.0, 171), (5.0, 1602), (6.5, 9096)):
        assert np.count_nonzero(magnitude < limit) / 8 == pytest.approx(count, rel=0.15)
    few, many = star_field(4.0, 3), star_field(6.5, 3)
    assert np.linalg.norm(many.direction_N.mean(axis=0)) < 4 / np.sqrt(len(many.magnitude))
    np.testing.assert_array_equal(many.direction_N[: len(few.magnitude)], few.direction_N)
    np.testing.assert_array_equal(many.magnitude[: len(few.magnitude)], few.magnitude)
    with pytest.raises(InputError, match=r"faintest_magnitude: 12 is fainter than 10"):
        star_field(12.0, 3)


@pytest.mark.parametrize("blur_px", [0.0, 0.4, 1.2])
def test_a_star_keeps_its_light_and_place_wherever_it_falls_in_a_pixel(blur_px: float) -> None:
    camera = _camera(distortion=(-0.2, 0.05, 1e-3, -5e-4))
    v, u = np.mgrid[:72, :96]
    light = []
    for place in ([40.0, 30.0], [40.3, 30.8], [55.5, 20.5]):
        image = image_of_stars(
            _stars_at(camera, np.array([place])), camera, AT_REST, blur_px, np.zeros((72, 96))
        )
        light.append(image.sum())
        if blur_px > 0.3:
            centroid = [(image * u).sum() / image.sum(), (image * v).sum() / image.sum()]
            np.testing.assert_allclose(centroid, place, atol=0.03)
    np.testing.assert_allclose(light, light[0], rtol=1e-4)


def test_stars_smear_when_the_camera_turns_fast_and_the_target_covers_them() -> None:
    camera = _camera()
    stars = _stars_at(camera, np.array([[40.0, 30.0]]))
    turned = [make_pose(exp_so3([0.0, -shift / 70.0, 0.0]), np.zeros(3)) for shift in (2.0, 4.0, 6.0, 8.0)]
    image = image_of_stars(stars, camera, np.stack(turned), 0.4, np.zeros((72, 96)))
    assert image[30, 40] < 0.05
    assert np.count_nonzero(image[30] > 0.1) == 4
    u = np.arange(96)
    assert (image.sum(axis=0) * u).sum() / image.sum() == pytest.approx(45.0, abs=0.2)
    camera = _camera()
    covered = np.zeros((72, 96))
    covered[:, 48:] = 1.0
    uv = np.array([[20.0, 30.0], [70.0, 30.0]])
    image = image_of_stars(_stars_at(camera, uv), camera, AT_REST, 0.4, covered)
    assert image[30, 20] == pytest.approx(1.0)
    assert image[:, 60:].max() == 0.0


def _earth(seed: int = 3, **light: object) -> Earth:
    values = {"earth": 0.3, "earth_direction_N": (0, 0, 1), "earth_radius_deg": 20, **light}
    return Earth(config.Light.model_validate(values), seed)


def test_the_earths_disc_has_its_radius_its_radiance_and_a_dark_side() -> None:
    camera = _camera()
    level = _earth(sun_direction_N=(0.0, 0.0, -1.0)).level(camera, np.eye(4), 0.0)
    angle_deg = np.rad2deg(np.arccos(camera.pixel_directions[:, 2])).reshape(72, 96)
    assert (level[angle_deg < 20] > 0.02).all()
    assert (level[angle_deg > 20 + 2.0] < 1e-3).all()
    camera = _camera()
    means = []
    for seed in range(8):
        earth = _earth(seed, sun_direction_N=(0, 0, -1))
        disc = earth.hides(camera.pixel_directions).reshape(72, 96)
        means.append(earth.level(camera, np.eye(4), 0.0)[disc].mean())
    assert np.mean(means) == pytest.approx(0.3, rel=0.1)
    camera = _camera()
    level = _earth(sun_direction_N=(1.0, 0.0, 0.0)).level(camera, np.eye(4), 0.0)
    assert level[20:52, 50:70].mean() > 0.02
    assert level[20:52, :40].max() < 1e-3
    with pytest.raises(InputError, match="earth_radius_deg: 90 degrees"):
        _earth(earth_radius_deg=90.0)


def test_the_limb_fades_above_the_ground_as_the_air_does() -> None:
    """Light beyond the edge falls, and by e in one scale height, 8 km, where the air is thin."""
    camera = _camera(focal_px=4000.0)
    level = _earth(sun_direction_N=(0, 0, -1)).level(
        camera, make_pose(exp_so3([np.deg2rad(20.4), 0, 0]), np.zeros(3)), 0.0
    )
    column = level[:, 48]
    rays = camera.pixel_directions.reshape(72, 96, 3)[:, 48]
    assert (np.diff(column[column > 1e-6]) != 0).all()
    angle = np.arccos(np.clip(rays @ exp_so3([np.deg2rad(20.4), 0, 0]).T[:, 2], -1, 1))
    height_km = (np.sin(angle) / np.sin(np.deg2rad(20)) - 1) * 6371
    thin = (height_km > 45) & (height_km < 90)
    assert np.count_nonzero(thin) > 5
    slope = np.polyfit(height_km[thin], np.log(column[thin]), 1)[0]
    assert slope == pytest.approx(-1 / 8, rel=0.05)


def test_an_eclipse_darkens_the_earth_and_leaves_the_stars() -> None:
    scene = Scene.model_validate(
        {
            "rig": {"width_px": 96, "height_px": 72, "focal_px": 70.0},
            "light": {"earth_direction_N": [0, 1, 1], "eclipse": {"start_s": 5, "duration_s": 5}},
            "background": {"earth": True, "stars": True},
        }
    )
    camera, sky = _camera(), Sky(scene, 3)
    day, _ = sky.background(_black(camera), camera, np.eye(4), 0.0)
    night, stars = sky.background(_black(camera), camera, np.eye(4), 7.0)
    assert day.max() > 0.05
    assert night.max() == 0.0
    assert stars is not None
    disc = _earth(earth_direction_N=(0, 1, 1), earth_radius_deg=66).hides(camera.pixel_directions)
    assert stars.max() > 0
    assert stars[disc.reshape(72, 96)].sum() < 0.05 * stars.sum()


def test_the_target_stands_before_the_earth_and_a_sky_that_nobody_asked_for_changes_nothing() -> None:
    scene = Scene.model_validate({"light": {"earth_direction_N": [0, 0, 1]}, "background": {"earth": True}})
    camera, sky = _camera(), Sky(scene, 3)
    free, _ = sky.background(_black(camera), camera, np.eye(4), 0.0)
    half, _ = sky.background(_black(camera, 0.5), camera, np.eye(4), 0.0)
    np.testing.assert_allclose(half, 0.5 * free)
    np.testing.assert_array_equal(sky.background(_black(camera, 1.0), camera, np.eye(4), 0.0)[0], 0.0)
    camera, picture = _camera(), _black(_camera())
    level, stars = Sky(Scene(), 3).background(picture, camera, np.eye(4), 0.0)
    assert level is picture.level
    assert stars is None


RIG = config.Rig(width_px=96, height_px=72, focal_px=70.0, baseline_m=0.2)
STANDING = np.eye(4)
LEFT, RIGHT = build_cameras(RIG)


def _wall(**changes: object) -> Wall:
    return Wall(config.Wall.model_validate({"distance_m": 2.0, **changes}), 3)


def _view(wall: Wall, camera: Camera, X_NC: Array = STANDING) -> Array:
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
