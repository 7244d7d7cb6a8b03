"""The process of one solver: ``python -m pipeline.compare.child PROBLEM CASE ENTRY OUT``.

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
from typing import Any

from pipeline.compare.registry import Entry
from pipeline.threads import limit_threads

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
    from pipeline.compare.judge import AGREED, Verdict, gain_left, judge, sigmas
    from pipeline.compare.measured_problem import load
    from pipeline.compare.solver import OutOfTime, Watch

    problem = load(problem_file)
    x = problem.start(case["start"], case["seed"])
    gain_left(problem, x)  # compiled loops are loaded before the clock starts
    before = peak_mb()
    solver = entry.load()
    left = case["limit_s"] - (time() - case["started"]) - ENDING_S
    watch = Watch(max(left, 1.0), stream=out.with_suffix(".trace"))
    outcome, failure = None, ""
    try:
        outcome = solver.solve(problem, x, watch)
    except OutOfTime:
        failure = "timeout"
    except Exception as error:  # noqa: BLE001  a row, whatever it was
        traceback.print_exc()
        failure = f"{type(error).__name__}: {error}"
    wall = watch.elapsed()
    memory = peak_mb()
    best = outcome.x if outcome is not None else watch.best[1] if watch.best is not None else x
    verdict = judge(problem, best)
    if outcome is None and watch.best is None:
        # it noted no point: where it began says nothing of it
        verdict = Verdict(None, None, None, None, None)
    of_sigma = sigmas(problem, best, outcome.cov_constants if outcome is not None else None)
    status, message = "failed", failure
    if failure == "timeout":
        status, message = "timeout", f"{case['limit_s']:g} s were not enough"
    elif outcome is not None:
        status, message = entry.claim if outcome.converged else "failed", outcome.message
        if verdict.cost is None:
            status, message = "failed", f"no finite cost where it stopped ({message})"
        elif status == "ok" and (verdict.gain_left is None or verdict.gain_left > AGREED):
            left = "no solvable step" if verdict.gain_left is None else f"{verdict.gain_left:.1e} of the cost"
            status, message = "failed", f"stopped short of the optimum: {left} left to gain ({message})"
    build, evaluation = watch.seconds["build"], watch.seconds["evaluation"]
    return {
        "status": status,
        "message": " ".join(message.split())[:300],
        "cost": verdict.cost,
        "gain_left": verdict.gain_left,
        "iterations": outcome.iterations if outcome is not None else len(watch.trace),
        "wall_s": wall,
        "build_s": build,
        "evaluation_s": evaluation,
        "linear_s": max(wall - build - evaluation, 0.0),
        "callback_s": watch.callback_s,
        "memory_mb": memory,
        "memory_before_mb": before,
        "k1": verdict.k1,
        "k2": verdict.k2,
        "sigma_k1": of_sigma[0],
        "sigma_k2": of_sigma[1],
        "sigma_com_mm": of_sigma[2],
        "errors": verdict.errors.model_dump() if verdict.errors is not None else None,
        "trace": finite(watch.trace),
    }


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


def peak_mb() -> float:
    """Largest resident size of this process so far [MB]."""
    status = Path("/proc/self/status")
    if status.is_file():
        # getrusage's peak survives exec: a child would start from its parent's
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def entry_text(entry: Entry) -> str:
    """An entry as a word of the command line."""
    return json.dumps(asdict(entry))


if __name__ == "__main__":
    main(sys.argv[1:])
