"""Records of long benchmarks: the result of each case, with the commit, machine and day that made it.

An interrupted benchmark continues with the cases that its record lacks. Results of an earlier commit count,
as some took hours; the time of each is stored with it.
"""

import hashlib
import json
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import ExitStack
from datetime import datetime
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from lab.command import ROOT
from polhode.runtime.errors import one_line
from polhode.runtime.threads import limit_threads
from polhode.studies.store import Store

Case = dict[str, Any]
"""Identifies a measurement; its values are strings, numbers or booleans."""
DONE = "done"


def complete(
    record: Path,
    cases: Iterable[Case],
    measure: Callable[[Case], Case],
    workers: int,
    process_each: bool = False,
) -> list[Case]:
    """Measure the cases that the record lacks, store them in it, and return the lines of all cases.

    ``measure`` runs in this process, in ``workers`` others if there are more than one, with ``process_each``
    in a new one for each case; its result becomes a line, with the case under "case" and its provenance under
    "made". Raises SystemExit where a case failed.
    """
    wanted = list(cases)
    done = {_key(line["case"]): line for line in lines_of(record)}
    missing = {_key(case): case for case in wanted if _key(case) not in done}
    if missing:
        failed = _measure_and_store(record, list(missing.values()), measure, workers, process_each)
        if failed:
            reasons = "; ".join(f"{count} x {reason}" for reason, count in failed.most_common(3))
            raise SystemExit(f"{failed.total()} of {len(missing)} cases failed: {reasons}")
        done |= {_key(line["case"]): line for line in lines_of(record)}
    return [done[_key(case)] for case in wanted]


def _measure_and_store(
    record: Path, cases: list[Case], measure: Callable[[Case], Case], workers: int, process_each: bool
) -> Counter[str]:
    """Reasons of the cases that failed, with their numbers."""
    store, made, failed = Store(record), provenance(), Counter[str]()
    workers = min(workers, len(cases))
    with ExitStack() as stack:
        if workers == 1 and not process_each:
            attempts: Iterator[tuple[Case, Future[Case]]] = ((case, _done(measure, case)) for case in cases)
        else:
            tasks = 1 if process_each else None
            pool = ProcessPoolExecutor(
                workers, get_context("spawn"), limit_threads, (1,), max_tasks_per_child=tasks
            )
            stack.enter_context(pool)
            futures = {pool.submit(measure, case): case for case in cases}
            attempts = ((futures[future], future) for future in as_completed(futures))
        for number, (case, future) in enumerate(attempts, start=1):
            print(f"{number} of {len(cases)} cases", file=sys.stderr, flush=True)
            error = future.exception()
            if error is not None:
                failed[one_line(f"{type(error).__name__}: {error}")] += 1
                continue
            settings = {f"case.{key}": value for key, value in case.items()}
            address = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
            found = {"made": made, **future.result()}
            store.write({"address": address, "status": DONE, "settings": settings, "measured": found})
    store.pack()
    return failed


def _done(measure: Callable[[Case], Case], case: Case) -> Future[Case]:
    """The result or the error of a case that is measured in this process."""
    future: Future[Case] = Future()
    try:
        future.set_result(measure(case))
    except Exception as error:  # noqa: BLE001  it is the reason of the case, as in another process
        future.set_exception(error)
    return future


def measured(record: Path, cases: Iterable[Case]) -> list[Case]:
    """Lines of those cases that the record has."""
    done = {_key(line["case"]): line for line in lines_of(record)}
    return [done[key] for key in map(_key, cases) if key in done]


def lines_of(record: Path) -> Iterator[Case]:
    """All cases that the record has, with their results."""
    for each in Store(record).records():
        if each["status"] == DONE:
            settings = each["settings"].items()
            case = {key.removeprefix("case."): value for key, value in settings if value is not None}
            yield {"case": case, **each["measured"]}


def _key(case: Case) -> str:
    return json.dumps(case, sort_keys=True)


def provenance() -> dict[str, Any]:
    """What makes a result now: commit, whether files have changed since it, machine, time."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "changed": bool(_git("status", "--porcelain", "--untracked-files=no")),
        "machine": f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        "time": datetime.now().astimezone().isoformat(timespec="minutes"),
    }


def _git(*words: str) -> str:
    """What git prints; empty where it fails."""
    try:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
