"""What checkout says: the values of every check over sound sequences, beside its limits, and of faulty ones.

    python -m benchmarks.checkout.sequences [SEQ ...] [--places 10] [--table] [--short]

Each sequence is a row of the record; the sample and its faulty versions (``benchmarks/checkout/faults.py``)
are always among them. First table: what does not pass, for each sequence. Second: least, median and largest
value of each check over the sequences without faults, and its limits. Third: the faults, whether the check
that must find each does, and what else does not pass.
"""

import json
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.checkout.faults import FAULTS, write_faulty
from benchmarks.command import RECORDS, ROOT, Record, Sequences, Short, Workers, command
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete, measured
from polhode.pipeline.checkout.checkout import checkout
from polhode.pipeline.checkout.sample import PLACES

RECORD = RECORDS / "checkout"
SAMPLE = ROOT / "sample"
SHORT = ("pitch", "clocks")
UNNAMED = ("sequence", "rendered", "none")
"""Folders of that name say nothing of the sequence in them"""


def main(
    sequences: Sequences = (),
    places: Annotated[int, arg(help="Places at which two successive pairs are examined.")] = PLACES,
    table: Annotated[bool, arg(help="Only print the tables of what the record has.")] = False,
    workers: Workers = 1,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Check what the record lacks and print the tables."""
    folders = {name_of(folder): folder for folder in (SAMPLE, *sequences)}
    names = ["sample"] if short else list(folders)
    cases: list[Case] = [{"sequence": name, "fault": "none"} for name in names]
    cases += [{"sequence": "sample", "fault": fault} for fault in (SHORT if short else FAULTS)]
    if table:
        cases = [line["case"] for line in measured_all(record)]
        lines = measured(record, cases)
    else:
        lines = complete(record, cases, Measure(folders, 2 if short else places), workers)
    print_tables(lines)


def name_of(folder: Path) -> str:
    """The last folder that says something."""
    return next(part for part in reversed(folder.resolve().parts) if part not in UNNAMED)


def measured_all(record: Path) -> list[Case]:
    """All lines of the record."""
    return [json.loads(text) for text in record.read_text().splitlines()] if record.is_file() else []


@dataclass(frozen=True)
class Measure:
    """One sequence."""

    folders: dict[str, Path] = field(default_factory=dict)
    places: int = PLACES

    def __call__(self, case: Case) -> Case:
        """Status, and value, status, limits of each check."""
        source = self.folders[case["sequence"]]
        with tempfile.TemporaryDirectory() as place:
            folder = source
            if case["fault"] != "none":
                folder = Path(place) / "faulty"
                write_faulty(source, FAULTS[case["fault"]], folder)
            result = checkout(folder, workers=1, count=self.places).result
        kept = ("value", "sigma", "unit", "limit", "fail_limit", "at_least", "status")
        checks = {check.name: {key: getattr(check, key) for key in kept} for check in result.checks}
        return {"status": result.status, "checks": checks}


def print_tables(lines: Sequence[Case]) -> None:
    """All three."""
    sound = [line for line in lines if line["case"]["fault"] == "none"]
    print()
    print_table(
        "sequence | status | does not pass",
        ((line["case"]["sequence"], line["status"], said(line)) for line in sound),
    )
    print()
    print_table("check | least | median | largest | warns | fails", distribution(sound))
    print()
    print_table(
        "fault | status | its check | others that do not pass",
        (fault_row(line) for line in lines if line["case"]["fault"] != "none"),
    )


def said(line: Case, without: Iterable[str] = ()) -> str:
    """Checks that do not pass, with their values."""
    return "; ".join(
        f"{name} {shown(check)}"
        for name, check in line["checks"].items()
        if check["status"] != "PASS" and name not in set(without)
    )


def shown(check: dict[str, Any]) -> str:
    """The value, and whether it fails."""
    value = "not measured" if check["value"] is None else f"{check['value']:.3g} {check['unit']}".strip()
    return f"{value} (FAIL)" if check["status"] == "FAIL" else value


def distribution(sound: Sequence[Case]) -> Iterable[list[str]]:
    """A row for each check that has values."""
    for name in dict.fromkeys(name for line in sound for name in line["checks"]):
        checks = [line["checks"][name] for line in sound if name in line["checks"]]
        values = [check["value"] for check in checks if check["value"] is not None]
        if not values:
            continue
        sign = "<" if checks[0]["at_least"] else ">"
        limits = [
            ""
            if checks[0][key] is None
            else f"{sign} {np.median([c[key] for c in checks if c[key] is not None]):.3g}"
            for key in ("limit", "fail_limit")
        ]
        unit = checks[0]["unit"]
        yield [
            f"{name} [{unit}]" if unit else name,
            *(f"{each:.3g}" for each in (min(values), float(np.median(values)), max(values))),
            *limits,
        ]


def fault_row(line: Case) -> list[str]:
    """Whether the fault is found."""
    fault = FAULTS[line["case"]["fault"]]
    check = line["checks"].get(fault.found_by)
    found = (
        "none can" if not fault.found_by else "" if check is None else f"{check['status']}: {shown(check)}"
    )
    return [fault.title, line["status"], found, said(line, [fault.found_by])]


if __name__ == "__main__":
    command(main)
