"""Records of long benchmarks: one JSON line per case, cases on several processes, and what made each line.

An interrupted benchmark continues with the cases that its record lacks. A result is old when the code that it
depends on or the default configuration has changed since the commit that it names, or when that code had
uncommitted changes.
"""

import hashlib
import json
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.command import ROOT
from benchmarks.registry import code_of
from polhode.processes import as_finished

Case = dict[str, Any]
"""Identifies a measurement; its values are strings, numbers or booleans."""
Provenance = dict[str, Any]

CASES_PER_PROCESS = 20


def complete(path: Path, cases: Iterable[Case], measure: Callable[[Case], Case], workers: int) -> list[Case]:
    """Measure the cases that the file lacks, append them to it, and return the lines of all cases.

    ``measure`` runs in another process; its result becomes a line, with the case under "case" and its
    provenance under "made". Prints how many of the stored lines are current or old.
    """
    wanted, code = list(cases), code_of(_module(measure))
    done = {_key(line["case"]): line for line in _lines(path)}
    missing = [case for case in wanted if _key(case) not in done]
    counts = Counter(state(done[key].get("made"), code) for key in map(_key, wanted) if key in done)
    for description, count in counts.most_common():
        print(f"{count} stored result{'s' if count > 1 else ''}: {description}.")
    if missing:
        path.parent.mkdir(parents=True, exist_ok=True)
        joined = _Joined(measure, provenance(code))
        with path.open("a") as stream:
            if path.stat().st_size and not path.read_text().endswith("\n"):
                # end a line that an interrupt has truncated
                stream.write("\n")
            for number, line in enumerate(_results(joined, missing, workers), start=1):
                done[_key(line["case"])] = line
                stream.write(json.dumps(line) + "\n")
                stream.flush()
                print(f"\r{number} of {len(missing)}", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
    return [done[_key(case)] for case in wanted]


def _results(measure: Callable[[Case], Case], cases: list[Case], workers: int) -> Iterator[Case]:
    """Results in any order. Processes are replaced now and then, since compiled code accumulates in them."""
    step = CASES_PER_PROCESS * workers
    for start in range(0, len(cases), step):
        yield from as_finished(measure, cases[start : start + step], workers)


def forget(path: Path, unwanted: Callable[[Case], bool]) -> None:
    """Remove the lines of such cases from the file, so that they are measured again."""
    kept = [line for line in _lines(path) if not unwanted(line["case"])]
    if path.is_file():
        draft = path.with_suffix(".draft")
        draft.write_text("".join(json.dumps(line) + "\n" for line in kept))
        draft.replace(path)


def measured(path: Path, cases: Iterable[Case]) -> list[Case]:
    """Lines of those cases that the file has."""
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
            # the last line of an interrupted run may be truncated
            continue


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
