"""Solvers that misbehave, for the process that must survive them."""

import os
import time
from dataclasses import dataclass

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import AdapterResult, SolveMonitor
from polhode.geometry.lie import Array


@dataclass
class Faulty:
    """Crashes, hangs, raises, lies or gives nonsense."""

    how: str

    def solve(self, problem: MeasuredProblem, x: Array, monitor: SolveMonitor) -> AdapterResult:
        """Never well."""
        monitor.record(problem.fixed.steps.half_log_det, x)
        if self.how == "crashes":
            os.abort()
        if self.how == "exits":
            os._exit(3)
        if self.how == "hangs":
            time.sleep(3600.0)
        if self.how == "raises":
            raise ValueError("no such\nluck")
        nonsense = x * float("nan") if self.how == "nonsense" else x
        return AdapterResult(nonsense, True, 1, "converged")
