"""Solvers that misbehave, for the process that must survive them."""

import os
import time

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array


class Faulty:
    """Crashes, hangs, raises, lies or gives nonsense."""

    def __init__(self, how: str) -> None:
        self.how = how

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Never well."""
        if self.how == "hangs dumbly":
            monitor.record(1.0)
            monitor.report(f"3 of {problem.data.n_frames} frames were in")
            time.sleep(3600.0)
        monitor.record(problem.fixed.steps.half_log_det, x)
        if self.how == "crashes":
            os.abort()
        if self.how == "exits":
            os._exit(3)
        if self.how == "hangs":
            time.sleep(3600.0)
        if self.how == "raises":
            raise ValueError("no such\nluck")
        if self.how == "nonsense":
            return AdapterResult(x * float("nan"), True, 1, "converged")
        return AdapterResult(x, True, 1, "converged")
