"""What pages say of the laboratory: their figures are those of records, their commands are understood.

    python -m lab.pages

Tables of README.md are made again from the records; each row of docs/validation.md has a benchmark, figures
that stand on the page of its topic, and the day of its record; each ``python -m lab...`` and
``make bench-...`` of a page has options that its command line knows. Nothing is measured. Exit code 1: one of
them is not so.
"""

import contextlib
import functools
import importlib
import io
import re
import shlex
import sys
from collections.abc import Iterator
from typing import Any

import tyro

from lab.command import RECORDS, ROOT
from lab.end_to_end import against_slam, footprint, thesis
from lab.presentation import markdown_table
from lab.record import lines_of
from lab.registry import BENCHMARKS

PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "lab").glob("*/README.md")),
]
COMMAND = re.compile(r"(?:python -m (lab[\w.]*)((?: +(?:\\\n *)?[^\s`#|\\]+)*)|make bench-(\w+))")


def readme_faults() -> Iterator[str]:
    """Tables and figures of the README that their records would print otherwise."""
    readme = (ROOT / "README.md").read_text()
    (line,) = lines_of(thesis.RECORD)
    expected = {"thesis": markdown_table(thesis.HEAD, thesis.table_rows(line))}
    rows = [against_slam.row_of(each) for each in lines_of(against_slam.RECORD)]
    expected["against_slam"] = markdown_table(against_slam.HEAD, rows)
    for line in lines_of(footprint.RECORD):
        name, _, value = footprint.line_of(line).partition(": ")
        expected[f"footprint, {name}"] = f"| {name} | {value}"
    yield from (
        f"README.md: not as in the record of {name}" for name, text in expected.items() if text not in readme
    )


def validation_faults() -> Iterator[str]:
    """Rows of docs/validation.md whose benchmark, figures or day are not those of page and record."""
    lines = (ROOT / "docs" / "validation.md").read_text().splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if "`python -m " in line]
    if not rows:
        yield "docs/validation.md: no row names a command"
    for subject, against, figure, command, day, link in rows:
        module = command.split()[2].removeprefix("lab.").strip("`")
        page = (ROOT / "docs" / link.split("](")[1].split(")")[0].partition("#")[0]).read_text()
        figures = re.findall(r"\d+\.\d+", f"{against} {figure}")
        wrong = [] if module in {each.module for each in BENCHMARKS} else [f"no benchmark {module}"]
        wrong += [f"{each} is not on its page" for each in figures if each not in page]
        if not figures and "0 wrong" not in figure:
            wrong.append("no figure")
        measured = list(lines_of(RECORDS / module.rpartition(".")[2]))
        days = {line["made"]["time"][:10] for line in measured if line.get("made", {}).get("time")}
        if days and day != max(days):
            wrong.append(f"measured on {max(days)}, not {day}")
        yield from (f"docs/validation.md: {subject}: {each}" for each in wrong)


def command_faults() -> Iterator[str]:
    """Commands of the laboratory that a page names and that cannot be run as they stand."""
    targets = {name for each in BENCHMARKS for name in (each.name, each.topic)}
    for page in PAGES:
        for module, options, target in COMMAND.findall(page.read_text()):
            if target:
                fault = "" if target in targets else "no such benchmark"
            else:
                # brackets hold what may be left out
                fault = option_fault(module, shlex.split(options.partition("[")[0].replace("\\\n", " ")))
            if fault:
                yield f"{page.name}: {module or f'bench-{target}'}{options}: {fault}"


def option_fault(module: str, words: list[str]) -> str:
    """What the command line of a module says of the words; empty: it understands them."""
    try:
        found = importlib.import_module(module)
        main = (importlib.import_module(f"{module}.__main__") if hasattr(found, "__path__") else found).main
    except (ModuleNotFoundError, AttributeError) as missing:
        return str(missing)
    if module == "lab.release":  # reads its own two options
        return ""

    @functools.wraps(main)
    def stub(*_: Any, **__: Any) -> None:
        return None

    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            tyro.cli(stub, args=words, config=(tyro.conf.FlagCreatePairsOff,))
    except SystemExit as stop:
        return said.getvalue() if stop.code else ""
    return ""


def main() -> None:
    """Print the faults."""
    faults = [*readme_faults(), *validation_faults(), *command_faults()]
    print(*faults, f"{len(PAGES)} pages, {len(faults)} faults", sep="\n")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
