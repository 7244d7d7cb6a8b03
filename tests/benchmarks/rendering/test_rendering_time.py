"""The clock of the renderer: what it counts."""

from dataclasses import replace

from benchmarks.rendering.rendering_time import lumpy_ball, machine, measure
from polhode.config.scene_settings import Render, Rig, Scene
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.raycast import RayCaster


def test_a_pair_takes_longer_than_its_rays_and_the_caster_is_left_as_it_was() -> None:
    scene = Scene(
        frames=3,
        truth_horizon_s=0.0,
        rig=Rig(width_px=64, height_px=48, focal_px=46.0),
        render=Render(samples=1, bounces=0),
    )
    plan = replace(plan_sequence(scene, 0), body=lumpy_ball(3))
    method = RayCaster.first_hits
    timing = measure(plan, 2)
    assert RayCaster.first_hits is method
    assert 0.0 < timing.casting < 1.0 and timing.pair_s > 0.0
    assert timing.row().startswith("| 1,280 | 1 | 0 | ")


def test_the_machine_has_a_name() -> None:
    assert "Python 3" in machine()
