"""The dataset as a whole: its files, the truth of every pixel; scenes that cannot be seen are refused."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image

from polhode.config import scene_settings as config
from polhode.config.loader import load_config
from polhode.config.scene_settings import Scene
from polhode.records.calibration_prior import EXACT
from polhode.records.dataset import open_sequence
from polhode.records.read_truth import read_truth
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import (
    FrameRenderer,
    products_path,
    read_products,
    render_products,
)
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence, received_frames
from polhode.simulation.dataset.sequence import simulate, stated_calibration
from polhode.simulation.rendering.render import Renderer
from tests.simulation.small_scenes import RIG, TOED_IN, files, small_scene

CONFIGS = Path(__file__).parents[3] / "configs"
ALL: tuple[config.Product, ...] = get_args(config.Product)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SequencePlan]:
    """A sequence of a toed-in rig with masks and all products."""
    folder = tmp_path_factory.mktemp("sequence") / "S"
    scene = small_scene(rig={**RIG, **TOED_IN}, render={"masks": True, "samples": 16, "products": ALL})
    return folder, simulate(scene, 4, folder, Silent())


def test_the_folder_holds_what_the_contract_names(stored: tuple[Path, SequencePlan]) -> None:
    mav0 = stored[0] / "mav0"
    stamps = [str(1_600_000_000_000_000_000 + k * 500_000_000) for k in range(3)]
    expected = {"target0/data.csv", "target0/target.yaml", "target0/mesh.ply"}
    for index in (0, 1):
        expected |= {f"cam{index}/sensor.yaml", f"cam{index}/data.csv"}
        for stamp in stamps:
            named = (f"cam{index}/data/{stamp}.png", f"masks{index}/{stamp}.png", f"truth{index}/{stamp}.npz")
            expected |= set(named)
            with Image.open(mav0 / named[0]) as image:
                assert image.mode == "L" and image.size == (80, 60) and np.asarray(image).max() > 100
    assert set(files(mav0)) == expected
    target = yaml.safe_load((mav0 / "target0/target.yaml").read_text())
    assert set(target) == {"moments", "k1", "k2", "com_G", "R_GP", "mass_kg"}
    rows = (mav0 / "target0/data.csv").read_text().splitlines()
    assert len(rows) == 1 + 3 + 2 and {len(row.split(",")) for row in rows} == {14}


def test_the_written_calibration_is_exact_or_off_by_a_draw_from_what_it_states(
    stored: tuple[Path, SequencePlan],
) -> None:
    folder, plan = stored
    exact = open_sequence(folder).calibration
    assert exact.prior is not None and exact.prior.source == EXACT
    rig = plan.scene.rig.model_copy(update={"calibration_errors": 3.0})
    wrong = plan.scene.model_copy(update={"rig": rig})
    drawn = []
    for seed in range(40):
        stated, prior = stated_calibration(replace(plan, scene=wrong, seed=seed))
        off = [exact.K0[0, 0] - stated.K0[0, 0], exact.K1[1, 2] - stated.K1[1, 2]]
        off.append(float(np.linalg.norm(exact.X_BC1[:3, 3]) - np.linalg.norm(stated.X_BC1[:3, 3])))
        sigma = dict(zip(prior.names, prior.sigma.tolist(), strict=True))
        drawn.append(np.array(off) / [sigma["cam0.fu"], sigma["cam1.cv"], sigma["cam1.p_x"]])
    assert sigma["cam1.cv"] == pytest.approx(0.3)
    assert (np.std(drawn, axis=0) > 0.7).all() and (np.std(drawn, axis=0) < 1.4).all()


def test_a_sequence_reads_back_with_its_truth(stored: tuple[Path, SequencePlan]) -> None:
    folder, plan = stored
    sequence, truth = open_sequence(folder), read_truth(folder)
    assert not sequence.dropped and not sequence.warnings and not sequence.inspector_moves
    np.testing.assert_array_equal(truth.timestamps_ns[:3], sequence.timestamps_ns)
    assert len(truth.timestamps_ns) == 5
    np.testing.assert_allclose(truth.r_N, plan.target.r_N, atol=0)
    np.testing.assert_allclose(truth.R_NP, plan.target.R_NP, atol=1e-14)
    assert truth.mesh is not None
    np.testing.assert_allclose(truth.mesh.bounds, plan.body.mesh.bounds, atol=1e-7)
    pair = sequence.read_pair(0)
    assert pair.mask_left is not None
    assert pair.left[pair.mask_left].mean() > 10 * pair.left[~pair.mask_left].mean()
    again = load_config(folder / "scene.yaml")
    assert (again.scene, again.seed) == (plan.scene, 4)


def test_products_and_masks_add_files_and_change_no_others(
    stored: tuple[Path, SequencePlan], tmp_path: Path
) -> None:
    folder, plan = stored
    simulate(small_scene(rig={**RIG, **TOED_IN}, render={"samples": 16}), 4, tmp_path / "S", Silent())
    plain, full = files(tmp_path / "S"), files(folder)
    same = plain.keys() - {"scene.yaml"}  # it says what was asked for
    assert {name: full[name] for name in same} == {name: plain[name] for name in same}
    assert {name.split("/")[1] for name in full.keys() - plain.keys()} == {
        "masks0",
        "masks1",
        "truth0",
        "truth1",
    }
    renderer = Renderer(plan.body, plan.scene, 4)
    for index, camera in enumerate(plan.cameras):
        X_NK = plan.X_NC[1] @ camera.X_CK
        truth = render_products(renderer, camera, X_NK, plan.target.X_NG[1], ALL)
        found = read_products(products_path(folder / "mav0", index, int(plan.target.timestamps_ns[1])))
        for name in ALL:
            np.testing.assert_allclose(getattr(found, name), getattr(truth, name), rtol=1e-7, atol=1e-7)


def test_the_calibration_read_back_projects_the_mesh_onto_the_images(
    stored: tuple[Path, SequencePlan],
) -> None:
    """OpenCV projects the truth's mesh with the file's calibration; silhouettes agree in both cameras."""
    folder, plan = stored
    sequence = open_sequence(folder)
    calibration, pair = sequence.calibration, sequence.read_pair(1)
    X_NB = plan.X_NC[1] @ np.linalg.inv(calibration.X_BC0)
    v, u = np.mgrid[:60, :80]
    scale = 64
    for index, (K, dist, X_BC, mask) in enumerate([
        (calibration.K0, calibration.dist0, calibration.X_BC0, pair.mask_left),
        (calibration.K1, calibration.dist1, calibration.X_BC1, pair.mask_right),
    ]):  # fmt: skip
        X_CG = np.linalg.inv(X_NB @ X_BC) @ plan.target.X_NG[1]
        uv, _ = cv2.projectPoints(
            plan.body.mesh.vertices, cv2.Rodrigues(X_CG[:3, :3])[0], X_CG[:3, 3], K, dist
        )
        # Pixel u spans [u - 1/2, u + 1/2]; the fine grid's centres are integers as well.
        corners = np.rint((uv[:, 0] + 0.5) * scale - 0.5).astype(np.int32)[plan.body.mesh.faces]
        filled = np.zeros((60 * scale, 80 * scale), np.uint8)
        for corner in corners:
            cv2.fillConvexPoly(filled, corner, 1)
        share = filled.reshape(60, scale, 80, scale).mean(axis=(1, 3))
        assert mask is not None
        assert np.count_nonzero((share >= 0.5) != mask) < 0.01 * np.count_nonzero(mask)
        covered = FrameRenderer(plan).render_image(1, index)[1].covered
        for axis in (u, v):
            middles = [(image * axis).sum() / image.sum() for image in (share, covered)]
            assert middles[0] == pytest.approx(middles[1], abs=0.02)


def test_the_bytes_do_not_depend_on_the_number_of_workers(tmp_path: Path) -> None:
    scene = small_scene(
        frames=2,
        inspector={"profile": "drift", "rate_deg_s": [0, 2, 0], "deadband_mm": 3.0, "sigma_p_m": 1e-3},
        background={"stars": True, "earth": True},
        light={"earth": 0.15, "earth_direction_N": [0, 0.5, 1]},
        sensor={"bits": 10, "glare": 0.1, "bloom": 0.5, "full_well_dn": 200.0, "drop_probability": 0.2},
        render={"bounces": 1, "masks": True, "products": ["depth", "shadow"]},
    )
    for workers in (1, 2):
        simulate(scene, 4, tmp_path / str(workers), Silent(), workers=workers)
    assert files(tmp_path / "1") == files(tmp_path / "2")


def test_inspector0_holds_what_the_inspector_reports_and_puts_the_camera_where_it_was(tmp_path: Path) -> None:
    rig = {**RIG, "mount_position_m": [0.1, 0.0, -0.05], "mount_rotation_deg": [0, 90, 0]}
    moving = {"profile": "drift", "velocity_mm_s": [5, 0, 0], "rate_deg_s": [0, 0, 1]}
    for name, inspector in [
        ("drift", moving),
        ("noisy", {**moving, "sigma_p_m": 1e-3, "sigma_theta_deg": 0.1}),
        ("jitter", {"deadband_mm": 5.0}),
        ("hidden", {"deadband_mm": 5.0, "reported": False}),
    ]:
        scene = small_scene(rig=rig, inspector=inspector)
        plan = simulate(scene, 4, tmp_path / name, Silent())
        sequence = open_sequence(tmp_path / name)
        assert sequence.inspector_moves == (name != "hidden")
        assert (tmp_path / name / "mav0/inspector0").is_dir() == (name != "hidden")
        if name == "drift":
            np.testing.assert_allclose(sequence.X_NC, plan.X_NC, atol=1e-12)
        if name == "noisy":
            assert sequence.sigma_camera_p_m == pytest.approx(1e-3)
            assert sequence.sigma_camera_theta_rad == pytest.approx(np.deg2rad(0.1))


def test_a_scene_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        simulate(small_scene(rig={**RIG, "distortion": [-9.0, 0, 0, 0]}), 4, tmp_path / "S", Silent())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", sorted(CONFIGS.glob("scenes/*.yaml")), ids=lambda path: path.stem)
def test_every_scene_of_the_repository_can_be_planned(path: Path) -> None:
    loaded = load_config(path)
    assert loaded.scene is not None
    plan_sequence(loaded.scene.model_copy(update={"frames": 2}), loaded.seed)


def test_dropped_pairs_are_nowhere_but_in_the_truth(tmp_path: Path) -> None:
    scene = small_scene(frames=6, sensor={"dropped_frames": [0, 3]}, render={"masks": True})
    whole = simulate(scene, 4, tmp_path / "S", Silent()).target.timestamps_ns
    sequence = open_sequence(tmp_path / "S")
    np.testing.assert_array_equal(sequence.timestamps_ns, whole[[1, 2, 4, 5]])
    assert not sequence.dropped and sequence.n_listed == 4
    lost = (str(whole[0]), str(whole[3]))
    assert not [path for path in (tmp_path / "S").rglob("*") if path.stem in lost]
    np.testing.assert_array_equal(read_truth(tmp_path / "S").timestamps_ns, whole)
    frames = received_frames(config.Sensor(drop_probability=0.2, dropped_frames=(7,)), 5000, 1)
    assert len(frames) == pytest.approx(4000, abs=120) and 7 not in frames
    with pytest.raises(InputError, match="leave no frame"):
        received_frames(config.Sensor(drop_probability=1.0), 10, 1)


def test_motion_blurs_the_edges_as_the_exposure_grows() -> None:
    """Motion across the silhouette: its partly covered pixels grow with the shutter's time."""
    motion = {"position_m": [0.0, 0.0, 0.6], "velocity_mm_s": [200.0, 0.0, 0.0]}
    rig = {"width_px": 160, "height_px": 120, "focal_px": 120.0}
    partly, middle = [], []
    for exposure_ms in (0.0, 100.0):
        sensor = {"exposure_ms": exposure_ms}
        scene = small_scene(rig=rig, motion=motion, sensor=sensor, render={"samples": 16})
        _, picture = FrameRenderer(plan_sequence(scene, 4)).render_image(1, 0)
        partly.append(np.count_nonzero((picture.covered > 0) & (picture.covered < 1)))
        middle.append((picture.covered.sum(axis=0) * np.arange(160)).sum() / picture.covered.sum())
    # The shutter is open around the timestamp: the middle stays.
    assert middle[1] == pytest.approx(middle[0], abs=0.05)
    assert partly[1] > 1.4 * partly[0]


def _plan(**changes: object) -> None:
    rig = {"width_px": 96, "height_px": 72, "focal_px": 70.0}
    plan_sequence(Scene.model_validate({"frames": 3, "truth_horizon_s": 0, "rig": rig, **changes}), 4)


def _mesh(path: Path, mesh: trimesh.Trimesh) -> dict[str, object]:
    mesh.export(path)
    return {"family": "mesh", "path": str(path), "metres_per_unit": 1.0}


@pytest.mark.parametrize(
    ("motion", "message"),
    [
        ({"position_m": [0, 0, -0.6]}, "never in view, at none of 3 frames: it stays behind the cameras"),
        ({"position_m": [-0.5, 0, 0.6]}, "in view of one camera, but of both at none of 3 frames"),
        ({"position_m": [5, 0, 0.6]}, "never in view, at none of 3 frames: it stays beside the images"),
        (
            {"position_m": [0, 0, 0.02]},
            r"the left camera is inside the target at 0 s \(it is 0\.\d+ m",
        ),
        ({"position_m": [0.17, 0, 0.02]}, "the right camera is inside the target at 0 s"),
        (
            {"position_m": [0, 0, 0.6], "velocity_mm_s": [0, 0, -600]},
            "the left camera is inside the target at 1 s",
        ),
    ],
)
def test_a_target_that_cannot_be_seen_is_refused(motion: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        _plan(motion=motion)
    assert "\n" not in str(caught.value)
    assert "scene.motion.position_m" in str(caught.value)


def test_a_target_that_is_in_view_for_one_frame_is_enough() -> None:
    _plan(motion={"position_m": [-2.0, 0, 0.6], "velocity_mm_s": [2000, 0, 0]})
    _plan(motion={"position_m": [0, 0, 0.6], "velocity_mm_s": [5000, 0, 0]})


def test_a_long_body_may_pass_close_by_its_side(tmp_path: Path) -> None:
    """The sphere around it holds the cameras; the body does not."""
    body = _mesh(tmp_path / "boom.stl", trimesh.creation.box([4.0, 0.2, 0.2]))
    _plan(body=body, motion={"position_m": [0, 0, 0.5]})


def test_a_wall_without_a_corner_is_in_view_and_a_shell_with_a_hole_encloses(tmp_path: Path) -> None:
    wall = _mesh(tmp_path / "wall.stl", trimesh.creation.box([9.0, 9.0, 0.1]))
    _plan(body=wall, motion={"position_m": [0, 0, 1.0]})
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=2.0)
    sphere.update_faces(np.arange(len(sphere.faces)) > 20)
    with pytest.raises(InputError, match="inside the target"):
        _plan(body=_mesh(tmp_path / "shell.stl", sphere), motion={"position_m": [0, 0, 0.3]})
