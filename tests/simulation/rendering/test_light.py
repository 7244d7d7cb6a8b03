"""Lights in the body's frame, and the eclipse."""

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.geometry.lie import exp_so3, inverse_pose, make_pose
from polhode.simulation.rendering.light import lights_in_body, sunlight

ECLIPSE = config.Light(eclipse=config.Eclipse(start_s=10.0, duration_s=8.0, ramp_s=2.0))


def test_lights_are_fixed_in_N_and_turn_in_the_body() -> None:
    """A body turned by R sees the Sun turned by R^T, at unit length."""
    X_NG = make_pose(exp_so3([0.0, 0.0, np.pi / 2]), [0.0, 0.0, 0.6])
    lights = lights_in_body(config.Light(sun_direction_N=(3, 0, 0)), inverse_pose(X_NG), np.eye(4))
    np.testing.assert_allclose(lights.sun_direction_G, [0, -1, 0], atol=1e-12)


def test_the_eclipse_is_dark_for_its_duration_fades_smoothly_and_spares_the_lamp() -> None:
    assert [sunlight(ECLIPSE, t) for t in (0.0, 8.0, 20.0, 99.0)] == [1.0] * 4
    assert [sunlight(ECLIPSE, t) for t in (10.0, 14.0, 18.0)] == [0.0] * 3
    assert sunlight(ECLIPSE, 9.0) == sunlight(ECLIPSE, 19.0) == pytest.approx(0.5)
    assert sunlight(config.Light(), 10.0) == 1.0
    share = np.array([sunlight(ECLIPSE, t) for t in np.linspace(8.0, 10.0, 201)])
    slope = np.diff(share)
    assert (slope < 0).all()
    assert max(abs(slope[0]), abs(slope[-1])) < 0.15 * np.abs(slope).max()
    light = ECLIPSE.model_copy(update={"lamp": 0.4})
    lights = lights_in_body(light, np.eye(4), np.eye(4), 12.0)
    assert (lights.sun, lights.earth, lights.lamp) == (0.0, 0.0, 0.4)


def test_coarse_lights_are_near_and_change_seldom() -> None:
    light = config.Light(lamp=0.3)
    turns = [make_pose(exp_so3([0.0, angle, 0.1]), [0.0, 0.0, 0.6]) for angle in np.linspace(0.0, 0.02, 41)]
    exact = [lights_in_body(light, inverse_pose(X), inverse_pose(X)) for X in turns]
    coarse = [lights.quantized(1 / 256, 0.001) for lights in exact]
    assert len({lights.key for lights in exact}) == 41
    assert len({lights.key for lights in coarse}) < 30
    for near, lights in zip(coarse, exact, strict=True):
        assert near.sun_direction_G @ lights.sun_direction_G > np.cos(np.deg2rad(0.25))
        assert np.abs(near.lamp_G - lights.lamp_G).max() < 0.00051
        assert near.sun == lights.sun
