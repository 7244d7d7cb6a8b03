"""Long benchmarks that can be interrupted: one JSON line per case in a file, cases on several processes.

Each line names what made it (``benchmarks/provenance.py``) under "made".
"""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from benchmarks.provenance import Provenance, print_states, provenance
from benchmarks.registry import code_of
from polhode.processes import as_finished

Case = dict[str, Any]
"""What names a case: its values are strings, numbers or booleans."""

CASES_PER_PROCESS = 20


def complete(path: Path, cases: Iterable[Case], measure: Callable[[Case], Case], workers: int) -> list[Case]:
    """Measure the cases that the file lacks, append them to it, and return the lines of all cases.

    ``measure`` runs in another process; its answer becomes a line, with the case under "case". Of the lines
    that the file had before, what made them is printed, and whether they are old.
    """
    wanted, code = list(cases), code_of(_module(measure))
    done = {_key(line["case"]): line for line in _lines(path)}
    missing = [case for case in wanted if _key(case) not in done]
    print_states((done[key].get("made") for key in map(_key, wanted) if key in done), code)
    if missing:
        path.parent.mkdir(parents=True, exist_ok=True)
        joined = _Joined(measure, provenance(code))
        with path.open("a") as stream:
            if path.stat().st_size and not path.read_text().endswith("\n"):
                # the rest of a line that was cut off
                stream.write("\n")
            for number, line in enumerate(_results(joined, missing, workers), start=1):
                done[_key(line["case"])] = line
                stream.write(json.dumps(line) + "\n")
                stream.flush()
                print(f"\r{number} of {len(missing)}", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
    return [done[_key(case)] for case in wanted]


def _results(measure: Callable[[Case], Case], cases: list[Case], workers: int) -> Iterator[Case]:
    """What comes of each case, in any order. Processes are replaced now and then: compiled code piles up."""
    step = CASES_PER_PROCESS * workers
    for start in range(0, len(cases), step):
        yield from as_finished(measure, cases[start : start + step], workers)


def forget(path: Path, unwanted: Callable[[Case], bool]) -> None:
    """Take the lines of such cases out of the file, so that they are measured again."""
    kept = [line for line in _lines(path) if not unwanted(line["case"])]
    if path.is_file():
        draft = path.with_suffix(".draft")
        draft.write_text("".join(json.dumps(line) + "\n" for line in kept))
        draft.replace(path)


def measured(path: Path, cases: Iterable[Case]) -> list[Case]:
    """Lines of those of the cases that the file has."""
    done = {_key(line["case"]): line for line in _lines(path)}
    return [done[key] for key in map(_key, cases) if key in done]


class _Joined:
    """Runs in the other process."""

    def __init__(self, measure: Callable[[Case], Case], made: Provenance) -> None:
        self.measure, self.made = measure, made

    def __call__(self, case: Case) -> Case:
        return {"case": case, "made": self.made, **self.measure(case)}


def _module(measure: Callable[[Case], Case]) -> str:
    """Name of the module that defines a function, or the class of a callable object."""
    name: str = getattr(measure, "__module__", "") or type(measure).__module__
    specification = sys.modules["__main__"].__spec__
    return specification.name if name == "__main__" and specification is not None else name


def _key(case: Case) -> str:
    return json.dumps(case, sort_keys=True)


def _lines(path: Path) -> Iterator[Case]:
    if not path.is_file():
        return
    for text in path.read_text().splitlines():
        try:
            yield json.loads(text)
        except json.JSONDecodeError:
            # the last line of an interrupted run may be cut off
            continue
