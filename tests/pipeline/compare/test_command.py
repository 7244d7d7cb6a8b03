"""``polhode compare`` as a user meets it."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from pipeline.archives import write_measurements
from pipeline.cli import main
from pipeline.compare.rows import read_comparison
from pipeline.compare.sources import SCENES
from polhode.config.compare import Motion
from simulation.measurements import SyntheticSequence, generate

Capture = pytest.CaptureFixture[str]
SOLVERS = ["--compare.solvers", "gauss_newton,odometry"]


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(replace(SCENES["flip"], frames=16, landmarks=250, min_inliers=6), 0)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "config.yaml"
    path.write_text("compare: {limit_s: 60, total_s: 200}\n")
    return path


@pytest.fixture
def run(tmp_path: Path, sequence: SyntheticSequence) -> Path:
    folder = tmp_path / "stored"
    folder.mkdir()
    write_measurements(sequence.tracks, folder / "measurements.npz", sequence.relative)
    return folder


def test_a_stored_run_gives_table_csv_json_and_page(
    config: Path, run: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    command = ["compare", str(config), "--run", str(run), "-o", str(out), *SOLVERS]
    assert main(command) == 0
    told = capsys.readouterr()
    assert told.err == ""
    assert "gauss_newton" in told.out and told.out.rstrip().endswith(str(out / "compare.html"))
    found = read_comparison(out / "compare.json")
    assert [(row.solver, row.status) for row in found.rows] == [
        ("gauss_newton", "ok"),
        ("odometry", "baseline"),
    ]
    assert found.problems[0].frames == 16
    page = (out / "compare.html").read_text()
    assert "Pareto front" in page
    # nothing is loaded from elsewhere
    assert re.search(r"(src|href)\s*=\s*[\"']?https?:", page) is None
    assert len((out / "compare.csv").read_text().splitlines()) == 3

    # the same command again reads what it measured
    before = json.loads((out / "compare.json").read_text())["rows"]
    assert main(command) == 0
    assert json.loads((out / "compare.json").read_text())["rows"] == before


def test_what_has_no_time_left_is_a_row(config: Path, run: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    command = [
        "compare",
        str(config),
        "--run",
        str(run),
        "-o",
        str(out),
        *SOLVERS,
        "--compare.total-s",
        "0.001",
    ]
    assert main(command) == 1
    assert "no solver came to an end" in capsys.readouterr().err
    assert {row.status for row in read_comparison(out / "compare.json").rows} == {"timeout"}


MISTAKES: dict[str, tuple[list[str], str]] = {
    "unknown solver": (["--compare.solvers", "cerez"], "unknown solver 'cerez'; did you mean ceres?"),
    "both sources": (["--data", "x"], "give --data or --run, not both"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_one_line(name: str, config: Path, run: Path, tmp_path: Path, capsys: Capture) -> None:
    more, expected = MISTAKES[name]
    assert main(["compare", str(config), "--run", str(run), "-o", str(tmp_path / "out"), *more]) == 2
    stderr = capsys.readouterr().err
    assert expected in stderr and stderr.count("\n") == 1


def test_a_folder_of_other_things_is_not_touched(
    config: Path, run: Path, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("dear")
    assert main(["compare", str(config), "--run", str(run), "-o", str(tmp_path / "out")]) == 2
    assert "not a comparison" in capsys.readouterr().err
    missing = ["compare", str(config), "--run", str(tmp_path / "no"), "-o", str(tmp_path / "new")]
    assert main(missing) == 2
    assert "no such folder" in capsys.readouterr().err


def test_every_motion_of_the_configuration_has_a_scene() -> None:
    assert set(get_args(Motion)) == set(SCENES)
