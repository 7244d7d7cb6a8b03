"""The dataset as a whole: read back, repeated, refused; images against truth."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.dataset import open_sequence
from polhode.records.read_truth import read_truth
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import plan_sequence, received_frames
from polhode.simulation.dataset.sequence import simulate

CONFIGS = Path(__file__).parents[3] / "configs"
# No light by way of the body itself: it takes a second to prepare.
PLAIN: dict[str, object] = {"light": {"earth": 0.0}, "render": {"bounces": 0}}
SMALL = {"width_px": 80, "height_px": 60, "focal_px": 60.0}


def _scene(**changes: object) -> config.Scene:
    values = {
        "frames": 3,
        "truth_horizon_s": 1.0,
        "rig": SMALL,
        "motion": {"position_m": [0.04, 0.0, 0.6], "spin_rpm": [1.0, 9.0, 0.0]},
        **PLAIN,
        **changes,
    }
    return config.Scene.model_validate(values)


def _bytes(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_bytes_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    scene = _scene(
        inspector={"profile": "drift", "rate_deg_s": [0, 2, 0], "deadband_mm": 3.0, "sigma_p_m": 1e-3},
        background={"stars": True, "earth": True},
        light={"earth_direction_N": [0, 0.5, 1]},
        sensor={"bits": 10, "glare": 0.1, "bloom": 0.5, "full_well_dn": 200.0, "drop_probability": 0.2},
        render={"masks": True, "products": ["depth", "shadow"]},
    )
    simulate(scene, 4, tmp_path / "one", Silent(), workers=1)
    simulate(scene, 4, tmp_path / "two", Silent(), workers=2)
    assert _bytes(tmp_path / "one") == _bytes(tmp_path / "two")


def test_a_sequence_reads_back_with_its_truth(tmp_path: Path) -> None:
    scene = _scene(render={"masks": True, "bounces": 0})
    simulate(scene, 4, tmp_path / "S", Silent())
    sequence, truth = open_sequence(tmp_path / "S"), read_truth(tmp_path / "S")
    plan = plan_sequence(scene, 4)
    assert len(sequence.timestamps_ns) == 3
    assert not sequence.dropped
    assert not sequence.warnings
    assert not sequence.inspector_moves
    np.testing.assert_array_equal(truth.timestamps_ns[:3], sequence.timestamps_ns)
    assert len(truth.timestamps_ns) == 5
    np.testing.assert_allclose(truth.r_N, plan.target.r_N, atol=0)
    np.testing.assert_allclose(truth.R_NP, plan.target.R_NP, atol=1e-14)
    assert truth.mesh is not None
    np.testing.assert_allclose(truth.mesh.bounds, plan.body.mesh.bounds, atol=1e-7)
    pair = sequence.read_pair(0)
    assert pair.mask_left is not None
    assert pair.left[pair.mask_left].mean() > 10 * pair.left[~pair.mask_left].mean()


def test_a_moving_inspectors_poses_put_the_left_camera_where_it_was(tmp_path: Path) -> None:
    scene = _scene(
        rig={**SMALL, "mount_position_m": [0.1, 0.0, -0.05], "mount_rotation_deg": [0, 90, 0]},
        inspector={"profile": "drift", "velocity_mm_s": [5, 0, 0], "rate_deg_s": [0, 0, 1]},
    )
    simulate(scene, 4, tmp_path / "S", Silent())
    sequence = open_sequence(tmp_path / "S")
    assert sequence.inspector_moves
    np.testing.assert_allclose(sequence.X_NC, plan_sequence(scene, 4).X_NC, atol=1e-12)


def test_points_of_the_target_appear_at_one_place_in_N_from_both_cameras() -> None:
    scene = _scene(rig={**SMALL, "right_rotation_deg": [0.5, -6.0, 0.8], "distortion": [-0.2, 0.05, 0, 0]})
    plan = plan_sequence(scene, 4)
    p_N = transform_points(plan.target.X_NG[2], plan.body.mesh.vertices[::97])
    rays = []
    for camera in plan.cameras:
        X_NK = plan.X_NC[2] @ camera.X_CK
        uv = camera.project(transform_points(inverse_pose(X_NK), p_N))
        rays.append((X_NK[:3, 3], camera.directions(uv) @ X_NK[:3, :3].T))
    np.testing.assert_allclose(_closest_point(*rays[0], *rays[1]), p_N, atol=1e-8)


def _closest_point(o0: Array, d0: Array, o1: Array, d1: Array) -> Array:
    """Middle of the shortest line between two bundles of rays."""
    b = np.einsum("nk,nk->n", d0, d1)
    w = o0 - o1
    d, e = d0 @ w, d1 @ w
    s, t = (b * e - d) / (1 - b**2), (e - b * d) / (1 - b**2)
    return np.asarray(0.5 * (o0 + s[:, None] * d0 + o1 + t[:, None] * d1))


def test_a_scene_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        simulate(_scene(rig={**SMALL, "distortion": [-9.0, 0, 0, 0]}), 4, tmp_path / "S", Silent())
    assert list(tmp_path.iterdir()) == []


def test_the_thesis_target_stays_in_both_images() -> None:
    scene = load_config(CONFIGS / "ts38.yaml").scene
    assert scene is not None
    plan = plan_sequence(scene, 38)
    for k in range(scene.frames):
        for camera in plan.cameras:
            X_KG = inverse_pose(plan.X_NC[k] @ camera.X_CK) @ plan.target.X_NG[k]
            uv = camera.project(transform_points(X_KG, plan.body.mesh.vertices))
            assert (uv.min(axis=0) > 10).all()
            assert (uv.max(axis=0) < (630, 470)).all()


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("scenes/*.yaml")), ids=lambda path: path.stem)
def test_every_scene_of_the_repository_can_be_planned(path: Path) -> None:
    loaded = load_config(path)
    assert loaded.scene is not None
    plan_sequence(loaded.scene.model_copy(update={"frames": 2}), loaded.seed)


def test_the_scene_file_makes_the_same_dataset_again(tmp_path: Path) -> None:
    motion = {"position_m": [0, 0, 0.6], "pushes": [{"start_s": 1}]}
    scene = _scene(sensor={"drop_probability": 0.3}, motion=motion)
    simulate(scene, 4, tmp_path / "S", Silent())
    again = load_config(tmp_path / "S" / "scene.yaml")
    assert (again.scene, again.seed) == (scene, 4)


def test_dropped_pairs_are_nowhere_but_in_the_truth(tmp_path: Path) -> None:
    scene = _scene(frames=6, sensor={"dropped_frames": [0, 3]}, render={"masks": True, "bounces": 0})
    simulate(scene, 4, tmp_path / "S", Silent())
    whole = plan_sequence(_scene(frames=6), 4).target.timestamps_ns
    sequence = open_sequence(tmp_path / "S")
    np.testing.assert_array_equal(sequence.timestamps_ns, whole[[1, 2, 4, 5]])
    assert not sequence.dropped and sequence.n_listed == 4
    lost = (str(whole[0]), str(whole[3]))
    assert not [path for path in (tmp_path / "S").rglob("*") if path.stem in lost]
    np.testing.assert_array_equal(read_truth(tmp_path / "S").timestamps_ns, whole)


def test_frames_are_lost_by_chance_as_often_as_the_scene_says() -> None:
    sensor = config.Sensor(drop_probability=0.2, dropped_frames=(7,))
    frames = received_frames(sensor, 5000, 1)
    assert len(frames) == pytest.approx(4000, abs=120)
    assert 7 not in frames
    assert frames == received_frames(sensor, 5000, 1) != received_frames(sensor, 5000, 2)
    with pytest.raises(InputError, match="leave no frame"):
        received_frames(config.Sensor(drop_probability=1.0), 10, 1)


def test_unreported_jitter_of_the_camera_is_not_written(tmp_path: Path) -> None:
    for reported in (True, False):
        inspector = {"deadband_mm": 5.0, "reported": reported}
        simulate(_scene(frames=1, inspector=inspector), 4, tmp_path / str(reported), Silent())
        assert (tmp_path / str(reported) / "mav0/inspector0").is_dir() == reported


def test_motion_blurs_the_edges_as_the_exposure_grows() -> None:
    """Motion across the silhouette: its partly covered pixels grow with the shutter's time."""
    motion = {"position_m": [0.0, 0.0, 0.6], "velocity_mm_s": [200.0, 0.0, 0.0]}
    rig = {"width_px": 160, "height_px": 120, "focal_px": 120.0}
    partly, middle = [], []
    for exposure_ms in (0.0, 100.0):
        scene = _scene(
            rig=rig, motion=motion, sensor={"exposure_ms": exposure_ms}, render={"samples": 16, "bounces": 0}
        )
        _, picture = FrameRenderer(plan_sequence(scene, 4)).render_image(1, 0)
        partly.append(np.count_nonzero((picture.covered > 0) & (picture.covered < 1)))
        u = np.arange(160)
        middle.append((picture.covered.sum(axis=0) * u).sum() / picture.covered.sum())
    # The shutter is open around the timestamp: the middle stays.
    assert middle[1] == pytest.approx(middle[0], abs=0.05)
    assert partly[1] > 1.4 * partly[0]


@pytest.mark.parametrize("bits", [10, 12])
def test_dark_images_of_more_bits_read_back_in_their_grey_values(tmp_path: Path, bits: int) -> None:
    dark = {"white_dn": 60.0, "read_noise_dn": 0.0, "electrons_per_dn": 1e4}
    simulate(_scene(sensor=dark), 4, tmp_path / "8", Silent())
    simulate(_scene(sensor={**dark, "bits": bits}), 4, tmp_path / "more", Silent())
    few, more = (open_sequence(tmp_path / name).read_pair(0).left.astype(int) for name in ("8", "more"))
    # One is rounded, the other cut off.
    assert set(np.unique(few - more)) <= {0, 1}


def test_an_eclipse_leaves_nothing_but_noise(tmp_path: Path) -> None:
    light = {"eclipse": {"start_s": 0.4, "duration_s": 0.4, "ramp_s": 0.1}}
    simulate(_scene(light=light, background={"earth": True}), 4, tmp_path / "S", Silent())
    sequence = open_sequence(tmp_path / "S")
    lit, dark = sequence.read_pair(0).left, sequence.read_pair(1).left
    assert lit.max() > 100 and dark.max() < 8
