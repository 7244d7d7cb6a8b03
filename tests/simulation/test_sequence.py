"""The dataset as a whole: read back, repeated, refused; images against truth."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.ndimage import map_coordinates
from scipy.optimize import minimize_scalar

from polhode.config import scene as config
from polhode.config.loader import load_config
from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.lie import Array, inverse_pose, make_pose, transform_points
from polhode.progress import Silent
from polhode.truth import read_truth
from simulation.bodies.build import build_body
from simulation.cameras import build_cameras
from simulation.render import Renderer
from simulation.sequence import plan_sequence, simulate

CONFIGS = Path(__file__).parents[2] / "configs"
SMALL = {"width_px": 80, "height_px": 60, "focal_px": 60.0}


def _scene(**changes: object) -> config.Scene:
    values = {
        "frames": 3,
        "truth_horizon_s": 1.0,
        "rig": SMALL,
        "motion": {"position_m": [0.04, 0.0, 0.6], "spin_rpm": [1.0, 9.0, 0.0]},
        **changes,
    }
    return config.Scene.model_validate(values)


def _bytes(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_bytes_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    simulate(_scene(), 4, tmp_path / "one", Silent(), workers=1)
    simulate(_scene(), 4, tmp_path / "two", Silent(), workers=2)
    assert _bytes(tmp_path / "one") == _bytes(tmp_path / "two")


def test_a_sequence_reads_back_with_its_truth(tmp_path: Path) -> None:
    scene = _scene(render={"masks": True})
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


@pytest.mark.parametrize("depth_m", [0.6, 0.75])
def test_disparity_of_a_rendered_pattern_is_that_of_its_depth(tmp_path: Path, depth_m: float) -> None:
    path = tmp_path / "plate.stl"
    trimesh.creation.box([0.5, 0.4, 0.02]).export(path)
    body_config = config.Body(family="mesh", path=str(path), metres_per_unit=1.0)
    scene = _scene(body=body_config, rig={"width_px": 160, "height_px": 120, "focal_px": 120.0})
    left, right = build_cameras(scene.rig)
    renderer = Renderer(build_body(body_config, 1), scene, 1)
    X_NG = make_pose(np.eye(3), [0.045, 0.0, depth_m])
    seen_left, seen_right = (renderer.picture(camera, camera.X_CK, X_NG).level for camera in (left, right))
    truth_px = 120.0 * 0.09 / (depth_m - 0.01)
    assert _disparity(seen_left, seen_right, truth_px) == pytest.approx(truth_px, abs=0.05)


def _disparity(left: Array, right: Array, guess_px: float) -> float:
    """Shift of the middle of the image that leaves the least squares, gain and offset free."""
    v, u = np.mgrid[40:80, 60:100].astype(float)
    patch = left[40:80, 60:100]

    def misfit(disparity_px: float) -> float:
        moved = map_coordinates(right, [v, u - disparity_px], order=3)
        return -float(np.corrcoef(moved.ravel(), patch.ravel())[0, 1])

    return float(minimize_scalar(misfit, bounds=(guess_px - 1, guess_px + 1), method="bounded").x)


def test_an_existing_folder_is_kept_unless_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "S"
    folder.mkdir()
    (folder / "precious").write_text("x")
    with pytest.raises(InputError, match="exists"):
        simulate(_scene(frames=1), 4, folder, Silent())
    assert [p.name for p in tmp_path.iterdir()] == ["S"]
    simulate(_scene(frames=1), 4, folder, Silent(), overwrite=True)
    assert sorted(p.name for p in folder.iterdir()) == ["mav0"]


def test_a_scene_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        simulate(_scene(rig={**SMALL, "distortion": [-9.0, 0, 0, 0]}), 4, tmp_path / "S", Silent())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("position_m", "message"),
    [
        ((0.0, 0.0, -0.6), "never in view"),
        ((5.0, 0.0, 0.6), "never in view"),
        ((0.0, 0.0, 0.1), "reaches the camera"),
    ],
)
def test_a_target_that_cannot_be_seen_is_refused(position_m: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan_sequence(_scene(motion={"position_m": position_m}), 4)


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
