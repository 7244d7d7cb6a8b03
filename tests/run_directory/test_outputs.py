"""The files of a run: all there, open in other programs, and the same bytes for the same content."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml

from polhode.config import Config
from polhode.records.estimate import Disturbances, Impulse
from polhode.records.surface import SurfaceModel
from polhode.run_directory.outputs import PUSHES_COLUMNS, write_disturbances
from polhode.run_directory.summary import read_summary
from polhode.runtime.errors import InputError
from tests.pipeline.stored_run import write_run

STATED = {
    "config.yaml", "summary.json", "trajectory.csv", "covariance.npz", "measurements.npz", "landmarks.ply",
    "mesh.ply", "mesh.glb", "report.html",
}  # fmt: skip


def _write(folder: Path, run: Any, surface: SurfaceModel | None) -> Path:
    folder.mkdir()
    more: Any = {"relative": run.relative, "pictures": {"frame 0": b"\x89PNG not really"}}
    given = {"config": Config(seed=4), "tracks": run.tracks, "estimate": run.estimate}
    write_run(folder, **given, surface=surface, timing_s={"frontend": 2.0}, **more)
    return folder


def test_every_file_is_written_with_the_same_bytes_each_time(example: Any, tmp_path: Path) -> None:
    first, second = (_write(tmp_path / name, example, example.surface) for name in ("a", "b"))
    assert {entry.name for entry in first.iterdir()} == STATED | {"pictures"}
    # Timings differ: they stand in summary.json and on the page.
    for name in sorted(STATED - {"summary.json", "report.html"}):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    # the configuration that was written is the one that ran
    content = yaml.safe_load((first / "config.yaml").read_text())
    assert Config.model_validate(content) == Config(seed=4) and set(content) == set(Config.model_fields)
    for name in ("mesh.ply", "mesh.glb"):
        mesh = trimesh.load(first / name, force="mesh")
        assert isinstance(mesh, trimesh.Trimesh) and mesh.is_watertight
        assert mesh.volume == pytest.approx(example.surface.mesh.volume, rel=1e-5)
    empty = SurfaceModel(trimesh.Trimesh(), np.empty(0), np.empty(0, dtype=np.int64))
    bare = _write(tmp_path / "bare", example, empty)
    assert not (bare / "mesh.ply").exists() and not (bare / "mesh.glb").exists()
    assert "No surface" in (bare / "report.html").read_text()


def test_a_report_that_cannot_be_made_costs_only_itself(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(folder: Path) -> None:
        raise InputError(f"{folder}/online.npz: covariance holds NaN")

    monkeypatch.setattr("polhode.report.page.write_report", refuse)
    summary = write_run(
        tmp_path, config=Config(), tracks=example.tracks, estimate=example.estimate, surface=None, timing_s={}
    )
    assert any("no report" in text and "holds NaN" in text for text in summary.warnings)
    assert summary.status == "degraded"
    assert read_summary(tmp_path).warnings == summary.warnings
    assert (tmp_path / "trajectory.csv").is_file() and not (tmp_path / "report.html").exists()


def test_pushes_read_back_exactly_and_are_numbered(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    start = 1_600_000_000_000_000_000 + 500_000_000 * np.array([3, 4, 9], dtype=np.int64)
    accel, sigma = rng.normal(size=(2, 3, 3)), rng.uniform(0.1, 1.0, (2, 3, 3))
    sigma[1, 2] = np.inf
    one = Impulse(int(start[0]), int(start[1]) + 500_000_000, *rng.normal(size=(4, 3)))
    two = Impulse(int(start[2]), int(start[2]) + 500_000_000, *rng.normal(size=(4, 3)))
    disturbances = Disturbances(
        start, start + 500_000_000, accel[0], sigma[0], accel[1], sigma[1], (one, two)
    )
    write_disturbances(disturbances, tmp_path / "pushes.csv")
    header, *rows = (tmp_path / "pushes.csv").read_text().splitlines()
    assert tuple(header.split(",")) == PUSHES_COLUMNS and len(PUSHES_COLUMNS) == 15
    cells = [row.split(",") for row in rows]
    assert [int(row[0]) for row in cells] == [1, 1, 2]
    assert [int(row[1]) for row in cells] == start.tolist()
    values = np.array([[float(cell) for cell in row[3:]] for row in cells])
    np.testing.assert_array_equal(values, np.hstack([accel[0], sigma[0], accel[1], sigma[1]]))
