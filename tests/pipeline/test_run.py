"""The whole path on a small rendered sequence: images in, a run directory out."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from polhode.config import Config
from polhode.pipeline.run import run
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import write_png
from polhode.report.evaluation import evaluate
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.recording import recording_of
from polhode.run_directory.summary import read_summary
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Silent
from tests.conftest import RENDERED_FRAMES
from tests.front_end_results import SharedFrontEnd
from tests.pipeline.conftest import ONE_METHOD

CONFIG = Config.model_validate(ONE_METHOD)
FILES = {
    "config.yaml", "summary.json", "trajectory.csv", "covariance.npz", "measurements.npz", "landmarks.ply",
    "mesh.ply", "mesh.glb", "report.html", "log.txt",
}  # fmt: skip


def test_the_motion_is_found_from_a_cold_start_and_the_folder_is_complete(
    finished: Path, rendered_sequence: Path, tmp_path: Path
) -> None:
    metrics = evaluate(Path(shutil.copytree(finished, tmp_path / "run")), rendered_sequence)
    assert metrics["rmse_position_m"] < 1e-3
    assert metrics["rmse_velocity_m_s"] < 2e-3
    assert metrics["rmse_angular_velocity_deg_s"] < 0.5
    assert metrics["attitude_error_deg"]["median"] < 0.5
    assert metrics["mesh"]["chamfer_mm"] < 3.0
    assert len(read_trajectory(finished / "trajectory.csv").timestamps_ns) == RENDERED_FRAMES
    assert {path.name for path in finished.iterdir()} >= FILES
    assert read_summary(finished).data == recording_of(open_sequence(rendered_sequence))
    pictures = {path.name for path in (finished / "pictures").iterdir()}
    assert pictures >= {"model.mp4", "model.gif", "model.csv", "mesh.png"}


def test_the_estimates_are_the_same_bytes_without_the_truth(
    run_of_one_method: Path, rendered_sequence: Path, front_end_once: SharedFrontEnd, tmp_path: Path
) -> None:
    """The front end has the same key without it; live/test_session.py computes it from images alone."""
    blind, folder = tmp_path / "blind", tmp_path / "run"
    shutil.copytree(rendered_sequence, blind)
    (blind / "scene.yaml").unlink()
    for truth in ("target0", "truth0", "truth1"):
        shutil.rmtree(blind / "mav0" / truth)
    with front_end_once():
        result = run(CONFIG, blind, folder, Silent())
    assert result.status in ("ok", "degraded") and result.report_path == folder / "report.html"
    for name in ("trajectory.csv", "landmarks.ply", "mesh.ply"):
        assert (folder / name).read_bytes() == (run_of_one_method / name).read_bytes(), name


def test_frames_that_show_nothing_are_bridged_with_a_warning_and_a_larger_sigma(
    rendered_sequence: Path, front_end_once: SharedFrontEnd, tmp_path: Path
) -> None:
    dark, folder = tmp_path / "dark", tmp_path / "run"
    shutil.copytree(rendered_sequence, dark)
    for camera in ("cam0", "cam1"):
        frames = sorted((dark / "mav0" / camera / "data").iterdir())
        for frame in (frames[7], frames[8]):
            write_png(frame, np.zeros((256, 320), dtype=np.uint8))
    # Under the thesis's disturbances; an undisturbed body is known as well between the frames as in them.
    disturbed = Config.model_validate({**ONE_METHOD, "backend": {"process_noise": "given"}})
    with front_end_once():
        run(disturbed, dark, folder, Silent())
    summary, trajectory = read_summary(folder), read_trajectory(folder)
    assert any("2 frames without measurements were bridged" in warning for warning in summary.warnings)
    assert (summary.frames, summary.frames_used) == (RENDERED_FRAMES, RENDERED_FRAMES - 2)
    assert len(trajectory.timestamps_ns) == RENDERED_FRAMES
    observations = np.bincount(read_measurements(folder).frame, minlength=RENDERED_FRAMES)
    assert not observations[7:9].any()
    # The ends are left out: smoothing knows them less, measured or not.
    measured = [k for k in range(3, 10) if observations[k] > 0.2 * np.median(observations)]
    assert len(measured) >= 4
    sigma = np.linalg.norm(trajectory.sigma_v, axis=1)
    assert min(sigma[7:9]) > 1.05 * max(sigma[measured])


def test_images_without_texture_fail_and_leave_what_was_found_and_bad_input_writes_nothing(
    small_sequence: Path, tmp_path: Path
) -> None:
    with pytest.raises(RunFailure, match="stereo features"):
        run(CONFIG, small_sequence, tmp_path / "run", Silent())
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["status"] == "failed"
    with pytest.raises(InputError):
        run(CONFIG, tmp_path / "missing", tmp_path / "other", Silent())
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "run"}
