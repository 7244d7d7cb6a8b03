"""``polhode compare`` as a user meets it."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.compare.comparison import claim, store_row
from polhode.compare.problem.sources import SCENES
from polhode.compare.rows import Row, read_comparison
from polhode.files.output.marked_folder import MARK, write_mark
from polhode.run_directory.archives import write_measurements
from polhode.simulation.monte_carlo import generate
from tests.conftest import MakeOnce
from tests.figures_of_page import text_of_figures
from tests.trap import trap

Capture = pytest.CaptureFixture[str]
SOLVERS = ["--compare.solvers", "gauss_newton,odometry"]
Compare = Callable[..., int]


@pytest.fixture(scope="module")
def run(make_once: MakeOnce) -> Path:
    def fill(folder: Path) -> None:
        folder.mkdir()
        sequence = generate(replace(SCENES["flip"], frames=16, landmarks=250, min_inliers=6), 0)
        write_measurements(sequence.tracks, folder / "measurements.npz", sequence.relative)

    return make_once("stored", fill)


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


@pytest.fixture
def compare(run: Path, out: Path, tmp_path: Path) -> Compare:
    """The command, with what follows its configuration, run and folder."""
    (tmp_path / "config.yaml").write_text("compare: {limit_s: 60, total_s: 200}\n")

    def call(*more: str, source: tuple[str, ...] = ("--run", str(run)), place: Path = out) -> int:
        return main(["compare", str(tmp_path / "config.yaml"), *source, "-o", str(place), *more])

    return call


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_stored_run_gives_table_csv_json_and_page(compare: Compare, out: Path, capsys: Capture) -> None:
    assert compare(*SOLVERS) == 0
    printed = capsys.readouterr()
    assert printed.err == ""
    done = re.findall(
        r"^note: (\w+): (\w+) \(cold start\): (\w+), .*\d s, (\d of \d)$", printed.out, re.MULTILINE
    )
    assert [row[1:] for row in done] == [("gauss_newton", "ok", "1 of 2"), ("odometry", "baseline", "2 of 2")]
    assert printed.out.rstrip().endswith(str(out / "compare.html"))
    found = read_comparison(out / "compare.json")
    statuses = [(row.solver, row.status) for row in found.rows]
    assert statuses == [("gauss_newton", "ok"), ("odometry", "baseline")]
    assert found.problems[0].frames == 16
    page = (out / "compare.html").read_text()
    assert "Pareto front" in text_of_figures(page)
    assert re.search(r"(src|href)\s*=\s*[\"']?https?:", page) is None, "nothing is loaded from elsewhere"
    assert len((out / "compare.csv").read_text().splitlines()) == 3

    # the same command again reads what it measured
    before = json.loads((out / "compare.json").read_text())["rows"]
    assert compare(*SOLVERS, "--quiet") == 0
    assert capsys.readouterr().out == f"Comparison: {out / 'compare.html'}\n"
    assert json.loads((out / "compare.json").read_text())["rows"] == before


def test_the_comparison_of_another_person_runs_no_code(
    compare: Compare, out: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Everything in the folder that a comparison reads or once read is a trap, or not what it should be."""
    claim(out)
    pickled = trap(tmp_path / "sprung")
    for name in ("stored.pickle", "stored.problem.npz", "stored.npz"):
        (out / "problems" / name).write_bytes(pickled)
    (out / "rows" / "stored.gauss_newton.cold0.json").write_text("[" * 100_000)
    (out / "rows" / "stored.odometry.cold0.json").write_text("[]")
    assert compare(*SOLVERS) == 0
    assert not (tmp_path / "sprung").exists()
    assert [row.status for row in read_comparison(out / "compare.json").rows] == ["ok", "baseline"]
    named = [each.getMessage() for each in caplog.records if "stored.pickle" in each.getMessage()]
    assert len(named) == 1 and "not read" in named[0]
    assert (out / "problems" / "stored.pickle").read_bytes() == pickled


def test_what_has_no_time_left_is_a_row(compare: Compare, out: Path, capsys: Capture) -> None:
    assert compare(*SOLVERS, "--compare.total-s", "0.001") == 1
    assert "no solver converged" in capsys.readouterr().err
    assert {row.status for row in read_comparison(out / "compare.json").rows} == {"timeout"}


MISTAKES = {
    "--compare.solvers cerez": "unknown solver 'cerez'; did you mean ceres?",
    "--data .": "give --data or --run, not both",
    "--compare.solvers ipopt,ceres,ipopt": "key 'compare': solvers: ipopt is named twice; name it once",
    "--compare.monte-carlo.frames 20,20": "'compare.monte_carlo': frames: 20 is named twice; name it once",
    "--compare.monte-carlo.motions flip,flip": "'compare.monte_carlo': motions: flip is named twice; name",
    "--compare.cold False": "no start is selected: set cold to true, or perturbed or near to at least 1",
    "--truth .": ".: has no truth (mav0/target0); give the sequence",
    "--truth nowhere": "nowhere: no such folder",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes_are_one_line(words: str, compare: Compare, capsys: Capture) -> None:
    assert compare(*words.split()) == 2
    stderr = capsys.readouterr().err
    assert MISTAKES[words] in stderr and stderr.count("\n") == 1


def test_a_row_that_was_changed_or_is_of_another_version_is_measured_again(
    compare: Compare, out: Path, caplog: pytest.LogCaptureFixture
) -> None:
    words = ("--compare.solvers", "odometry")
    assert compare(*words) == 0
    (file,) = (out / "rows").iterdir()
    measured = json.loads(file.read_text())
    before = Row.model_validate(measured["row"]).model_copy(update={"message": "of before"})
    stamp = measured["stamp"]
    other = {**stamp, "versions": {**stamp["versions"], "scipy": "0.1"}}
    for stored, is_used in ((stamp, True), (other, False)):
        store_row(file, stored, before)
        assert compare(*words) == 0 and "measured again" not in caplog.text
        assert (read_comparison(out / "compare.json").rows[0].message == "of before") == is_used
    for change in ({"row": {**measured["row"], "status": "ok", "cost": 1.0}}, {"digest": None}):
        file.write_text(json.dumps({**measured, **change}))
        caplog.clear()
        assert compare(*words) == 0
        assert f"{file}: was changed since it was measured; it is measured again" in caplog.text
        (row,) = read_comparison(out / "compare.json").rows
        assert (row.status, row.cost) == ("baseline", measured["row"]["cost"])


def test_input_that_is_refused_leaves_everything_as_it_was(
    compare: Compare, out: Path, tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "data" / "mav0" / "cam0").mkdir(parents=True)
    bad = ("--data", str(tmp_path / "data"))
    deep = tmp_path / "a" / "out"
    assert compare(*SOLVERS, source=bad, place=deep) == 2
    assert not deep.parent.exists()
    deep.mkdir(parents=True)
    write_mark(deep, {"plan": ["planning.json"]})
    marked = contents(deep)
    assert compare(*SOLVERS, source=bad, place=deep) == 2
    assert contents(deep) == marked and list(deep.iterdir()) == [deep / MARK]
    assert capsys.readouterr().err.count("\n") == 2
    assert compare("--compare.solvers", "odometry") == 0
    before = contents(out)
    assert compare("--compare.solvers", "odometry", "--seed", "9", source=bad) == 2
    assert contents(out) == before
