"""Each solver in a process of its own: one that crashes, hangs or is missing costs its row only."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time
from typing import Any

from pipeline.compare.child import entry_text, finite, storable
from pipeline.compare.registry import Entry
from pipeline.compare.rows import Case, Row

UNKNOWN: dict[str, Any] = dict.fromkeys(
    ("cost", "gain_left", "iterations", "wall_s", "build_s", "evaluation_s", "linear_s", "callback_s",
     "memory_mb", "memory_before_mb", "k1", "k2", "sigma_k1", "sigma_k2", "sigma_com_mm", "errors")
)  # fmt: skip


def row_of(problem_file: Path, entry: Entry, case: Case, limit_s: float) -> Row:
    """Solve in a new process; whatever happens to it, there is a row."""
    package = entry.missing()
    if package is not None:
        return empty_row(
            entry, case, "missing", f"the package {package} is not installed: pip install 'polhode[solvers]'"
        )
    with TemporaryDirectory(prefix="polhode-compare-") as folder:
        out = Path(folder) / "row.json"
        told = {**case.model_dump(), "limit_s": limit_s, "started": time()}
        command = [sys.executable, "-P", "-m", "pipeline.compare.child",
                   str(problem_file), entry_text(entry), json.dumps(told), str(out)]  # fmt: skip
        code, words = _run(command, limit_s)
        if out.is_file():
            try:
                return _row(entry, case, storable(json.loads(out.read_text())))
            except ValueError as error:
                return empty_row(entry, case, "failed", f"its answer cannot be read: {str(error)[:150]}")
        trace = _trace(out.with_suffix(".trace"))
        if code is None:
            return empty_row(entry, case, "timeout", f"it did not come back within {limit_s:g} s", trace)
        return empty_row(entry, case, "failed", _last_words(code, words), trace)


def empty_row(
    entry: Entry, case: Case, status: str, message: str, trace: list[tuple[float, float]] | None = None
) -> Row:
    """A row of a solver that told nothing."""
    known = {**UNKNOWN, "status": status, "message": message, "trace": trace or []}
    if trace:
        known |= {"wall_s": trace[-1][0], "iterations": len(trace)}
    return _row(entry, case, known)


def _row(entry: Entry, case: Case, known: dict[str, Any]) -> Row:
    return Row.model_validate({**case.model_dump(), "family": entry.family, "claim": entry.claim, **known})


def _run(command: list[str], limit_s: float) -> tuple[int | None, str]:
    """Exit code, None when its time was up; and what it said on standard error."""
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
        _end(process)
        return None, ""
    except BaseException:
        _end(process)
        raise
    return process.returncode, words


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
    return f"the process ended with {code} and left nothing: {said}"


def _trace(file: Path) -> list[tuple[float, float]]:
    if not file.is_file():
        return []
    points = [line.split() for line in file.read_text().splitlines()]
    return finite([(float(point[0]), float(point[1])) for point in points if len(point) == 2])
