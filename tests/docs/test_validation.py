"""docs/validation.md: every row names a benchmark, the day of its record, and figures of its page."""

import re
from dataclasses import dataclass

import pytest

from benchmarks.record import lines_of
from benchmarks.registry import BENCHMARKS, Benchmark
from tests.docs.page_code import ROOT
from website.benchmarks_page import record_name


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    figure: str
    module: str
    day: str
    page: str


def rows() -> list[Row]:
    """Those of the page."""
    text = (ROOT / "docs" / "validation.md").read_text()
    cells = [line.strip("| ").split(" | ") for line in text.splitlines() if "`python -m " in line]
    return [
        Row(
            f"{against} {figure}",
            command.split()[2].removeprefix("benchmarks.").strip("`"),
            day,
            link.split("](")[1].split(")")[0].partition("#")[0],
        )
        for _, against, figure, command, day, link in cells
    ]


def benchmark_of(row: Row) -> Benchmark:
    return next(each for each in BENCHMARKS if each.module == row.module)


def test_there_are_four_to_eight_rows() -> None:
    assert 4 <= len(rows()) <= 8


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.module)
def test_the_figures_stand_in_the_page_that_is_linked(row: Row) -> None:
    page = (ROOT / "docs" / row.page).read_text()
    figures = re.findall(r"\d+\.\d+", row.figure)
    assert figures or re.search(r"\b(0 wrong|30 of 30)", row.figure)
    assert [each for each in figures if each not in page] == []


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.module)
def test_the_day_is_that_of_the_last_line_of_the_record(row: Row) -> None:
    record = ROOT / "benchmarks" / "records" / record_name(benchmark_of(row))
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", row.day)
    lines = list(lines_of(record))
    if row.module == "trust.trust":
        lines = [line for line in lines if line["case"]["group"] in ("configs", "new")]
    days = {line["made"]["time"][:10] for line in lines if line.get("made", {}).get("time")}
    assert not days or row.day == max(days)


def test_no_run_of_the_record_with_faults_is_wrong_and_confident() -> None:
    """As the table of docs/robustness.md has it, whose columns are counted from the record."""
    page = (ROOT / "docs" / "robustness.md").read_text()
    total = next(line for line in page.splitlines() if line.startswith("| **all** | **324**"))
    assert total.split("|")[3].strip() == ""
    assert "0 wrong and confident" in (ROOT / "docs" / "trust.md").read_text()
