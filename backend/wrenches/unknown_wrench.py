"""Unknown disturbances: the steps in which free motion is contradicted, and the impulses that acted there.

An unknown disturbance is a node of a step (thesis 7.3): an acceleration and an angular acceleration of any
time history within the step, zero-mean, with a large standard deviation. It affects its own step only, so it
is integrated out exactly: it adds to the covariance of that step (``solvers.linearization_point``), and the
impulse follows from the states on either side of the step.

The steps that need a node are found by their auxiliary residuals: the smoothed residual of a step weighted by
its own covariance (Harvey and Koopman, "Diagnostic checking of unobserved-components time series models",
1992; de Jong and Penzer, "Diagnosing shocks in time series", 1998). A disturbance smears over its neighbours,
so the largest ones get nodes first, the motion is fitted again, and the evidence decides whether nodes
explain more than a stronger process noise does.
"""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.propagation import propagate_derivatives, propagate_rotations
from polhode.backend.dynamics.residuals import FrameStates, Steps, dynamics_jacobians
from polhode.backend.outliers_and_noise.noise_and_outliers import whitened_residuals
from polhode.backend.outliers_and_noise.process_level import (
    INSIGNIFICANT_EVIDENCE,
    LevelFit,
    LevelSearch,
    estimate_process_noise,
    fit_level,
)
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import Iterate
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.robust_kernel import robust_information
from polhode.backend.uncertainty.covariance import Marginals, marginals
from polhode.backend.uncertainty.principal_axes import AxesDerivative
from polhode.geometry.lie import Array, Bools, Ints, hat
from polhode.records.estimate import Disturbances, Impulse

SUSPICIOUS_SQUARES = 24.0
"""Sum of six squares that is exceeded by chance once in 2,000; suspected steps must still gain evidence."""
MIN_MEDIAN_MULTIPLE, MIN_SQUARES = 5.5, 8.0
"""Multiple of the median, and smallest value, that is suspicious too: disturbances raise the process
noise."""
MIN_EVIDENCE_GAIN = 12.0
"""Gain of log-evidence for all nodes together: odds of 160,000, far above the number of steps."""
MAX_NODE_SHARE = 0.4
"""Largest share of the steps with nodes; with more of them the process noise describes the disturbances."""


def find_disturbed_steps(
    fit: MotionFit, widest: tuple[float, float], level_is_given: bool
) -> tuple[Bools, tuple[float, float]] | None:
    """Steps (F - 1,) that need a node, including those of ``data``; None if no further step does.

    Also returns the standard deviations of the disturbances [m/s^2, rad/s^2].

    ``fit`` is a solution; widest [m/s^2, rad/s^2] is the largest standard deviation that
    is tried. A disturbance may have begun one step earlier or ended one later: these steps get a node too.
    """
    data, level = fit.data, LevelFit(fit.data, fit.iterate, np.inf)
    # with nodes for the largest disturbances the process noise is lower, and others stand out
    for _ in range(3):
        found = _add_nodes(level)
        nodes = found.data.nodes
        if np.array_equal(nodes, level.data.nodes) or nodes.mean() > MAX_NODE_SHARE:
            break
        wide = MotionFit(replace(level.data, nodes=nodes, node_sigma=widest), found.iterate)
        level = fit_level(wide) if level_is_given else estimate_process_noise(wide)
        level = _reduce_sigma(_reduce_sigma(level, 0), 1)
    if np.array_equal(level.data.nodes, data.nodes):
        return None
    # the level without nodes is searched for only if nodes gain against the present one
    enough = level.minus_log_evidence + MIN_EVIDENCE_GAIN
    if not fit_level(fit).minus_log_evidence > enough:
        return None
    if not level_is_given and not estimate_process_noise(fit).minus_log_evidence > enough:
        return None
    new = level.data.nodes & ~data.nodes
    nodes = data.nodes | new
    nodes[1:] |= new[:-1]
    nodes[:-1] |= new[1:]
    return nodes, level.data.node_sigma


def _reduce_sigma(best: LevelFit, which: int) -> LevelFit:
    """Lower one of the standard deviations while the evidence rises; of equally likely ones the largest."""
    search = LevelSearch(best)
    tried = [search.fit(best.data, search.start)]
    for _ in range(10):
        sigma = list(tried[-1].data.node_sigma)
        sigma[which] /= 10.0**0.5
        data = replace(tried[-1].data, node_sigma=(sigma[0], sigma[1]))
        tried.append(search.fit(data, tried[-1].x))
        if not tried[-1].minus_log_evidence < tried[-2].minus_log_evidence:
            break
    least = min(trial.minus_log_evidence for trial in tried)
    chosen = next(trial for trial in tried if trial.minus_log_evidence < least + INSIGNIFICANT_EVIDENCE)
    return best if chosen is tried[0] else search.fitted(chosen)


def _add_nodes(fit: MotionFit) -> MotionFit:
    """Give nodes to the largest contradictions and fit again, until none is left."""
    for turn in range(8):
        if turn > 0:
            solution = GaussNewton(fit.data).solve(fit.linearized(), fit.iterate.vector(), 4)
            fit = fit.moved_to(solution.x)
        nodes, size = fit.data.nodes, auxiliary_residuals(fit)
        size[nodes] = 0.0
        limit = np.maximum(MIN_MEDIAN_MULTIPLE * np.median(size[~nodes], axis=0), MIN_SQUARES)
        suspects = (size > np.minimum(limit, SUSPICIOUS_SQUARES)) & (size >= 0.5 * size.max(axis=0))
        if not suspects.any():
            break
        fit = fit.with_data(nodes=nodes | suspects.any(axis=1))
    return fit


def auxiliary_residuals(fit: MotionFit) -> Array:
    """Auxiliary residuals of translation and rotation, squared: (F - 1, 2), of six numbers each.

    Near 6 if the disturbances are as strong as ``data`` states; less if they are hardly observable.
    """
    data, iterate = fit.data, fit.iterate
    squares = np.sum(whitened_residuals(fit) ** 2, axis=1)
    dense = marginals(fit, robust_information(squares, data.robust_scale)).dense
    residual, jacobian = _steps_of(fit, fit.linearized().steps)
    s, constants = iterate.n_state, np.arange(iterate.n_states, iterate.n_dense)
    out = np.zeros((len(residual), 2))
    for k, (r, D) in enumerate(zip(residual, jacobian, strict=True)):
        own = np.concatenate([np.arange(s * k, s * (k + 2)), constants])
        S = np.eye(12) - D @ dense[np.ix_(own, own)] @ D.T
        for n, rows in enumerate((slice(0, 6), slice(6, 12))):
            variance, axes = np.linalg.eigh(S[rows, rows])
            # a smaller variance carries no information
            seen = variance > 1e-3
            out[k, n] = np.sum((axes.T @ r[rows])[seen] ** 2 / variance[seen])
    return out


def estimate_impulses(
    fit: MotionFit, m: Marginals, derivative: AxesDerivative, axes_known: Bools, timestamps_ns: Ints
) -> Disturbances | None:
    """Impulses over the steps that have a node, and over each run of such steps; None if no step has.

    An impulse is the unwhitened residual of a step: the state after it minus the prediction by free motion
    and the known wrench. That of the rate is propagated back to the middle of the step, where a disturbance
    of unknown time history acts on average. Impulses of neighbouring steps are strongly correlated, their sum
    is known better.
    """
    data, iterate = fit.data, fit.iterate
    use = np.flatnonzero(data.nodes)
    if len(use) == 0:
        return None
    change, T = _changes(fit, derivative)
    cov = np.stack([_covariance(T, m.dense, iterate, np.array([k])) for k in use])
    # the process noise of a step is part of the change of the state, not of the impulse
    quiet = np.repeat([data.accel_psd, data.torque_psd], 3)
    # components that a rotation about an undetermined axis mixes
    mixed = np.array([not (axes_known[1] and axes_known[2]), not (axes_known[0] and axes_known[2]),
                      not (axes_known[0] and axes_known[1])])  # fmt: skip
    dt = data.dt_s[use, None]
    sigma = _sigma(cov, quiet * dt, mixed) / dt
    starts, ends = timestamps_ns[use], timestamps_ns[use + 1]
    impulses = []
    for steps in np.split(use, np.flatnonzero(np.diff(use) > 1) + 1):
        span = timestamps_ns[steps[0]], timestamps_ns[steps[-1] + 1]
        total = change[steps].sum(axis=0)
        spread = _covariance(T, m.dense, iterate, steps)
        of_total = _sigma(spread, quiet * data.dt_s[steps].sum(), mixed)
        impulses.append(Impulse(int(span[0]), int(span[1]), total[:3], of_total[:3], total[3:], of_total[3:]))
    accel = change[use] / dt
    return Disturbances(starts, ends, accel[:, :3], sigma[:, :3], accel[:, 3:], sigma[:, 3:], tuple(impulses))


def _steps_of(fit: MotionFit, steps: Steps) -> tuple[Array, Array]:
    """Residuals (F - 1, 12) of the dynamics, and their Jacobians."""
    at, form = fit.iterate, fit.data.form
    states = FrameStates.of(at, fit.data.camera_N)
    return dynamics_jacobians(states, steps, at.J_G(form), inertia_derivative(form, at.xi, at.R_inertia))


def _changes(fit: MotionFit, derivative: AxesDerivative) -> tuple[Array, Array]:
    """Changes (F - 1, 6) of velocity (N) and rate (P), and their derivatives (F - 1, 6, 2 s + c)."""
    plain = np.broadcast_to(np.eye(6), (len(fit.data.dt_s), 6, 6))
    steps = replace(fit.linearized().steps, W_t=plain[:, :2, :2], W_r=plain)
    error, D = _steps_of(fit, steps)
    back, s = derivative.R_GP.T @ _to_the_middle(fit, steps), fit.iterate.n_state
    change = np.concatenate([error[:, 3:6], np.einsum("kij,kj->ki", back, error[:, 9:12])], axis=1)
    T = np.concatenate([D[:, 3:6], back @ D[:, 9:12]], axis=1)
    # the axes along which it is expressed are uncertain too
    T[:, 3:, 2 * s + 3 : 2 * s + 8] += hat(change[:, 3:]) @ derivative.axes
    return change, T


def _to_the_middle(fit: MotionFit, steps: Steps) -> Array:
    """(F - 1, 3, 3) matrices that propagate a change of the rate at the end of a step back to its middle."""
    J_G, half, series = fit.iterate.J_G(fit.data.form), 0.5 * steps.dt_s, steps.series
    middle = propagate_rotations(fit.iterate.w_G[:-1], J_G, half, series)[1]
    rate = propagate_derivatives(middle, J_G, np.zeros((0, 3, 3)), half, series)[3]
    return np.asarray(np.linalg.inv(np.swapaxes(rate, 1, 2)))


def _covariance(T: Array, dense: Array, iterate: Iterate, steps: Ints) -> Array:
    """Covariance (6, 6) of the sum of the changes over consecutive steps."""
    s, n = iterate.n_state, iterate.n_states
    first, last = s * int(steps[0]), s * (int(steps[-1]) + 2)
    whole = np.zeros((6, last - first + iterate.n_constants))
    for k in steps:
        at = s * int(k) - first
        whole[:, at : at + 2 * s] += T[k, :, : 2 * s]
        whole[:, last - first :] += T[k, :, 2 * s :]
    own = np.concatenate([np.arange(first, last), np.arange(n, iterate.n_dense)])
    return np.asarray(whole @ dense[np.ix_(own, own)] @ whole.T)


def _sigma(covariance: Array, quiet: Array, mixed: Bools) -> Array:
    sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1) + quiet)
    sigma[..., 3:][..., mixed] = np.inf
    return np.asarray(sigma)


def describe_impulse(impulse: Impulse, first_ns: int) -> str:
    """A disturbance in one sentence; first_ns: time of the first frame."""
    start_s, end_s = ((t - first_ns) * 1e-9 for t in (impulse.start_ns, impulse.end_ns))
    size = np.append(impulse.delta_v_N / impulse.sigma_delta_v_N, impulse.delta_w_P / impulse.sigma_delta_w_P)
    acted = "acted" if np.abs(size).max() > 4.0 else "may have acted"
    velocity, rate = (float(np.linalg.norm(change)) for change in (impulse.delta_v_N, impulse.delta_w_P))
    return (
        f"an unknown disturbance {acted} on the target between {start_s:.1f} s and {end_s:.1f} s: its "
        f"velocity changed by {1e3 * velocity:.2g} mm/s, its rate by {np.rad2deg(rate):.2g} deg/s"
    )
