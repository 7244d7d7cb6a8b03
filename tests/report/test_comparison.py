"""``polhode report``: one run, or several side by side on one page."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from polhode.cli.main import main
from polhode.report import finish_run, write_comparison
from polhode.report.comparison import NO_VALUE, side_by_side
from polhode.report.template import inflated
from polhode.run_directory.stored_run import read_stored_run
from polhode.run_directory.summary import build_summary
from tests.pipeline.stored_run import stored

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def runs(example: Any, undetermined: Any, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One that tells everything, one that does not determine the inertia, one that failed."""
    top = tmp_path_factory.mktemp("runs")
    failed = top / "lost"
    failed.mkdir()
    finish_run(failed, build_summary(None, None, None, {}, failure="no consistent motion"))
    timing_s = {"backend": 2.0}
    good = [
        stored(top / name, run, run.surface, timing_s=timing_s)
        for name, run in (("tumbler", example), ("spinner", undetermined))
    ]
    return [*good, failed]


def figure(page: str, key: str) -> Any:
    found = re.search(rf'data-target="plot-{key}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(inflated(found[1]))


def test_several_runs_share_one_page(runs: list[Path], tmp_path: Path, capsys: Capture) -> None:
    output = tmp_path / "all.html"
    assert main(["report", *map(str, runs), "-o", str(output)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(str(output))
    page = output.read_text()
    assert all(f"<th>{run.name}</th>" in page for run in runs)
    assert "no consistent motion" in page
    assert not re.findall(r"(?:src|href)\s*=\s*['\"]?https?:", page)
    names = [trace["name"] for trace in figure(page, "rates")["data"]]
    assert names == ["tumbler", "spinner"]
    ratios = figure(page, "ratios")["data"]
    symbols = {trace["name"]: trace["marker"]["symbol"] for trace in ratios if trace.get("name") in names}
    assert symbols["tumbler"] == "circle" and symbols["spinner"] == "circle-open"
    assert sum(trace.get("name") == "3σ" for trace in ratios) == 1


def test_a_number_that_a_run_does_not_hold_is_a_dash(runs: list[Path]) -> None:
    table = dict(side_by_side([read_stored_run(run, run.name) for run in runs]))
    assert table["solver"] == ["ipopt, 7 iterations"] * 2 + [NO_VALUE]
    assert all(len(cells) == len(runs) for cells in table.values())
    # The frame G is each run's own.
    assert not any(name.startswith("centre of mass") for name in table)


def test_runs_of_the_same_name_are_told_apart(example: Any, tmp_path: Path) -> None:
    folders = [stored(tmp_path / name / "run", example) for name in "ab"]
    write_comparison(folders, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert all(f"<th>{folder}</th>" in page for folder in folders)


@pytest.mark.parametrize("kind", ["nothing there", "no run", "no runs", "no folder", "a folder", "damaged"])
def test_a_mistake_is_one_line_and_exit_2(
    kind: str, runs: list[Path], tmp_path: Path, capsys: Capture
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "summary.json").write_text("{")
    page, good = str(tmp_path / "page.html"), str(runs[0])
    arguments, words = {
        "nothing there": ([good, str(tmp_path / "none"), "-o", page], "none"),
        "no run": ([str(tmp_path / "empty"), "-o", page], "give the folder of a run"),
        "no runs": (["-o", page], "a run is missing"),
        "no folder": ([good, "-o", "/dev/null/page.html"], "part of this path is a file"),
        "a folder": ([good, "-o", str(tmp_path)], "is a folder"),
        "damaged": ([good, str(tmp_path / "broken"), "-o", page], "line 1: not valid JSON"),
    }[kind]
    assert main(["report", *arguments]) == 2
    stderr = capsys.readouterr().err
    assert words in stderr and stderr.count("\n") == 1
    assert not Path(page).exists()


def test_evaluation_enters_the_report(
    example: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    folder = stored(tmp_path / "run", example)
    assert "Against the truth" not in (folder / "report.html").read_text()

    def measured(run: Path, data: Path) -> dict[str, Any]:
        return {"rmse_position_m": 0.000081}

    monkeypatch.setattr("polhode.report.page.evaluate", measured)
    assert main(["evaluate", str(folder), str(tmp_path)]) == 0
    page = (folder / "report.html").read_text()
    assert "Against the truth" in page and "0.081" in page
    assert json.loads((folder / "metrics.json").read_text())["rmse_position_m"] == 0.000081
    assert "rmse_position_m" in capsys.readouterr().out
