"""Records of long benchmarks: studies, whose points are the cases, with what made each of them.

    python -m benchmarks.record DIR OTHER [OTHER ...]

adds the cases of other records to one: those of other machines, for instance.

An interrupted benchmark continues with the cases that its record lacks. A result is old when the code that it
depends on or the default configuration has changed since the commit that it names, or when that code had
uncommitted changes. Unlike those of ``polhode sweep``, old results count, as some took hours; what is printed
says how many there are.
"""

import hashlib
import importlib
import json
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from benchmarks.command import ROOT, command
from benchmarks.registry import code_of
from polhode.config.study_settings import Study
from polhode.console import progress_of_points
from polhode.output.marked_folder import claim
from polhode.studies.cluster import ClusterOptions
from polhode.studies.factors import Changes, factor_of_points
from polhode.studies.flat_metrics import flattened
from polhode.studies.measurement import CASE, MEASURE, MeasuredPoint, Measurement
from polhode.studies.steps import DONE, failed_record
from polhode.studies.store import Record as StoredRecord
from polhode.studies.store import Store
from polhode.studies.study import OpenStudy
from polhode.studies.sweep import sweep
from polhode.studies.table import COMMAND, FILES

Case = dict[str, Any]
"""Identifies a measurement; its values are strings, numbers or booleans."""
Provenance = dict[str, Any]


def main(
    record: Positional[Annotated[Path, arg(metavar="DIR", help="Record that the cases are added to.")]],
    others: Positional[Annotated[tuple[Path, ...], arg(metavar="OTHER", help="Other records.")]],
) -> None:
    """Add the cases of other records to one; what both have stays as it is there."""
    known = {_key(line["case"]) for line in lines_of(record)}
    for other in others:
        lines = [line for line in lines_of(other) if _key(line["case"]) not in known]
        add(record, lines)
        known |= {_key(line["case"]) for line in lines}
        print(f"{len(lines)} cases of {other}")


def complete(
    record: Path, cases: Iterable[Case], measure: Callable[[Case], Case], workers: int
) -> list[Case]:
    """Measure the cases that the record lacks, store them in it, and return the lines of all cases.

    ``record``: folder of a study, which has a table and a page of all its cases. ``measure`` runs in another
    process; its result becomes a line, with the case under "case" and its provenance under "made". Prints how
    many of the stored lines are current or old.
    """
    wanted, code = list(cases), code_of(_module(measure))
    done = {_key(line["case"]): line for line in lines_of(record)}
    counts = Counter(state(done[key].get("made"), code) for key in map(_key, wanted) if key in done)
    for description, count in counts.most_common():
        print(f"{count} stored result{'s' if count > 1 else ''}: {description}.")
    missing = {_key(case): case for case in wanted if _key(case) not in done}
    if missing:
        measurement = Measurement(_Measured(_importable(measure), provenance(code)))
        points = [*(line["case"] for line in done.values()), *missing.values()]
        options = ClusterOptions(workers=workers, own_processes=True)
        swept = sweep(study_of(record, points, measurement), record, progress_of_points(), options, True)
        if swept.failed:
            reasons = "; ".join(f"{count} x {reason}" for reason, count in swept.reasons.most_common(3))
            raise SystemExit(f"{swept.failed} of {len(missing)} cases failed: {reasons}")
        done |= {_key(line["case"]): line for line in lines_of(record)}
    return [done[_key(case)] for case in wanted]


def measured(record: Path, cases: Iterable[Case]) -> list[Case]:
    """Lines of those cases that the record has."""
    done = {_key(line["case"]): line for line in lines_of(record)}
    return [done[key] for key in map(_key, cases) if key in done]


def forget(record: Path, unwanted: Callable[[Case], bool]) -> None:
    """Remove the lines of such cases from the record, so that they are measured again."""
    store = Store(record)
    store.pack(without={each["address"] for each in store.records() if unwanted(_case_of(each))})


def add(record: Path, lines: Sequence[Case]) -> None:
    """Store lines that were measured elsewhere; what is "made" of each stays as it is."""
    claim(record, COMMAND, FILES)
    store, study = Store(record), study_of(record, [line["case"] for line in lines], None)
    for number, line in enumerate(lines):
        point = study.point(number)
        values = {key: value for key, value in line.items() if key != "case"}
        found = {"status": DONE, "measured": values, "metrics": flattened(MEASURE, values)}
        store.write(failed_record(point.address, point.values, "") | found)
    store.pack(study.point(number).address for number in range(study.count))


def lines_of(record: Path) -> Iterator[Case]:
    """Of all cases that the record has."""
    for each in Store(record).records():
        if each["status"] == DONE:
            yield {"case": _case_of(each), **each["measured"]}


def study_of(record: Path, cases: Sequence[Case], measurement: Measurement | None) -> "CaseStudy":
    """The cases as the points of a study."""
    settings = Study(
        title=f"{record.name}: one of the project's benchmarks",
        points=tuple({f"{CASE}.{key}": value for key, value in case.items()} for case in cases),
        steps=(MEASURE,),
        keep="nothing",
        metrics=("measure.*",),
    )
    return CaseStudy(
        settings, {}, (factor_of_points(settings.points, record.name),), record.name, measurement
    )


@dataclass(frozen=True)
class CaseStudy(OpenStudy):
    """A study whose points have the addresses of their cases, whatever code measures them."""

    def address_of(self, changes: Changes) -> str:
        """Of the case with these settings."""
        return hashlib.sha256(json.dumps(changes, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class _Measured:
    """Runs in the other process."""

    measure: Callable[[Case], Case]
    made: Provenance

    def __call__(self, point: MeasuredPoint) -> Mapping[str, Any]:
        return {"made": self.made, **self.measure(point.case)}


def _case_of(record: StoredRecord) -> Case:
    settings = record["settings"].items()
    return {key.removeprefix(f"{CASE}."): value for key, value in settings if value is not None}


def _importable(measure: Callable[[Case], Case]) -> Callable[[Case], Case]:
    """The same function, of the module that ``python -m`` runs as ``__main__`` by its own name."""
    if getattr(measure, "__module__", "") != "__main__" or not hasattr(measure, "__qualname__"):
        return measure
    found: Callable[[Case], Case] = getattr(importlib.import_module(_module(measure)), measure.__qualname__)
    return found


def _module(measure: Callable[[Case], Case]) -> str:
    """Name of the module that defines a function, or the class of a callable object."""
    name: str = getattr(measure, "__module__", "") or type(measure).__module__
    specification = sys.modules["__main__"].__spec__
    return specification.name if name == "__main__" and specification is not None else name


def _key(case: Case) -> str:
    return json.dumps(case, sort_keys=True)


@cache
def provenance(code: tuple[str, ...]) -> Provenance:
    """Of a result that is measured now; ``code``: the folders that it depends on."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--untracked-files=no", "--", *code)),
        "configuration": default_configuration(),
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "time": datetime.now().astimezone().isoformat(timespec="minutes"),
    }


@cache
def default_configuration() -> str:
    """A digest of the default configuration, of which a case changes only what it names."""
    from polhode.config import Config
    from polhode.config.loader import dump_config

    return hashlib.sha256(dump_config(Config()).encode()).hexdigest()[:12]


def state(made: Provenance | None, code: tuple[str, ...]) -> str:
    """Whether a stored result is current, as a sentence without its full stop."""
    if not made or not made.get("commit"):
        return "recorded before records named their commit"
    short = made["commit"][:9]
    if made["changed"]:
        return f"old: made with uncommitted changes on {short}"
    last = last_change(code)
    if last and not _is_ancestor(last, made["commit"]):
        return f"old: made at {short}, and {', '.join(code)} changed in {last[:9]} since then"
    if made["configuration"] != default_configuration():
        return f"old: made at {short} with another default configuration ({made['configuration']})"
    return f"current, made at {short}"


@cache
def last_change(code: tuple[str, ...]) -> str:
    """The last commit that changed the folders; empty outside of a repository."""
    return _git("rev-list", "-1", "HEAD", "--", *code)


@cache
def _is_ancestor(earlier: str, later: str) -> bool:
    command = ["git", "merge-base", "--is-ancestor", earlier, later]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0


def _git(*words: str) -> str:
    """What git prints; empty where it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


if __name__ == "__main__":
    command(main)
