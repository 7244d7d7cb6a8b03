"""The simulated range sensor against the truth: bias and noise, edges, mixed pixels, flat angles."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from polhode.config.scene_settings import RangeSensor, Scene
from polhode.geometry.lie import Array, inverse_pose
from polhode.records.dataset import open_sequence
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.dataset.range_images import MAX_UNITS, measure, true_depth
from polhode.simulation.dataset.resumable_dataset import why_not_ours
from polhode.simulation.dataset.sequence import simulate
from polhode.simulation.rendering.raycast import RayCaster

FOCAL_PX, STEP_AT = 200.0, 60
SENSOR = RangeSensor(sigma_m=0.003, growth_per_m=0.002, scale_m=1e-4)


def step(near_m: float = 1.0, far_m: float = 1.4) -> Array:
    """A near and a far plane side by side, before nothing (80, 120)."""
    depth = np.full((80, 120), np.nan)
    depth[10:70, 10:STEP_AT], depth[10:70, STEP_AT:110] = near_m, far_m
    return depth


def measured_m(depth_m: Array, sensor: RangeSensor, seed: int = 0, cosine: float = 1.0) -> Array:
    facing = np.where(np.isfinite(depth_m), cosine, np.nan)
    raw = measure(depth_m, facing, FOCAL_PX, sensor, np.random.default_rng(seed))
    assert raw.dtype == np.uint16
    return np.where(raw > 0, raw * sensor.scale_m, np.nan)


def test_noise_has_no_bias_and_the_stated_sigma() -> None:
    depth = step()
    off = measured_m(depth, SENSOR) - depth
    for part, range_m in ((off[12:68, 12:58], 1.0), (off[12:68, 62:108], 1.4)):
        sigma = np.hypot(0.003, 0.002 * range_m**2)
        assert np.isfinite(part).all()
        assert abs(part.mean()) < 4.0 * sigma / np.sqrt(part.size)
        assert part.std() == pytest.approx(sigma, rel=4.0 / np.sqrt(2.0 * part.size))
        assert abs(np.corrcoef(part[:, :-1].ravel(), part[:, 1:].ravel())[0, 1]) < 4.0 / np.sqrt(part.size)


def test_a_share_of_the_pixels_at_edges_is_lost_and_no_other() -> None:
    depth, sensor = step(), SENSOR.model_copy(update={"edge_dropouts": 0.4})
    lost = np.mean([np.isnan(measured_m(depth, sensor, seed)) for seed in range(40)], axis=0)
    inside = np.isfinite(depth)
    edge = np.zeros_like(inside)
    edge[[10, 69], 10:110] = edge[10:70, [10, 109]] = edge[10:70, STEP_AT - 1 : STEP_AT + 1] = True
    assert lost[edge].mean() == pytest.approx(0.4, abs=4.0 * np.sqrt(0.24 / (40 * edge.sum())))
    assert lost[inside & ~edge].max() == 0.0
    assert lost[~inside].min() == 1.0


def test_mixed_pixels_lie_between_the_two_surfaces_of_an_edge() -> None:
    sensor = SENSOR.model_copy(update={"edge_dropouts": 0.0, "mixed_pixels": 0.5, "growth_per_m": 0.0})
    depth = step()
    stack = np.stack([measured_m(depth, sensor, seed) for seed in range(40)])
    off = np.abs(stack - depth)
    beside = np.zeros(depth.shape, dtype=bool)
    beside[10:70, STEP_AT - 1 : STEP_AT + 1] = True
    off_edge = off[:, np.isfinite(depth) & ~beside]
    assert off_edge.max() < 6.0 * 0.003
    at_step = stack[:, 10:70, STEP_AT - 1 : STEP_AT + 1]
    assert at_step.min() > 1.0 - 6.0 * 0.003 and at_step.max() < 1.4 + 6.0 * 0.003
    between = (at_step > 1.02) & (at_step < 1.38)
    # of the half that is mixed, 0.36 of 0.40 m lie so far from both surfaces
    assert between.mean() == pytest.approx(0.45, abs=4.0 * np.sqrt(0.25 / at_step.size))


def test_surfaces_at_flat_angles_and_beyond_the_largest_unit_return_nothing() -> None:
    depth = step()
    assert np.isnan(measured_m(depth, SENSOR, cosine=np.cos(np.deg2rad(81.0)))).all()
    assert np.isfinite(measured_m(depth, SENSOR, cosine=np.cos(np.deg2rad(79.0)))[30, 30])
    small = SENSOR.model_copy(update={"scale_m": 1.2 / MAX_UNITS})
    seen = measured_m(depth, small)
    assert np.isfinite(seen[30, 30]) and np.isnan(seen[30, 90])


def scene(**changes: object) -> Scene:
    sensor = RangeSensor(edge_dropouts=0.0, mixed_pixels=0.0)
    return Scene.model_validate(
        {
            "frames": 3,
            "truth_horizon_s": 1.0,
            "body": {"family": "cubesat", "size_m": 0.3},
            "motion": {"position_m": [0.0, 0.0, 0.8]},
            "rig": {"width_px": 96, "height_px": 72, "focal_px": 90.0, "distortion": [-0.1, 0.01, 0.0, 0.0]},
            "render": {"samples": 1, "bounces": 0},
            "range_sensor": sensor.model_dump() | {"enabled": True},
            **changes,
        }
    )


def test_a_simulated_sequence_holds_ranges_instead_of_the_second_camera(tmp_path: Path) -> None:
    plan = simulate(scene(), 3, tmp_path / "S", Silent())
    mav0 = tmp_path / "S" / "mav0"
    assert sorted(path.name for path in mav0.iterdir()) == ["cam0", "range0", "target0"]
    assert why_not_ours(tmp_path / "S") == ""
    sequence = open_sequence(tmp_path / "S")
    assert sequence.has_ranges and len(sequence) == 3 and sequence.warnings == ()
    X_GK = inverse_pose(plan.target.X_NG[1]) @ plan.X_NC[1]
    depth, _ = true_depth(RayCaster(plan.body), plan.cameras[0], X_GK)
    off = sequence.read_range(1) - depth
    known = np.isfinite(off)
    assert known.sum() > 0.9 * np.isfinite(depth).sum() > 300
    assert off[known].std() == pytest.approx(0.003, rel=0.15)
    with Image.open(mav0 / "range0" / "data" / f"{sequence.timestamps_ns[1]}.png") as image:
        assert image.mode.startswith("I;16")


def test_a_target_beyond_the_ranges_that_16_bits_hold_is_refused() -> None:
    with pytest.raises(InputError, match=r"scale_m: 1e-06 m makes ranges up to 0.0655 m, the target is"):
        plan_sequence(scene(range_sensor={"enabled": True, "scale_m": 1e-6}), 3)
