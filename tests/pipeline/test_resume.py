"""Runs that are interrupted or killed and resumed: the same bytes, and nothing is computed twice."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import polhode.run_directory.finished_stages as stages_module
from polhode.cli.main import main
from polhode.files.record_files import write_record
from tests.pipeline.conftest import FAST
from tests.pipeline.run_contents import contents

Capture = pytest.CaptureFixture[str]


def words(sequence: Path, place: Path, *more: str) -> list[str]:
    return ["run", "--data", str(sequence), "-o", str(place / "R"), *FAST, *more]


def test_an_interrupted_run_says_so_and_the_resumed_one_has_the_same_bytes(
    run_at_rest: Path, at_rest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for number in (4, 9):
        stored = list[str]()

        def written(path: Path, key: str, value: Any, number: int = number, done: list[str] = stored) -> None:
            """Send an interrupt once so many results of stages are stored."""
            write_record(path, key, value)
            done.append(key)
            if len(done) == number:
                os.kill(os.getpid(), signal.SIGINT)

        with monkeypatch.context() as patch:
            patch.setattr(stages_module, "write_record", written)
            assert main(words(at_rest, tmp_path, *(["--resume"] if number > 4 else []))) == 130
        assert "finished stages are kept, the same command with --resume goes on" in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == [".R.partial"]
    assert main(words(at_rest, tmp_path, "--resume")) == 0
    assert "resuming: 13 results of stages are there" in capsys.readouterr().out
    assert contents(tmp_path) == contents(run_at_rest)
    assert [path.name for path in tmp_path.iterdir()] == ["R"]


def test_a_killed_run_resumes_to_the_same_bytes(run_at_rest: Path, at_rest: Path, tmp_path: Path) -> None:
    program = subprocess.Popen(
        [sys.executable, "-m", "polhode", *words(at_rest, tmp_path, "--runtime.workers", "2")],
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        while len(list(tmp_path.glob(".R.partial/stages/**/[!.]*.npz"))) < 3:
            assert program.poll() is None
            time.sleep(0.002)
    finally:
        os.killpg(program.pid, signal.SIGKILL)
        program.wait()
    # what a kill can leave: a result that is cut short, and one on its way to its name
    stored = sorted(tmp_path.glob(".R.partial/stages/features/[!.]*.npz"))
    stored[0].write_bytes(stored[0].read_bytes()[:1000])
    stored[0].with_name(f".{stored[0].stem}.partial-123.npz").write_bytes(b"half")
    assert main(words(at_rest, tmp_path, "--resume")) == 0
    found, wanted = contents(tmp_path), contents(run_at_rest)
    assert found == wanted
    assert [path.name for path in tmp_path.iterdir()] == ["R"]


def test_another_configuration_computes_only_what_it_changes(
    run_at_rest: Path, at_rest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    more = ("--outputs", "levels", "--mapping.levels", "0.5", "--runtime.stages", "while_running")
    assert main(words(at_rest, tmp_path / "new", *more, "--resume")) == 0
    assert "there is nothing to resume: all is computed" in capsys.readouterr().out
    # stages need not be kept
    assert not (tmp_path / "new" / "R" / "stages").exists()
    shutil.copytree(run_at_rest / "R", tmp_path / "R")
    with monkeypatch.context() as patch:
        for name in ("correspondences.extract_features", "correspondences.match_rows"):
            patch.setattr(f"polhode.pipeline.{name}", lambda *_: pytest.fail("computed again"))
        patch.setattr("polhode.pipeline.depth_maps.extract_depth", lambda *_: pytest.fail("computed again"))
        assert main(words(at_rest, tmp_path, *more, "--resume")) == 0
    assert contents(tmp_path) == contents(tmp_path / "new")
    assert contents(tmp_path)["R/mesh.ply"] == contents(run_at_rest)["R/mesh.ply"]
    assert contents(tmp_path)["R/summary.json"] != contents(run_at_rest)["R/summary.json"]


def test_a_run_of_the_motion_alone_makes_neither_depth_nor_mesh_nor_pictures(
    run_at_rest: Path, at_rest: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for name in ("build_surface.fuse", "write_results.track_pictures", "depth_maps.extract_depth"):
        monkeypatch.setattr(f"polhode.pipeline.{name}", lambda *_: pytest.fail("not wanted"))
    assert main(words(at_rest, tmp_path, "--outputs", "motion")) == 0
    lines = capsys.readouterr().out.splitlines()
    early = next(line for line in lines if line.endswith("; the verdict is pending"))
    assert early.startswith("note: 6 of 6 frames: the target rotates at 0.00 RPM; k1 not determined")
    assert lines[-2].startswith("6 of 6 frames: the target rotates at 0.00 RPM; k1 not determined")
    found, whole = contents(tmp_path), contents(run_at_rest)
    for file in ("trajectory.csv", "trajectory_online.csv", "covariance.npz", "landmarks.ply"):
        assert found[f"R/{file}"] == whole[f"R/{file}"], file
    made = {path.name for path in (tmp_path / "R").iterdir()}
    assert {"report.html", "summary.json"} < made
    assert made.isdisjoint({"mesh.ply", "mesh.glb", "occupancy.npz", "pictures"})
    summary = json.loads((tmp_path / "R" / "summary.json").read_text())
    assert any("outputs has no surface" in each for each in summary["warnings"])


def test_a_run_of_another_sequence_or_a_stream_is_not_resumed(
    run_at_rest: Path, small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    shutil.copytree(run_at_rest / "R", tmp_path / "R")
    shutil.copytree(run_at_rest / "R" / "stages", tmp_path / ".killed.partial" / "stages")
    before = {path for path in tmp_path.rglob("*.npz") if "sequence" not in path.parts}
    for name in ("R", "killed"):
        line = ["run", "--data", str(small_sequence), "-o", str(tmp_path / name), "--resume"]
        assert main(line) == 2
        error = capsys.readouterr().err
        assert "not the sequence of this run" in error and "give --data of the same recording" in error
        assert error.count("\n") == 1
    assert {path.name for path in tmp_path.rglob("*.npz")} >= {path.name for path in before}
    assert main(["run", "--live", str(tmp_path), "-o", str(tmp_path / "live"), "--resume"]) == 2
    assert "a stream cannot be resumed; give --data instead" in capsys.readouterr().err
