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
from polhode.pipeline.checkout.checkout import checkout
from polhode.pipeline.checkout.page import format_checkout, render
from polhode.pipeline.run import run
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png, write_range_sensor
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.read_truth import read_truth
from polhode.report.evaluation import evaluate
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import load_scene, plan_sequence
from tests.conftest import RENDERED_FRAMES, MakeOnce
from tests.pipeline.conftest import ONE_METHOD

OF_TWO_CAMERAS = r"stereo|cameras|\bright\b|\bpairs\b(?! of (?:successive )?frames)"
SENSOR = RangeSensor(enabled=True, sigma_m=0.002)


def as_sequence(source: Path, folder: Path) -> None:
    """Copy the left images of a simulated sequence, with ranges of 2 mm noise in the place of all else."""
    scene, seed = load_scene(source / "scene.yaml")
    plan = plan_sequence(Scene.model_validate(scene.model_dump() | {"range_sensor": SENSOR}), seed)
    stamps = plan.target.timestamps_ns[list(plan.frames)]
    for part in ("cam0", "target0"):
        shutil.copytree(source / "mav0" / part, folder / "mav0" / part)
    ranges, renderer = folder / "mav0" / "range0", FrameRenderer(plan)
    write_range_sensor(ranges, SENSOR.scale_m, SENSOR.sigma_m, SENSOR.growth_per_m)
    write_camera_csv(ranges, stamps)
    for k, stamp in zip(plan.frames, stamps, strict=True):
        write_png(image_path(ranges, int(stamp)), renderer.render_range(k))


@pytest.fixture(scope="session")
def ranged(rendered_sequence: Path, make_once: MakeOnce) -> Path:
    return make_once("ranged", lambda folder: as_sequence(rendered_sequence, folder))


def test_motion_and_shape_are_found_and_checks_of_two_cameras_are_not_made(
    ranged: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run(Config.model_validate({**ONE_METHOD, "mapping": {}}), ranged, folder, Silent())
    metrics = evaluate(folder, ranged)
    # seven seconds do not tell the centre of mass along the axis of the spin better, and its sigma says so
    assert metrics["rmse_position_m"] < 3e-3
    for name in ("position", "com"):
        assert metrics["nees"][name] < float(chi2.ppf(0.99, 3))
    assert metrics["rmse_velocity_m_s"] < 2e-3
    assert metrics["rmse_angular_velocity_deg_s"] < 0.5
    assert metrics["attitude_error_deg"]["median"] < 0.5
    assert metrics["mesh"]["chamfer_mm"] < 3.0
    content = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert content["frames"] == content["frames_used"] == RENDERED_FRAMES
    checks = {check["name"]: check for check in content["verdict"]["checks"]}
    for name in (
        "pairs with negative disparities",
        "step of the vertical disparity in time",
        "step of the roll between the cameras in time",
        "delay between the cameras",
        "step of all disparities in time",
    ):
        assert checks[name]["value"] is None and checks[name]["holds"] is None
    assert "stereo pair" not in (folder / "report.html").read_text(encoding="utf-8")


def test_features_with_ranges_lie_on_the_surface(ranged: Path) -> None:
    sequence, truth = open_sequence(ranged), read_truth(ranged)
    rectifier = make_rectifier(sequence.calibration)
    found = RootSift(Config().frontend)(rectified_pair(sequence, rectifier, 3), rectifier.rig)
    assert len(found) > 100 and found.rows is None and truth.mesh is not None
    R_NG = truth.R_NP[3] @ truth.R_GP.T
    off_m = distance_to_surface(truth.mesh, (found.p_R - truth.r_N[3]) @ R_NG + truth.com_G)
    assert np.median(off_m) < 0.5e-3 and np.mean(off_m > 2e-3) < 0.05


def test_the_checkout_judges_ranges_instead_of_a_second_camera(ranged: Path) -> None:
    done = checkout(ranged, workers=1, count=2)
    result = done.result
    names = {check.name for check in result.checks}
    assert result.named("noise of the ranges over that stated").value == pytest.approx(1.0, abs=0.1)
    missing = result.named("target pixels without a range").value
    assert missing is not None and missing < 15.0
    assert not any(check.status == "FAIL" for check in result.checks)
    assert names > {
        "clock offset of the range images",
        "median number of features with a range per image",
        "successive images that match",
    }
    said = [f"{check.name} {check.finding} {check.advice}" for check in result.checks]
    assert not [each for each in (*said, format_checkout(done)) if re.search(OF_TWO_CAMERAS, each)]
    page = render(done, "ranges")
    assert "An image and its ranges" in page and "Vertical disparity" not in page


def test_a_noise_that_is_stated_wrong_is_named_and_another_calibration_is_checked(
    ranged: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(ranged, tmp_path / "S"))
    write_range_sensor(folder / "mav0" / "range0", RangeSensor().scale_m, 0.0005)
    rig = Path(shutil.copytree(ranged / "mav0", tmp_path / "rig"))
    result = checkout(folder, rig, workers=1, count=1).result
    assert result.rig == "given"
    check = checkout(folder, workers=1, count=1).result.named("noise of the ranges over that stated")
    assert check.status == "WARN" and check.value == pytest.approx(4.0, rel=0.1)
    assert "sigma_m" in check.advice and "scale_m" in check.advice
    shutil.rmtree(rig / "cam0")
    with pytest.raises(InputError, match=r"cam0/sensor\.yaml is missing"):
        checkout(ranged, rig, workers=1, count=1)
