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
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory
from polhode.runtime.errors import RunFailure
from tests.front_end_results import SharedFrontEnd
from tests.pipeline.conftest import FAST, REST_FRAMES


@pytest.fixture(autouse=True)
def pairs_are_seen_once(front_end_once: SharedFrontEnd) -> Iterator[None]:
    """What goes wrong here comes after the front end, or in one of its frames."""
    with front_end_once():
        yield


def run(sequence: Path, folder: Path, code: int) -> tuple[dict[str, Any], Trajectory]:
    arguments = ["run", "configs/default.yaml", "--data", str(sequence), "-o", str(folder / "run")]
    assert main([*arguments, *FAST]) == code
    return json.loads((folder / "run" / "summary.json").read_text()), read_trajectory(folder / "run")


def test_damaged_frames_of_a_target_at_rest_are_dropped_and_nothing_is_claimed(
    at_rest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = Path(shutil.copytree(at_rest, tmp_path / "sequence"))
    left = sorted((damaged / "mav0" / "cam0" / "data").iterdir())
    left[1].write_bytes(left[1].read_bytes()[:300])
    left[4].unlink()
    summary, trajectory = run(damaged, tmp_path, 0)
    assert summary["status"] != "failed"
    for words in ("does not determine", f"2 of {REST_FRAMES}"):
        assert any(words in text for text in summary["warnings"])
    assert len(trajectory.timestamps_ns) == summary["frames"] == REST_FRAMES - 2
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
    summary, trajectory = run(at_rest, tmp_path, 1)
    assert len(trajectory.timestamps_ns) == REST_FRAMES
    assert summary["status"] == "failed" and summary["inertia"] is not None
