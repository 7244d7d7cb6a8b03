"""``polhode compare`` as a user meets it."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from polhode.cli.main import main
from polhode.compare.comparison import claim, store_row
from polhode.compare.problem.sources import SCENES
from polhode.compare.rows import Row, read_comparison
from polhode.config.compare_settings import Motion
from polhode.files.output.marked_folder import MARK, write_mark
from polhode.run_directory.archives import write_measurements
from polhode.runtime.errors import InputError
from polhode.simulation.monte_carlo import SyntheticSequence, generate
from tests.figures_of_page import text_of_figures
from tests.trap import trap

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
    printed = capsys.readouterr()
    assert printed.err == ""
    done = re.findall(
        r"^note: (\w+): (\w+) \(cold start\): (\w+), .*\d s, (\d of \d)$", printed.out, re.MULTILINE
    )
    assert [row[1:] for row in done] == [("gauss_newton", "ok", "1 of 2"), ("odometry", "baseline", "2 of 2")]
    assert "gauss_newton" in printed.out and printed.out.rstrip().endswith(str(out / "compare.html"))
    found = read_comparison(out / "compare.json")
    assert [(row.solver, row.status) for row in found.rows] == [
        ("gauss_newton", "ok"),
        ("odometry", "baseline"),
    ]
    assert found.problems[0].frames == 16
    page = (out / "compare.html").read_text()
    assert "Pareto front" in text_of_figures(page)
    # nothing is loaded from elsewhere
    assert re.search(r"(src|href)\s*=\s*[\"']?https?:", page) is None
    assert len((out / "compare.csv").read_text().splitlines()) == 3

    # the same command again reads what it measured
    before = json.loads((out / "compare.json").read_text())["rows"]
    assert main([*command, "--quiet"]) == 0
    assert capsys.readouterr().out == f"Comparison: {out / 'compare.html'}\n"
    assert json.loads((out / "compare.json").read_text())["rows"] == before


def test_the_comparison_of_another_person_runs_no_code(
    config: Path, run: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Everything in the folder that a comparison reads or once read is a trap, or not what it should be."""
    out, sprung = tmp_path / "out", tmp_path / "sprung"
    claim(out)
    pickled = trap(sprung)
    for name in ("stored.pickle", "stored.problem.npz", "stored.npz"):
        (out / "problems" / name).write_bytes(pickled)
    (out / "rows" / "stored.gauss_newton.cold0.json").write_text("[" * 100_000)
    (out / "rows" / "stored.odometry.cold0.json").write_text("[]")
    assert main(["compare", str(config), "--run", str(run), "-o", str(out), *SOLVERS]) == 0
    assert not sprung.exists()
    assert [row.status for row in read_comparison(out / "compare.json").rows] == ["ok", "baseline"]
    named = [each.getMessage() for each in caplog.records if "stored.pickle" in each.getMessage()]
    assert len(named) == 1 and "not read" in named[0]
    assert (out / "problems" / "stored.pickle").read_bytes() == pickled


def test_rows_are_not_written_through_a_link(
    config: Path, run: Path, tmp_path: Path, capsys: Capture
) -> None:
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    elsewhere.mkdir()
    claim(out)
    (out / "rows").rmdir()
    (out / "rows").symlink_to(elsewhere)
    assert main(["compare", str(config), "--run", str(run), "-o", str(out), *SOLVERS]) == 2
    assert "rows: this is a link" in capsys.readouterr().err
    assert list(elsewhere.iterdir()) == []


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
    assert "no solver converged" in capsys.readouterr().err
    assert {row.status for row in read_comparison(out / "compare.json").rows} == {"timeout"}


MISTAKES: dict[str, tuple[list[str], str]] = {
    "unknown solver": (["--compare.solvers", "cerez"], "unknown solver 'cerez'; did you mean ceres?"),
    "both sources": (["--data", "."], "give --data or --run, not both"),
    "solver twice": (
        ["--compare.solvers", "ipopt,ceres,ipopt"],
        "key 'compare': solvers: ipopt is named twice; name it once",
    ),
    "frames twice": (
        ["--compare.monte-carlo.frames", "20,20"],
        "key 'compare.monte_carlo': frames: 20 is named twice; name it once",
    ),
    "motion twice": (
        ["--compare.monte-carlo.motions", "flip,flip"],
        "key 'compare.monte_carlo': motions: flip is named twice; name it once",
    ),
    "no starts": (
        ["--compare.cold", "False"],
        "key 'compare': no start is selected: set cold to true, or perturbed or near to at least 1",
    ),
    "truth of nothing": (["--truth", "."], ".: has no truth (mav0/target0); give the sequence"),
    "no such truth": (["--truth", "nowhere"], "nowhere: no such folder"),
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
    # a folder rows/ or a config.yaml of somebody else's does not make it ours
    for name in ("letter.txt", "rows/notes.json", "config.yaml", "compare.json", ".polhode-compare"):
        other = tmp_path / f"other-{name.replace('/', '-')}"
        (other / name).parent.mkdir(parents=True)
        (other / name).write_text("dear")
        assert main(["compare", str(config), "--run", str(run), "-o", str(other)]) == 2
        stderr = capsys.readouterr().err
        (first, *_) = name.split("/")
        assert f"{first}, which polhode compare did not write" in stderr and stderr.count("\n") == 1
        assert [path for path in other.rglob("*") if path.is_file()] == [other / name]
        assert (other / name).read_text() == "dear"
    missing = ["compare", str(config), "--run", str(tmp_path / "no"), "-o", str(tmp_path / "new")]
    assert main(missing) == 2
    assert "no such folder" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_our_own_folder_is_gone_on_with_and_a_new_one_is_marked(tmp_path: Path) -> None:
    claim(tmp_path / "out")
    assert (tmp_path / "out" / MARK).is_file()
    (tmp_path / "out" / "mine.txt").write_text("kept")
    claim(tmp_path / "out")
    assert (tmp_path / "out" / "mine.txt").read_text() == "kept"
    (tmp_path / "empty").mkdir()
    claim(tmp_path / "empty")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="this is a file"):
        claim(tmp_path / "file")


def test_a_row_of_another_version_is_measured_again(
    config: Path, run: Path, tmp_path: Path, capsys: Capture
) -> None:
    out = tmp_path / "out"
    command = ["compare", str(config), "--run", str(run), "-o", str(out), "--compare.solvers", "odometry"]
    assert main(command) == 0
    (file,) = (out / "rows").iterdir()
    stored = json.loads(file.read_text())
    before = Row.model_validate(stored["row"]).model_copy(update={"message": "of before"})
    store_row(file, stored["stamp"], before)
    assert main(command) == 0
    assert read_comparison(out / "compare.json").rows[0].message == "of before"
    stored["stamp"]["versions"]["scipy"] = "0.1"
    store_row(file, stored["stamp"], before)
    assert main(command) == 0
    assert read_comparison(out / "compare.json").rows[0].message != "of before"
    capsys.readouterr()


def test_a_row_that_was_changed_is_measured_again(
    config: Path, run: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out"
    command = ["compare", str(config), "--run", str(run), "-o", str(out), "--compare.solvers", "odometry"]
    assert main(command) == 0
    (file,) = (out / "rows").iterdir()
    measured = json.loads(file.read_text())
    assert main(command) == 0
    assert "measured again" not in caplog.text
    for change in ({"row": {**measured["row"], "status": "ok", "cost": 1.0}}, {"digest": None}):
        file.write_text(json.dumps({**measured, **change}))
        caplog.clear()
        assert main(command) == 0
        assert f"{file}: was changed since it was measured; it is measured again" in caplog.text
        (row,) = read_comparison(out / "compare.json").rows
        assert (row.status, row.cost) == ("baseline", measured["row"]["cost"])


def test_input_that_is_refused_leaves_nothing(tmp_path: Path, capsys: Capture) -> None:
    data, out = tmp_path / "data", tmp_path / "a" / "out"
    (data / "mav0" / "cam0").mkdir(parents=True)
    assert main(["compare", "--data", str(data), "-o", str(out), *SOLVERS]) == 2
    assert not out.parent.exists()
    out.mkdir(parents=True)
    write_mark(out, {"plan": ["planning.json"]})
    marked = (out / MARK).read_text()
    assert main(["compare", "--data", str(data), "-o", str(out), *SOLVERS]) == 2
    assert [path.name for path in out.iterdir()] == [MARK] and (out / MARK).read_text() == marked
    assert capsys.readouterr().err.count("\n") == 2


def test_input_that_is_refused_leaves_an_earlier_comparison_as_it_was(
    config: Path, run: Path, tmp_path: Path
) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    (data / "mav0" / "cam0").mkdir(parents=True)
    command = ["compare", str(config), "-o", str(out), "--compare.solvers", "odometry"]
    assert main([*command, "--run", str(run)]) == 0
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert main([*command, "--data", str(data), "--seed", "9"]) == 2
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_every_motion_of_the_configuration_has_a_scene() -> None:
    assert set(get_args(Motion)) == set(SCENES)
