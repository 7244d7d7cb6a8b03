"""Each solver in a process of its own: one that crashes, hangs or is missing costs its row only.

``row_of`` starts ``python -m polhode.compare.solver_process PROBLEM ENTRY CASE OUT``, ends it at its limit
and reads what it wrote. The process solves, assesses and writes its part of the row as JSON.
"""

import json
import math
import os
import resource
import signal
import subprocess
import sys
import traceback
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time
from typing import Any

from polhode.compare.problem.assessment import AGREED, PointAssessment, assess, gain_left, sigmas
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import read_problem
from polhode.compare.rows import Case, Row
from polhode.compare.solver import Entry, OutOfTime, SolveMonitor
from polhode.files.atomic import write_text
from polhode.geometry.lie import Array
from polhode.runtime.optional_parts import missing_message
from polhode.runtime.parent_death import tied
from polhode.runtime.threads import limit_threads

RESERVE_S = 3.0
"""Part of the limit that is reserved for the assessment and for writing the result."""
Values = dict[str, Any]


def row_of(problem_file: Path, entry: Entry, case: Case, limit_s: float) -> Row:
    """Solve in a new process; whatever happens to it, there is a row."""
    package = entry.missing()
    if package is not None:
        return empty_row(entry, case, "missing", missing_message(package))
    with TemporaryDirectory(prefix="polhode-compare-") as folder:
        out = Path(folder) / "row.json"
        timed_case = {**case.model_dump(), "limit_s": limit_s, "started": time()}
        arguments = [str(problem_file), json.dumps(asdict(entry)), json.dumps(timed_case), str(out)]
        code, last = _run([sys.executable, "-P", "-m", "polhode.compare.solver_process", *arguments], limit_s)
        if out.is_file():
            try:
                return _row(entry, case, storable(json.loads(out.read_text())))
            except ValueError as error:
                reason = f"its result cannot be read: {str(error)[:150]}"
                return _row(entry, case, {"status": "failed", "message": reason})
    if code is None:
        return _row(entry, case, {"status": "timeout", "message": f"ended at its limit of {limit_s:g} s"})
    died = (
        f"the process died of {signal.Signals(-code).name}" if code < 0 else f"the process ended with {code}"
    )
    return _row(entry, case, {"status": "failed", "message": f"{died} and left no result: {last}"})


def empty_row(entry: Entry, case: Case, status: str, message: str) -> Row:
    """A row of a solver that did not run."""
    return _row(entry, case, {"status": status, "message": message, "ran": False})


def _row(entry: Entry, case: Case, known: Values) -> Row:
    unknown = dict.fromkeys(Row.model_fields)
    own = {**case.model_dump(), "family": entry.family, "claim": entry.claim, "ran": True}
    return Row.model_validate(unknown | {"kept": "nothing", "trace": []} | own | known)


def _run(command: list[str], limit_s: float) -> tuple[int | None, str]:
    """Wait until the process ends, or end it at its limit (no exit code): code, last words."""
    # the child imports our packages from where this process has them, wherever it was started
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    environment.pop("PYTHONFAULTHANDLER", None)
    process = subprocess.Popen(  # noqa: S603  this interpreter with words of ours, no shell
        tied(command),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
        env=environment,
    )
    try:
        _, stderr = process.communicate(timeout=limit_s)
    except BaseException as error:
        # with those that it started: it leads a session of its own
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if not isinstance(error, subprocess.TimeoutExpired):
            raise
        return None, ""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    return process.returncode, lines[-1][:200] if lines else "no output"


def main(arguments: list[str]) -> None:
    """The process: one solve, whose result is written to the file of the last argument."""
    limit_threads(1)
    problem_file, entry_text, case_text, out = arguments
    entry, case = Entry(**json.loads(entry_text)), json.loads(case_text)
    # ends a solver that hangs when the parent, which would end it, has died (where it is not tied to it)
    signal.alarm(math.ceil(case["limit_s"]) + 5)
    write_text(Path(out), json.dumps(solve(Path(problem_file), entry, case)))
    sys.stdout.flush()
    # without the clean-up of libraries, some of which crash in it
    os._exit(0)


def solve(problem_file: Path, entry: Entry, case: Values) -> Values:
    """The parts of a row that this process knows."""
    problem = read_problem(problem_file)
    x = problem.start(case["start"], case["seed"])
    gain_left(problem, x)  # loads the compiled loops before the clock starts
    solver = entry.load()
    left = case["limit_s"] - (time() - case["started"]) - RESERVE_S
    monitor = SolveMonitor(max(left, 1.0))
    result, status, message = None, "failed", ""
    try:
        result = solver.solve(problem, x, monitor)
    except OutOfTime:
        status = "timeout"
    except Exception as error:  # noqa: BLE001  any error is a failed row
        traceback.print_exc()
        message = f"{type(error).__name__}: {error}"
    wall, memory = monitor.elapsed(), peak_mb()
    kept, point = ("answer", result.x) if result is not None else monitor.kept()
    assessed = _assessed(problem, kept, point)
    iterations, sigma = len(monitor.trace), sigmas(problem, x, None)
    if result is not None:
        status, message = _confirmed(entry, result.converged, result.message, assessed)
        iterations, sigma = result.iterations, sigmas(problem, result.x, result.cov_constants)
    elif status == "timeout":
        words = "nothing is kept" if kept == "nothing" else f"the {kept} point is kept"
        message = f"{case['limit_s']:g} s were not enough, {wall:.1f} s of them the solver's own; {words}"
    return {
        "status": status,
        "message": " ".join(message.split())[:300],
        **assessed,
        "iterations": iterations,
        "wall_s": wall,
        "memory_mb": memory,
        **dict(zip(("sigma_k1", "sigma_k2", "sigma_com_mm"), sigma, strict=True)),
        "trace": drawable(monitor.trace),
    }


def _confirmed(entry: Entry, converged: bool, message: str, assessed: Values) -> tuple[str, str]:
    """Status and message of a result: what the solver claims, if the common cost confirms it."""
    if assessed["cost"] is None:
        return "failed", f"no finite cost where it stopped ({message})"
    if not converged:
        return "failed", message
    left = assessed["gain_left"]
    if entry.claim == "ok" and (left is None or left > AGREED):
        gain = "no solvable step" if left is None else f"{left:.1e} of the cost"
        return "failed", f"stopped short of the optimum: {gain} left to gain ({message})"
    return entry.claim, message


def _assessed(problem: MeasuredProblem, kept: str, x: Array | None) -> Values:
    """The assessment of the point that is kept; None throughout without a point."""
    found = PointAssessment() if x is None else assess(problem, x)
    errors = found.errors.model_dump() if found.errors is not None else None
    return {"kept": kept, **asdict(found), "errors": errors}


def storable(known: Values) -> Values:
    """A row's content with null for every number that is not finite, which JSON cannot store."""

    def one(value: Any) -> Any:
        if isinstance(value, dict):
            return storable(value)
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return {key: one(value) for key, value in known.items()}


def drawable(trace: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points of a trace whose cost is finite and not absurdly large."""
    return [(t, cost) for t, cost in trace if abs(cost) < 1e300]


def peak_mb() -> float:
    """Largest resident size of this process so far [MB]."""
    status = Path("/proc/self/status")
    # getrusage's peak survives exec: a child would start from its parent's
    lines = status.read_text().splitlines() if status.is_file() else []
    found = next((line for line in lines if line.startswith("VmHWM:")), None)
    if found is not None:
        return float(found.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    main(sys.argv[1:])
