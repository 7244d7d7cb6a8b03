"""Figures of README.md and docs/validation.md are those of records; functions that a page names exist."""

import re

import pytest

from lab.end_to_end import against_slam, footprint, thesis
from lab.presentation import markdown_table
from lab.record import lines_of
from lab.registry import BENCHMARKS
from tests.docs.page_code import ROOT

README = (ROOT / "README.md").read_text()
VALIDATION = (ROOT / "docs" / "validation.md").read_text()
ROWS = [line.strip("| ").split(" | ") for line in VALIDATION.splitlines() if "`python -m " in line]


def test_tables_of_the_readme_are_those_of_the_records() -> None:
    (line,) = lines_of(thesis.RECORD)
    assert markdown_table(thesis.HEAD, thesis.table_rows(line)) in README
    rows = [against_slam.row_of(line) for line in lines_of(against_slam.RECORD)]
    assert markdown_table(against_slam.HEAD, rows) in README
    for line in lines_of(footprint.RECORD):
        name, _, value = footprint.line_of(line).partition(": ")
        assert f"| {name} | {value}" in README


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[3].split()[2])
def test_rows_of_validation_have_figures_of_their_pages_and_the_day_of_their_record(row: list[str]) -> None:
    _, against, figure, command, day, link = row
    module = command.split()[2].removeprefix("benchmarks.").strip("`")
    assert module in {each.module for each in BENCHMARKS}
    page = (ROOT / "docs" / link.split("](")[1].split(")")[0].partition("#")[0]).read_text()
    figures = re.findall(r"\d+\.\d+", f"{against} {figure}")
    assert figures or "0 wrong" in figure
    assert [each for each in figures if each not in page] == []
    lines = list(lines_of(ROOT / "lab" / "records" / module.rpartition(".")[2]))
    if module == "trust.trust":
        lines = [line for line in lines if line["case"]["group"] in ("configs", "new")]
    days = {line["made"]["time"][:10] for line in lines if line.get("made", {}).get("time")}
    assert not days or day == max(days)


def test_functions_of_the_life_of_a_pair_are_in_the_files_that_it_names() -> None:
    page = (ROOT / "docs" / "life_of_a_pair.md").read_text()
    found = re.findall(r"((?:`\w+`(?:, )?)+) in \[`[\w.]+`\]\(\.\./([\w/.]+)\)", page)
    assert len(found) > 12
    for names, path in found:
        text = (ROOT / path).read_text()
        assert [name for name in re.findall(r"\w+", names) if f"def {name}(" not in text] == [], path
