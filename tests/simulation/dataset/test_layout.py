"""The files of a sequence are those that the dataset's page names, and nothing else."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array
from polhode.records.dataset import open_sequence
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.sequence import SequencePlan, plan_sequence, simulate
from polhode.simulation.rendering.render import Renderer

FRAMES = 3


def _scene(**changes: object) -> Scene:
    rig = {
        "width_px": 96,
        "height_px": 72,
        "focal_px": 70.0,
        "distortion": [-0.2, 0.05, 1e-3, -5e-4],
        "right_rotation_deg": [0.5, -6.0, 0.8],
        "right_offset_mm": [0.0, 1.5, -2.0],
    }
    motion = {"position_m": [0.04, 0.0, 0.6], "spin_rpm": [1.0, 9.0, 0.0]}
    light, render = {"earth": 0.0}, {"bounces": 0}
    plain = {"frames": FRAMES, "rig": rig, "motion": motion, "light": light, "render": render}
    return Scene.model_validate({**plain, **changes})


@pytest.fixture(scope="module")
def sequence_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("layout") / "S"
    simulate(_scene(render={"masks": True, "samples": 16, "bounces": 0}), 4, folder, Silent())
    return folder


def test_the_folder_holds_what_the_contract_names(sequence_folder: Path) -> None:
    mav0 = sequence_folder / "mav0"
    names = {p.relative_to(mav0).as_posix() for p in mav0.rglob("*") if p.is_file()}
    stamps = [str(1_600_000_000_000_000_000 + k * 500_000_000) for k in range(FRAMES)]
    expected = {"target0/data.csv", "target0/target.yaml", "target0/mesh.ply"}
    for index in (0, 1):
        expected |= {f"cam{index}/sensor.yaml", f"cam{index}/data.csv"}
        expected |= {f"cam{index}/data/{stamp}.png" for stamp in stamps}
        expected |= {f"masks{index}/{stamp}.png" for stamp in stamps}
    assert names == expected


def test_images_are_grey_of_the_calibrations_size_and_hold_the_target(sequence_folder: Path) -> None:
    for path in sorted((sequence_folder / "mav0").glob("cam*/data/*.png")):
        image = Image.open(path)
        assert image.mode == "L"
        assert image.size == (96, 72)
        assert np.asarray(image).max() > 100


def test_truth_names_moments_ratios_and_frames(sequence_folder: Path) -> None:
    target = yaml.safe_load((sequence_folder / "mav0/target0/target.yaml").read_text())
    assert set(target) == {"moments", "k1", "k2", "com_G", "R_GP", "mass_kg"}
    rows = (sequence_folder / "mav0/target0/data.csv").read_text().splitlines()
    assert len(rows) == 1 + FRAMES + 120
    assert {len(row.split(",")) for row in rows} == {14}


def test_inspector0_is_written_when_the_inspector_moves_and_only_then(tmp_path: Path) -> None:
    moving = {"profile": "drift", "velocity_mm_s": [5, 0, 0], "sigma_p_m": 1e-3, "sigma_theta_deg": 0.1}
    for name, changes in (("rest", {}), ("moves", {"inspector": moving})):
        simulate(_scene(frames=3, **changes), 4, tmp_path / name, Silent())
    assert not (tmp_path / "rest/mav0/inspector0").exists()
    rows = (tmp_path / "moves/mav0/inspector0/data.csv").read_text().splitlines()
    assert len(rows) == 1 + FRAMES
    sequence = open_sequence(tmp_path / "moves")
    assert sequence.sigma_camera_p_m == pytest.approx(1e-3)
    assert sequence.sigma_camera_theta_rad == pytest.approx(np.deg2rad(0.1))


def test_the_calibration_read_back_projects_the_mesh_onto_the_images(sequence_folder: Path) -> None:
    """OpenCV projects the truth's mesh with the file's calibration; silhouettes agree in both cameras."""
    sequence, plan = open_sequence(sequence_folder), plan_sequence(_scene(), 4)
    calibration, pair = sequence.calibration, sequence.read_pair(1)
    renderer = Renderer(plan.body, _scene(render={"samples": 16, "bounces": 0}), 4)
    X_NB = plan.X_NC[1] @ np.linalg.inv(calibration.X_BC0)
    for K, dist, X_BC, mask, camera in (
        (calibration.K0, calibration.dist0, calibration.X_BC0, pair.mask_left, plan.cameras[0]),
        (calibration.K1, calibration.dist1, calibration.X_BC1, pair.mask_right, plan.cameras[1]),
    ):
        share = _silhouette(plan, K, dist, np.linalg.inv(X_NB @ X_BC) @ plan.target.X_NG[1])
        assert mask is not None
        assert np.count_nonzero((share >= 0.5) != mask) < 0.01 * np.count_nonzero(mask)
        rendered = renderer.picture(camera, plan.X_NC[1] @ camera.X_CK, plan.target.X_NG[1]).covered
        np.testing.assert_allclose(_centroid(share), _centroid(rendered), atol=0.02)


def _silhouette(plan: SequencePlan, K: Array, dist: Array, X_CG: Array, scale: int = 64) -> Array:
    """Share (72, 96) of each pixel that the mesh covers, filled triangle by triangle on a finer grid."""
    rotation, _ = cv2.Rodrigues(X_CG[:3, :3])
    uv, _ = cv2.projectPoints(plan.body.mesh.vertices, rotation, X_CG[:3, 3], K, dist)
    # Pixel u spans [u - 1/2, u + 1/2]; the fine grid's centres are integers as well.
    corners = np.rint((uv[:, 0] + 0.5) * scale - 0.5).astype(np.int32)[plan.body.mesh.faces]
    filled = np.zeros((72 * scale, 96 * scale), np.uint8)
    for corner in corners:
        cv2.fillConvexPoly(filled, corner, 1)
    return np.asarray(filled.reshape(72, scale, 96, scale).mean(axis=(1, 3)))


def _centroid(share: Array) -> Array:
    v, u = np.mgrid[:72, :96]
    return np.asarray([(share * u).sum() / share.sum(), (share * v).sum() / share.sum()])
