"""Steps in which something unknown pushed the target: found where free motion is contradicted.

An unknown push is a node of a step (thesis 7.3): acceleration and angular acceleration of any course, zero
on average, with a wide standard deviation. It touches its own step only, so it is integrated out exactly: it
adds to the covariance of that step (``problem.hold``), and what it was follows from the states around it
(``recovered.py``).

Which steps need one is told by their auxiliary residuals: the smoothed residual of a step weighed by its own
covariance (Harvey and Koopman, "Diagnostic checking of unobserved-components time series models", 1992; de
Jong and Penzer, "Diagnosing shocks in time series", 1998). A push smears over its neighbours, so the largest
are freed first, the motion is fitted again, and the evidence decides whether nodes explain more than a
stronger process noise does.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.dynamics.residuals import dynamics_jacobians
from polhode.backend.noise.process_level import INDIFFERENT, Level, estimate_process_noise, level_at
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.problem import MotionData, hold
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.uncertainty.covariance import marginals, robust_information
from polhode.lie import Array
from polhode.records import Bools

SUSPICIOUS = 24.0
"""Of a sum of six squares: 1 in 2,000 by chance. What is suspected must still gain evidence."""
STANDING_OUT, LEAST_SUSPICIOUS = 5.5, 8.0
"""Times the median, and at least so much: suspicious too, as pushes make the process noise seem stronger."""
SHARE_OF_LARGEST = 0.5
LEAST_GAIN = 15.0
"""Of log-evidence, for all nodes together: odds of three million, far above the number of places to look."""
MOST_NODES = 0.4
"""Share of the steps; a target that is pushed more often is disturbed."""
WEAKER, MOST_WEAKER = 10.0**0.5, 10
"""Steps of the search for the strength of the pushes, downwards from the widest."""
LEVELS = 3
"""Of the process noise: with the largest pushes freed it is weaker, and the others stand out."""
ROUNDS = 8
ITERATIONS = 4
LEAST_VARIANCE = 1e-3
"""Of a whitened residual; below, the data say nothing of it."""


@dataclass(frozen=True)
class Found:
    """Steps that need a node, and how strong the pushes are."""

    nodes: Bools
    """(F - 1,)"""
    sigma: tuple[float, float]
    """[m/s^2, rad/s^2]"""


def find_pushes(
    data: MotionData, iterate: Iterate, widest: tuple[float, float], level_is_given: bool
) -> Found | None:
    """Steps that need a node, those of ``data`` among them; None when no further one does.

    The iterate is a solution under ``data``; widest [m/s^2, rad/s^2] is the largest standard deviation that
    is tried. A push that is found may have begun a step earlier, or ended one later: these steps have a node
    too.
    """
    level = Level(data, iterate, np.inf)
    for _ in range(LEVELS):
        found, at = _free_the_contradicted(level.data, level.iterate)
        if np.array_equal(found, level.data.nodes) or found.mean() > MOST_NODES:
            break
        level = _weigh(replace(level.data, nodes=found, node_sigma=widest), at, level_is_given)
        level = _weaker(_weaker(level, 0), 1)
    if np.array_equal(level.data.nodes, data.nodes):
        return None
    gain = _weigh(data, iterate, level_is_given).minus_log_evidence - level.minus_log_evidence
    if not gain > LEAST_GAIN:
        return None
    return Found(data.nodes | _with_neighbours(level.data.nodes & ~data.nodes), level.data.node_sigma)


def _weaker(best: Level, which: int) -> Level:
    """Lower one of the standard deviations as long as the evidence rises; the largest of those as likely."""
    tried = [best]
    for _ in range(MOST_WEAKER):
        sigma = list(tried[-1].data.node_sigma)
        sigma[which] /= WEAKER
        data = replace(tried[-1].data, node_sigma=(sigma[0], sigma[1]))
        tried.append(level_at(data, tried[-1].iterate, data.accel_psd, data.torque_psd))
        if not tried[-1].minus_log_evidence < tried[-2].minus_log_evidence:
            break
    least = min(level.minus_log_evidence for level in tried)
    return next(level for level in tried if level.minus_log_evidence < least + INDIFFERENT)


def _with_neighbours(steps: Bools) -> Bools:
    out = steps.copy()
    out[1:] |= steps[:-1]
    out[:-1] |= steps[1:]
    return out


def _weigh(data: MotionData, iterate: Iterate, level_is_given: bool) -> Level:
    if level_is_given:
        return level_at(data, iterate, data.accel_psd, data.torque_psd)
    return estimate_process_noise(data, iterate)


def _free_the_contradicted(data: MotionData, iterate: Iterate) -> tuple[Bools, Iterate]:
    """Give nodes to the largest contradictions and fit, until none is left."""
    for turn in range(ROUNDS):
        if turn > 0:
            solution = GaussNewton(data).solve(hold(data, iterate), iterate.vector(), ITERATIONS)
            iterate = iterate.moved_to(solution.x)
        size = contradictions(data, iterate)
        size[data.nodes] = 0.0
        limit = np.maximum(STANDING_OUT * np.median(size[~data.nodes], axis=0), LEAST_SUSPICIOUS)
        suspects = (size > np.minimum(limit, SUSPICIOUS)) & (size >= SHARE_OF_LARGEST * size.max(axis=0))
        if not suspects.any():
            break
        data = replace(data, nodes=data.nodes | suspects.any(axis=1))
    return data.nodes, iterate


def contradictions(data: MotionData, iterate: Iterate) -> Array:
    """Auxiliary residuals of translation and rotation, squared: (F - 1, 2), of six numbers each.

    Near 6 where the motion is as disturbed as ``data`` says; less where little of it is seen.
    """
    solver, held, x = GaussNewton(data), hold(data, iterate), iterate.vector()
    squares = np.sum(solver.residuals(held, x)[0] ** 2, axis=1)
    dense = marginals(solver, held, x, robust_information(squares, data.robust_scale)).dense
    states, at = solver.states(held, x)
    dJ = inertia_derivative(data.form, at.xi, at.R_inertia)
    residual, jacobian = dynamics_jacobians(states, held.steps, at.J_G(data.form), dJ)
    s, constants = iterate.n_state, np.arange(iterate.n_states, iterate.n_dense)
    out = np.zeros((len(residual), 2))
    for k, (r, D) in enumerate(zip(residual, jacobian, strict=True)):
        own = np.concatenate([np.arange(s * k, s * (k + 2)), constants])
        S = np.eye(12) - D @ dense[np.ix_(own, own)] @ D.T
        for n, rows in enumerate((slice(0, 6), slice(6, 12))):
            variance, axes = np.linalg.eigh(S[rows, rows])
            seen = variance > LEAST_VARIANCE
            out[k, n] = np.sum((axes.T @ r[rows])[seen] ** 2 / variance[seen])
    return out
