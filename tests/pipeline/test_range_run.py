"""A sequence with range images instead of a second camera: the whole path, and its checkout."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from polhode.config import Config
from polhode.config.scene_settings import RangeSensor, Scene
from polhode.frontend.features.stereo import RootSift
from polhode.frontend.rectification import make_rectifier, rectified_pair
from polhode.pipeline.checkout.checkout import Checkout, checkout
from polhode.pipeline.checkout.page import format_checkout, render
from polhode.pipeline.run import run
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_range_sensor
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.range_images import RANGE_FOLDER
from polhode.records.read_truth import read_truth
from polhode.report.evaluation import evaluate
from polhode.run_directory.summary import read_summary
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import load_scene, plan_sequence
from tests.conftest import RENDERED_FRAMES, MakeOnce

OF_TWO_CAMERAS = r"stereo|cameras|\bright\b|\bpairs\b(?! of (?:successive )?frames)"
NEES_OF_THREE = float(chi2.ppf(0.99, 3))
CONFIG = Config.model_validate(
    {
        "runtime": {"workers": 1},
        "frontend": {"features": {"second": None}},
        "pictures": {"animation": False, "views": False},
    }
)


def as_sequence(source: Path, folder: Path, sensor: RangeSensor) -> None:
    """Copy the left images of a simulated sequence, with ranges of this sensor in the place of all else."""
    scene, seed = load_scene(source / "scene.yaml")
    plan = plan_sequence(
        Scene.model_validate(
            scene.model_dump() | {"range_sensor": sensor.model_copy(update={"enabled": True})}
        ),
        seed,
    )
    stamps = plan.target.timestamps_ns[list(plan.frames)]
    staged = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(staged, ignore_errors=True)
    for part in ("cam0", "target0", "inspector0", "wrench0"):
        if (source / "mav0" / part).is_dir():
            shutil.copytree(source / "mav0" / part, staged / "mav0" / part)
    ranges = staged / "mav0" / RANGE_FOLDER
    write_range_sensor(ranges, sensor.scale_m, sensor.sigma_m, sensor.growth_per_m)
    write_camera_csv(ranges, stamps)
    renderer = FrameRenderer(plan)
    for k, stamp in zip(plan.frames, stamps, strict=True):
        write_png(image_path(ranges, int(stamp)), renderer.render_range(k))
    staged.replace(folder)


@pytest.fixture(scope="session")
def ranged(rendered_sequence: Path, make_once: MakeOnce) -> Path:
    """The rendered sequence with ranges of 2 mm noise in the place of its right images."""
    sensor = RangeSensor(sigma_m=0.002)
    return make_once("ranged", lambda folder: as_sequence(rendered_sequence, folder, sensor))


@pytest.fixture(scope="session")
def finished(ranged: Path, make_once: MakeOnce) -> Path:
    return make_once("ranged_run", lambda folder: run(CONFIG, ranged, folder, Silent()))


@pytest.fixture(scope="module")
def done(ranged: Path) -> Checkout:
    return checkout(ranged, workers=1, count=2)


def test_motion_and_shape_are_found(finished: Path, ranged: Path, tmp_path: Path) -> None:
    summary = read_summary(finished)
    assert summary.frames == summary.frames_used == RENDERED_FRAMES
    metrics = evaluate(Path(shutil.copytree(finished, tmp_path / "run")), ranged)
    # seven seconds do not tell the centre of mass along the axis of the spin better, and its sigma says so
    assert metrics["rmse_position_m"] < 3e-3
    assert metrics["nees"]["position"] < NEES_OF_THREE
    assert metrics["nees"]["com"] < NEES_OF_THREE
    assert metrics["rmse_velocity_m_s"] < 2e-3
    assert metrics["rmse_angular_velocity_deg_s"] < 0.5
    assert metrics["attitude_error_deg"]["median"] < 0.5
    assert metrics["mesh"]["chamfer_mm"] < 3.0


def test_checks_that_compare_two_cameras_are_not_made(finished: Path) -> None:
    content = json.loads((finished / "summary.json").read_text(encoding="utf-8"))
    checks = {check["name"]: check for check in content["verdict"]["checks"]}
    for name in (
        "pairs with negative disparities",
        "step of the vertical disparity in time",
        "step of the roll between the cameras in time",
        "delay between the cameras",
        "step of all disparities in time",
    ):
        assert checks[name]["value"] is None and checks[name]["holds"] is None
    report = (finished / "report.html").read_text(encoding="utf-8")
    assert "stereo pair" not in report


def test_features_with_ranges_lie_on_the_surface(ranged: Path) -> None:
    sequence = open_sequence(ranged)
    rectifier = make_rectifier(sequence.calibration)
    pair = rectified_pair(sequence, rectifier, 3)
    found = RootSift(CONFIG.frontend)(pair, rectifier.rig)
    assert len(found) > 100 and found.rows is None
    truth = read_truth(ranged)
    R_NG = truth.R_NP[3] @ truth.R_GP.T
    p_G = (found.p_R - truth.r_N[3]) @ R_NG + truth.com_G
    assert truth.mesh is not None
    off_m = distance_to_surface(truth.mesh, p_G)
    assert np.median(off_m) < 0.5e-3 and np.mean(off_m > 2e-3) < 0.05


def test_the_checkout_judges_ranges_instead_of_a_second_camera(done: Checkout) -> None:
    names = {check.name for check in done.result.checks}
    assert done.result.named("noise of the ranges over that stated").value == pytest.approx(1.0, abs=0.1)
    missing = done.result.named("target pixels without a range").value
    assert missing is not None and missing < 15.0
    assert not any(check.status == "FAIL" for check in done.result.checks)
    assert "clock offset of the range images" in names
    assert names > {"median number of features with a range per image", "successive images that match"}
    said = [f"{check.name} {check.finding} {check.advice}" for check in done.result.checks]
    said.append(format_checkout(done))
    assert not [each for each in said if re.search(OF_TWO_CAMERAS, each)]
    for of_two in (
        "vertical disparity",
        "delay between the cameras",
        "smallest disparity",
        "difference of brightness between the cameras",
    ):
        assert of_two not in names
    page = render(done, "ranges")
    assert "An image and its ranges" in page and "Vertical disparity" not in page


def test_the_checkout_names_a_noise_that_is_stated_wrong(ranged: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ranged, tmp_path / "S"))
    write_range_sensor(folder / "mav0" / "range0", RangeSensor().scale_m, 0.0005)
    check = checkout(folder, workers=1, count=1).result.named("noise of the ranges over that stated")
    assert check.status == "WARN" and check.value == pytest.approx(4.0, rel=0.1)
    assert "sigma_m" in check.advice and "scale_m" in check.advice


def test_another_calibration_of_the_camera_is_checked(ranged: Path, tmp_path: Path) -> None:
    rig = Path(shutil.copytree(ranged / "mav0", tmp_path / "rig"))
    result = checkout(ranged, rig, workers=1, count=1).result
    assert result.rig == "given"
    shutil.rmtree(rig / "cam0")
    with pytest.raises(InputError, match=r"cam0/sensor\.yaml is missing"):
        checkout(ranged, rig, workers=1, count=1)
