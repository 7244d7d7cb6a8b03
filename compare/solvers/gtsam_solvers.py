"""GTSAM: Levenberg-Marquardt on the whole graph, and iSAM2 frame by frame."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C

from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.solver import Claim, Outcome, Watch
from polhode.compare.solvers.gtsam_graph import Graph
from polhode.lie import Array

TOLERANCE = 1e-10
MAX_ITERATIONS = 300
RELINEARIZE, WILDFIRE = 1e-5, 1e-8
"""Smallest change of an unknown that iSAM2 linearises again for, and that it passes on."""
LAST_UPDATES = 40
NOT_SEPARABLE = "GTSAM evaluates its stereo factors in C++ inside its own steps"


@dataclass
class Batch:
    """Levenberg-Marquardt with Marquardt's scaling."""

    name: str = "gtsam_lm"
    words: str = "GTSAM, Levenberg-Marquardt, multifrontal Cholesky"
    family: str = "gtsam"
    claim: Claim = "ok"
    needs: tuple[str, ...] = ("gtsam",)

    def solve(self, problem: MeasuredProblem, x: Array, watch: Watch) -> Outcome:
        """Until the relative decrease is below TOLERANCE."""
        watch.not_separable = NOT_SEPARABLE
        with watch.part("build"):
            own = Graph(problem, watch)
            graph, values = own.all(x), own.values(x)
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setDiagonalDamping(True)
            parameters.setlambdaUpperBound(1e12)
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
        before, converged, iterations = optimizer.error(), False, 0
        watch.note(before, x)
        while iterations < MAX_ITERATIONS and not converged:
            optimizer.iterate()
            iterations += 1
            after = optimizer.error()
            watch.note(after, own.vector(optimizer.values()))
            watch.check()
            converged = before - after <= TOLERANCE * after
            before = after
        values = optimizer.values()
        cov = _covariance(lambda: gtsam.Marginals(graph, values)) if watch.stop() else None
        message = "converged" if converged else "limit of iterations"
        return Outcome(own.vector(values), converged, iterations, message, cov)


@dataclass
class Incremental:
    """iSAM2: frames come one by one, with the same first values; in the end updates until the cost rests."""

    name: str = "gtsam_isam2"
    words: str = "GTSAM iSAM2, frame by frame, then updates until the cost rests"
    family: str = "gtsam"
    claim: Claim = "ok"
    needs: tuple[str, ...] = ("gtsam",)

    def solve(self, problem: MeasuredProblem, x: Array, watch: Watch) -> Outcome:
        """The cost is noted when all frames are in."""
        watch.not_separable = NOT_SEPARABLE
        with watch.part("build"):
            own = Graph(problem, watch)
            # small steps must reach every unknown, or the cost rests too early
            parameters = gtsam.ISAM2Params()
            parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(WILDFIRE))
            parameters.setRelinearizeThreshold(RELINEARIZE)
            parameters.relinearizeSkip = 1
            isam = gtsam.ISAM2(parameters)
        d, seen, iterations = problem.data, np.zeros(problem.data.n_landmarks, dtype=bool), 0
        for k in range(d.n_frames):
            new = gtsam.NonlinearFactorGraph()
            own.add_stereo(new, k)
            if k > 0:
                own.add_step(new, k - 1)
            else:
                own.add_others(new, x)
            marks = np.unique(d.landmark[d.frame == k])
            values = own.values(x, range(k, k + 1), marks[~seen[marks]])
            seen[marks] = True
            isam.update(new, values)
            iterations += 1
            watch.tell(f"{k + 1} of {d.n_frames} frames were in")
            watch.check()
        watch.tell("")
        cost, converged = np.inf, False
        for _ in range(LAST_UPDATES):
            found = own.vector(isam.calculateEstimate())
            after = own.blocks.cost(found)
            watch.note(after, found)
            converged = bool(abs(cost - after) <= TOLERANCE * after)
            if converged:
                break
            cost = after
            isam.update()
            iterations += 1
            watch.check()
        cov = _covariance(lambda: isam) if watch.stop() else None
        return Outcome(found, converged, iterations, "converged" if converged else "limit of updates", cov)


def _covariance(solved: Callable[[], Any]) -> Array | None:
    """(8, 8) of com_G, xi by GTSAM; None where its Hessian has no inverse."""
    try:
        return np.asarray(solved().marginalCovariance(C(0)))[:8, :8]
    except RuntimeError:
        return None
