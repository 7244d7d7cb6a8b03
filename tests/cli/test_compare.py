"""``polhode compare`` as a user meets it."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.compare import comparison
from polhode.compare.comparison import claim
from polhode.compare.problem.sources import SCENES
from polhode.compare.rows import Case, Row, read_comparison
from polhode.compare.solver import Entry
from polhode.compare.solver_process import row_of
from polhode.files.output.marked_folder import MARK, write_mark
from polhode.run_directory.archives import write_measurements
from polhode.runtime.errors import InputError
from polhode.simulation.monte_carlo import generate
from tests.conftest import MakeOnce
from tests.figures_of_page import text_of_figures

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


@pytest.fixture(scope="module")
def earlier(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A comparison of one solver."""
    folder = tmp_path_factory.mktemp("earlier") / "out"
    assert main(["compare", "--run", str(run), "-o", str(folder), "--compare.solvers", "odometry"]) == 0
    return folder


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
    assert "cost over the least" in text_of_figures(page)
    assert re.search(r"(src|href)\s*=\s*[\"']?https?:", page) is None, "nothing is loaded from elsewhere"
    assert len((out / "compare.csv").read_text().splitlines()) == 3

    # the same folder again
    assert compare("--compare.solvers", "odometry", "--quiet") == 0
    assert capsys.readouterr().out == f"Comparison: {out / 'compare.html'}\n"
    assert [row.solver for row in read_comparison(out / "compare.json").rows] == ["odometry"]


def test_an_interrupt_leaves_what_was_measured_and_an_earlier_comparison_as_it_was(
    compare: Compare, earlier: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = list[Row]()

    def interrupted(file: Path, entry: Entry, case: Case, limit_s: float) -> Row:
        """The first solver is measured once; the second one is interrupted."""
        if entry.name == "odometry":
            raise KeyboardInterrupt
        if not measured:
            measured.append(row_of(file, entry, case, limit_s))
        return measured[0]

    with monkeypatch.context() as patch:
        patch.setattr(comparison, "row_of", interrupted)
        assert compare(*SOLVERS) == 130
    assert [row.solver for row in read_comparison(out / "compare.json").rows] == ["gauss_newton"]
    shutil.rmtree(out)
    shutil.copytree(earlier, out)
    before = contents(out)
    with monkeypatch.context() as patch:
        patch.setattr(comparison, "row_of", interrupted)
        assert compare(*SOLVERS) == 130
    assert contents(out) == before


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


def test_a_folder_of_other_things_is_not_touched_and_our_own_is_gone_on_with(
    compare: Compare, tmp_path: Path, capsys: Capture
) -> None:
    # a folder rows/ or a config.yaml of somebody else's does not make it ours
    for name in ("letter.txt", "rows/notes.json", "config.yaml", "compare.json", ".polhode-compare"):
        other = tmp_path / f"other-{name.replace('/', '-')}"
        (other / name).parent.mkdir(parents=True)
        (other / name).write_text("dear")
        assert compare(place=other) == 2
        stderr = capsys.readouterr().err
        first = name.split("/")[0]
        assert f"{first}, which polhode compare did not write" in stderr and stderr.count("\n") == 1
        assert contents(other) == {other / name: b"dear"}
    assert compare(source=("--run", str(tmp_path / "no")), place=tmp_path / "new") == 2
    assert "no such folder" in capsys.readouterr().err and not (tmp_path / "new").exists()
    own = tmp_path / "own"
    claim(own)
    (own / "mine.txt").write_text("kept")
    claim(own)
    assert (own / MARK).is_file() and (own / "mine.txt").read_text() == "kept"
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="this is a file"):
        claim(tmp_path / "file")


def test_input_that_is_refused_leaves_everything_as_it_was(
    compare: Compare, earlier: Path, out: Path, tmp_path: Path, capsys: Capture
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
    shutil.copytree(earlier, out)
    before = contents(out)
    assert compare("--compare.solvers", "odometry", "--seed", "9", source=bad) == 2
    assert contents(out) == before
