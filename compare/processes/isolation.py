"""Each solver in a process of its own: one that crashes, hangs or is missing costs its row only."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time
from typing import Any

from polhode.compare.problem.measured_problem import load
from polhode.compare.processes.solver_process import (
    entry_text,
    finite,
    of_point,
    out_of_time,
    peak_mb,
    storable,
)
from polhode.compare.registry import Entry
from polhode.compare.rows import Case, Row
from polhode.compare.solver_progress import read_point, read_trace, read_words, seconds_since_start

UNKNOWN: dict[str, Any] = dict.fromkeys(
    ("cost", "gain_left", "iterations", "wall_s", "build_s", "evaluation_s", "linear_s", "callback_s",
     "memory_mb", "memory_before_mb", "k1", "k2", "sigma_k1", "sigma_k2", "sigma_com_mm", "errors")
) | {"kept": "nothing", "not_separable": "", "trace": [], "ran": True}  # fmt: skip
ENDED = "its process ended before its times were read"


@dataclass(frozen=True)
class Ending:
    """How a process ended."""

    code: int | None
    """None: it was ended at its limit"""
    words: str
    """What it said on standard error"""
    memory_mb: float | None = None


def row_of(problem_file: Path, entry: Entry, case: Case, limit_s: float) -> Row:
    """Solve in a new process; whatever happens to it, there is a row."""
    package = entry.missing()
    if package is not None:
        words = f"the package {package} is not installed: pip install 'polhode[solvers]'"
        return empty_row(entry, case, "missing", words)
    with TemporaryDirectory(prefix="polhode-compare-") as folder:
        out, begin = Path(folder) / "row.json", time()
        told = {**case.model_dump(), "limit_s": limit_s, "started": begin}
        command = [sys.executable, "-P", "-m", "polhode.compare.processes.solver_process",
                   str(problem_file), entry_text(entry), json.dumps(told), str(out)]  # fmt: skip
        ending = _run(command, limit_s)
        if out.is_file():
            try:
                return _row(entry, case, storable(json.loads(out.read_text())))
            except ValueError as error:
                words = f"its answer cannot be read: {str(error)[:150]}"
                return _row(entry, case, {"status": "failed", "message": words})
        return _row(entry, case, _left_behind(problem_file, out, ending, limit_s))


def empty_row(entry: Entry, case: Case, status: str, message: str) -> Row:
    """A row of a solver that did not run."""
    return _row(entry, case, {"status": status, "message": message, "ran": False})


def _left_behind(problem_file: Path, stem: Path, ending: Ending, limit_s: float) -> dict[str, Any]:
    """What is known of a process that ended without an answer: what it had reached, judged here."""
    wall_s, trace, point = seconds_since_start(stem), finite(read_trace(stem)), read_point(stem)
    kept, x = ("nothing", None) if point is None else point
    judged = of_point(load(problem_file), kept, x)
    if ending.code is None:
        status, message = (
            "timeout",
            f"ended at its limit: {out_of_time(limit_s, wall_s, read_words(stem), kept)}",
        )
    else:
        status, message = "failed", _last_words(ending.code, ending.words)
    told = {"wall_s": wall_s, "iterations": len(trace), "memory_mb": ending.memory_mb, "trace": trace}
    return storable({"status": status, "message": message, **judged, **told, "not_separable": ENDED})


def _row(entry: Entry, case: Case, known: dict[str, Any]) -> Row:
    own = {**case.model_dump(), "family": entry.family, "claim": entry.claim}
    return Row.model_validate({**own, **UNKNOWN, **known})


def _run(command: list[str], limit_s: float) -> Ending:
    """Until it ends, or its limit ends it."""
    # the child takes our packages from where this process has them, wherever it was started
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    environment.pop("PYTHONFAULTHANDLER", None)
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
        env=environment,
    )
    try:
        _, words = process.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired:
        memory = peak_mb(process.pid)
        _end(process)
        return Ending(None, "", memory)
    except BaseException:
        _end(process)
        raise
    return Ending(process.returncode, words)


def _end(process: "subprocess.Popen[str]") -> None:
    """End the process and what it started: it has a session of its own."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def _last_words(code: int, words: str) -> str:
    lines = [line.strip() for line in words.splitlines() if line.strip()]
    said = lines[-1][:200] if lines else "it said nothing"
    if code < 0:
        return f"the process died of {signal.Signals(-code).name}: {said}"
    return f"the process ended with {code} and left no answer: {said}"
