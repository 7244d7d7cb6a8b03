"""The process of one solver: ``python -m polhode.compare.processes.solver_process PROBLEM CASE ENTRY OUT``.

Reads the problem, solves, writes what came of it as JSON. Whatever it does wrong costs its own row only.
"""

import json
import math
import os
import resource
import signal
import sys
import traceback
from dataclasses import asdict
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Any

from polhode.compare.registry import Entry
from polhode.threads import limit_threads

if TYPE_CHECKING:
    from polhode.compare.problem.measured_problem import MeasuredProblem
    from polhode.lie import Array

ENDING_S = 3.0
"""Kept back from the limit for judging and writing."""


def main(words: list[str]) -> None:
    """One solve; the answer lies in the last word's file."""
    limit_threads(1)
    problem_file, entry_text, case_text, out = words
    given: dict[str, Any] = json.loads(entry_text)
    given["options"] = tuple(tuple(pair) for pair in given["options"])
    given["needs"] = tuple(given["needs"])
    case = json.loads(case_text)
    # should the parent die first, nobody else ends a solver that hangs
    signal.alarm(math.ceil(case["limit_s"]) + 5)
    answer = solve(Path(problem_file), Entry(**given), case, Path(out))
    from polhode.atomic import write_text

    write_text(Path(out), json.dumps(answer))
    sys.stdout.flush()
    # libraries that crash while they unload cost nothing any more
    os._exit(0)


def solve(problem_file: Path, entry: Entry, case: dict[str, Any], out: Path) -> dict[str, Any]:
    """The parts of a row that this process knows."""
    from polhode.compare.problem.assessment import gain_left, sigmas
    from polhode.compare.problem.measured_problem import load
    from polhode.compare.solver import OutOfTime, SolveMonitor
    from polhode.compare.solver_progress import ProgressFiles

    problem = load(problem_file)
    x = problem.start(case["start"], case["seed"])
    gain_left(problem, x)  # compiled loops are loaded before the clock starts
    before = peak_mb()
    solver = entry.load()
    reached = ProgressFiles(out, len(x))
    left = case["limit_s"] - (time() - case["started"]) - ENDING_S
    monitor = SolveMonitor(max(left, 1.0), reached=reached)
    outcome, failure = None, ""
    try:
        outcome = solver.solve(problem, x, monitor)
    except OutOfTime:
        failure = "timeout"
    except Exception as error:  # noqa: BLE001  a row, whatever it was
        traceback.print_exc()
        failure = f"{type(error).__name__}: {error}"
        monitor.not_separable = monitor.not_separable or "an error ended it before its times were read"
    wall, memory = monitor.elapsed(), peak_mb()
    kept, point = ("answer", outcome.x) if outcome is not None else monitor.kept()
    judged = of_point(problem, kept, point)
    cov = outcome.cov_constants if outcome is not None else None
    of_sigma = sigmas(problem, outcome.x, cov) if outcome is not None else [None] * 3
    if failure == "timeout":
        status, message = "timeout", out_of_time(case["limit_s"], wall, monitor.words, kept)
    elif outcome is None:
        status, message = "failed", failure
    else:
        status, message = _believed(entry, outcome.converged, outcome.message, judged)
    build, evaluation = monitor.seconds["build"], monitor.seconds["evaluation"]
    apart = not monitor.not_separable
    return {
        "status": status,
        "message": " ".join(message.split())[:300],
        **judged,
        "iterations": outcome.iterations if outcome is not None else len(monitor.trace),
        "wall_s": wall,
        "build_s": build,
        "evaluation_s": evaluation if apart else None,
        "linear_s": max(wall - build - evaluation, 0.0) if apart else None,
        "not_separable": monitor.not_separable,
        "callback_s": monitor.callback_s,
        "memory_mb": memory,
        "memory_before_mb": before,
        "sigma_k1": of_sigma[0],
        "sigma_k2": of_sigma[1],
        "sigma_com_mm": of_sigma[2],
        "trace": finite(monitor.trace),
    }


def _believed(entry: Entry, converged: bool, message: str, judged: dict[str, Any]) -> tuple[str, str]:
    """Status and words of an answer: what the solver claims, if the common cost confirms it."""
    from polhode.compare.problem.assessment import AGREED

    if judged["cost"] is None:
        return "failed", f"no finite cost where it stopped ({message})"
    if not converged:
        return "failed", message
    left = judged["gain_left"]
    if entry.claim == "ok" and (left is None or left > AGREED):
        words = "no solvable step" if left is None else f"{left:.1e} of the cost"
        return "failed", f"stopped short of the optimum: {words} left to gain ({message})"
    return entry.claim, message


def of_point(problem: "MeasuredProblem", kept: str, x: "Array | None") -> dict[str, Any]:
    """The assessment of the point that is kept; nothing of none."""
    from polhode.compare.problem.assessment import Assessment, assess

    verdict = Assessment(None, None, None, None, None) if x is None else assess(problem, x)
    return {
        "kept": kept,
        "cost": verdict.cost,
        "gain_left": verdict.gain_left,
        "k1": verdict.k1,
        "k2": verdict.k2,
        "errors": verdict.errors.model_dump() if verdict.errors is not None else None,
    }


def out_of_time(limit_s: float, own_s: float | None, words: str, kept: str) -> str:
    """Why there is no answer, what time the process's start left to it, how far it was, what is kept."""
    own = "" if own_s is None else f", {own_s:.1f} s of them the solver's own"
    told = [f"{limit_s:g} s were not enough{own}", *([words] if words else [])]
    told.append("nothing is kept: it has no whole point on its way" if kept == "nothing"
                else f"the {kept} point is kept")  # fmt: skip
    return "; ".join(told)


def storable(known: dict[str, Any]) -> dict[str, Any]:
    """A row's content with null for every number that is not finite: JSON has no word for it."""
    return {
        key: storable(value)
        if isinstance(value, dict)
        else (None if isinstance(value, float) and not math.isfinite(value) else value)
        for key, value in known.items()
    }


def finite(trace: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Points of a trace that can be drawn."""
    return [(t, cost) for t, cost in trace if abs(cost) < 1e300]


def peak_mb(process: int | str = "self") -> float | None:
    """Largest resident size of a process so far [MB]; None: it cannot be told of another one."""
    status = Path(f"/proc/{process}/status")
    if status.is_file():
        # getrusage's peak survives exec: a child would start from its parent's
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    if process != "self":
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def entry_text(entry: Entry) -> str:
    """An entry as a word of the command line."""
    return json.dumps(asdict(entry))


if __name__ == "__main__":
    main(sys.argv[1:])
