"""Faults of the data and of the solver, by what the command says: its exit code, one line, what it leaves."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.cli.main import main
from polhode.frontend.tracks.guided_matching import GuidedResult, reconnect
from polhode.run_directory.trajectory_file import read_trajectory
from polhode.runtime.errors import RunFailure
from tests.front_end_results import SharedFrontEnd
from tests.pipeline.conftest import REST_FRAMES

QUICK = (
    *("--pictures.animation", "false", "--pictures.views", "false"),
    *("--frontend.depth.method", "sgbm", "--mapping.voxel-mm", "6"),
)
"""Where nothing is asked of pictures and surface"""
Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def pairs_are_seen_once(front_end_once: SharedFrontEnd) -> Iterator[None]:
    """What goes wrong here comes after the front end, or in one of its frames."""
    with front_end_once():
        yield


def run(sequence: Path, folder: Path, *overrides: str) -> int:
    arguments = ["run", "configs/default.yaml", "--data", str(sequence), "-o", str(folder)]
    return main([*arguments, "--runtime.workers", "1", *overrides])


def summary_of(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return content


def test_a_target_at_rest_is_a_complete_answer_with_a_warning(
    at_rest: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert run(at_rest, tmp_path / "run") == 0
    summary = summary_of(tmp_path / "run")
    assert summary["status"] != "failed"
    assert any("does not determine" in text for text in summary["warnings"])
    trajectory = read_trajectory(tmp_path / "run")
    assert len(trajectory.timestamps_ns) == REST_FRAMES
    assert np.linalg.norm(trajectory.w_P, axis=1).max() < np.deg2rad(2.0)
    assert capsys.readouterr().out.splitlines()[-1].endswith("report.html")


def test_what_an_earlier_round_found_stays_when_a_later_one_fails(
    at_rest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rounds: list[int] = []

    def failing(*arguments: Any) -> GuidedResult:
        rounds.append(1)
        if len(rounds) > 1:
            raise RunFailure("no consistent motion")
        return reconnect(*arguments)

    monkeypatch.setattr("polhode.pipeline.find_motion.reconnect", failing)
    assert run(at_rest, tmp_path / "run", *QUICK) == 1
    assert len(read_trajectory(tmp_path / "run").timestamps_ns) == REST_FRAMES
    summary = summary_of(tmp_path / "run")
    assert summary["status"] == "failed" and summary["inertia"] is not None


def test_damaged_frames_are_dropped_counted_and_warned_of(at_rest: Path, tmp_path: Path) -> None:
    damaged = Path(shutil.copytree(at_rest, tmp_path / "sequence"))
    left = sorted((damaged / "mav0" / "cam0" / "data").iterdir())
    left[1].write_bytes(left[1].read_bytes()[:300])
    left[4].unlink()
    assert run(damaged, tmp_path / "run", *QUICK) == 0
    summary = summary_of(tmp_path / "run")
    assert len(read_trajectory(tmp_path / "run").timestamps_ns) == summary["frames"] == REST_FRAMES - 2
    assert any(f"2 of {REST_FRAMES}" in text for text in summary["warnings"])
