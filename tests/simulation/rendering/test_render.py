"""Pictures: what moves blurs, what is lit shows."""

import numpy as np

from polhode.config import scene_settings as config
from polhode.geometry.lie import exp_so3, make_pose
from polhode.simulation.bodies import build_body
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import build_cameras

SCENE = config.Scene(
    rig=config.Rig(width_px=96, height_px=72, focal_px=90.0), render=config.Render(samples=4, bounces=0)
)
LEFT, _ = build_cameras(SCENE.rig)
X_NG = make_pose(np.eye(3), [0.0, 0.0, 0.6])


def test_one_pose_per_sample_averages_the_pictures_and_motion_together_keeps_the_outline() -> None:
    """A body that jumps between two places for half of the samples each covers both, by halves.

    Camera and body move together: the outline stays, only the light turns.
    """
    renderer = Renderer(build_body(SCENE.body, 3), SCENE, 3)
    shifts = np.array([-0.14, -0.14, 0.14, 0.14])
    moving = np.stack([make_pose(np.eye(3), [x, 0.0, 0.6]) for x in shifts])
    blurred = renderer.picture(LEFT, np.eye(4), moving)
    assert blurred.covered.max() <= 0.5
    ends = [renderer.picture(LEFT, np.eye(4), pose) for pose in moving[::2]]
    expected = [0.5 * picture.covered.sum() for picture in ends]
    assert abs(blurred.covered.sum() / sum(expected) - 1.0) < 0.01
    assert abs(blurred.level.sum() / sum(0.5 * picture.level.sum() for picture in ends) - 1.0) < 0.02
    renderer = Renderer(build_body(SCENE.body, 3), SCENE, 3)
    repeated = np.broadcast_to(X_NG, (4, 4, 4))
    still, held = renderer.picture(LEFT, np.eye(4), X_NG), renderer.picture(LEFT, np.eye(4), repeated)
    np.testing.assert_array_equal(still.level, held.level)
    renderer = Renderer(build_body(SCENE.body, 3), SCENE, 3)
    turn = np.stack([make_pose(np.eye(3), [x, 0.0, 0.0]) for x in (-0.3, -0.1, 0.1, 0.3)])
    still, moved = renderer.picture(LEFT, np.eye(4), X_NG), renderer.picture(LEFT, turn, turn @ X_NG)
    np.testing.assert_allclose(moved.covered, still.covered, atol=0.26)
    np.testing.assert_allclose(moved.level.sum(), still.level.sum(), rtol=1e-3)


def test_nothing_is_seen_in_the_eclipse_without_a_lamp() -> None:
    light = config.Light(eclipse=config.Eclipse(start_s=10.0, duration_s=5.0))
    dark = SCENE.model_copy(update={"light": light})
    renderer = Renderer(build_body(SCENE.body, 3), dark, 3)
    assert renderer.picture(LEFT, np.eye(4), X_NG, t_s=12.0).level.max() == 0.0
    assert renderer.picture(LEFT, np.eye(4), X_NG, t_s=0.0).level.max() > 0.2


def test_a_picture_does_not_depend_on_what_was_rendered_before() -> None:
    """Indirect light is kept from picture to picture; the next picture must not show it."""
    scene = SCENE.model_copy(update={"render": config.Render(samples=4, bounces=1)})
    used, fresh = (Renderer(build_body(scene.body, 3), scene, 3) for _ in range(2))
    turned = make_pose(exp_so3([0.0, 0.002, 0.0]), [0.0, 0.0, 0.6])
    used.picture(LEFT, np.eye(4), turned)
    for renderer in (used, used, fresh):
        picture = renderer.picture(LEFT, np.eye(4), X_NG)
        assert picture.level.tobytes() == fresh.picture(LEFT, np.eye(4), X_NG).level.tobytes()


def test_a_bounce_adds_light_and_never_takes_any_away_from_a_matt_body() -> None:
    """On the rocky body, which mirrors nothing: more light in its hollows, the same elsewhere."""
    body = build_body(config.TargetBody(family="asteroid"), 3)
    direct, bounced = (
        Renderer(body, SCENE.model_copy(update={"render": config.Render(samples=4, bounces=bounces)}), 3)
        .picture(LEFT, np.eye(4), X_NG)
        .level
        for bounces in (0, 1)
    )
    assert (bounced - direct).min() > -1e-12
    assert 1.005 < bounced.sum() / direct.sum() < 1.2


def test_scattered_rays_show_the_same_body_and_the_same_picture_twice() -> None:
    rows = SCENE.model_copy(update={"render": config.Render(samples=4, bounces=0, scattered=False)})
    body = build_body(SCENE.body, 3)
    regular = Renderer(body, rows, 3).picture(LEFT, np.eye(4), X_NG)
    first, again = (Renderer(body, SCENE, 3).picture(LEFT, np.eye(4), X_NG) for _ in range(2))
    np.testing.assert_array_equal(first.level, again.level)
    assert abs(first.covered.sum() / regular.covered.sum() - 1.0) < 0.02
    inside = (first.covered == 1.0) & (regular.covered == 1.0)
    assert np.median(np.abs(first.level - regular.level)[inside]) < 0.02
    assert (first.level != regular.level).any()
