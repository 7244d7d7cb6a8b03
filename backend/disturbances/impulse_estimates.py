"""What unknown pushes did to the target: read off the states on either side of their steps."""

from dataclasses import replace

import numpy as np

from polhode.backend.dynamics.propagation import flow_derivatives, flows
from polhode.backend.dynamics.residuals import dynamics_jacobians
from polhode.backend.problem.inertia import inertia_derivative
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.problem import Held, MotionData
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.uncertainty.covariance import AxesDerivative, Marginals
from polhode.lie import Array, hat
from polhode.records import Bools, Ints, Push, UnknownPushes

SURE = 4.0
"""Standard deviations of the largest change, beyond which something did push."""


def recovered_pushes(
    data: MotionData,
    held: Held,
    iterate: Iterate,
    m: Marginals,
    derivative: AxesDerivative,
    axes_known: Bools,
    timestamps_ns: Ints,
) -> UnknownPushes | None:
    """Changes over the steps that have a node, and over each run of such steps; None when none has.

    A change is a step's error without its whitening: the state after it minus what free motion and known
    pushes lead to; that of the rate is carried back to the middle of the step, where a push of unknown course
    acts on the average. Those of neighbouring steps are strongly correlated, their sum is known better.
    """
    use = np.flatnonzero(data.nodes)
    if len(use) == 0:
        return None
    change, T = _changes(data, held, iterate, derivative)
    cov = np.stack([_covariance(T, m.dense, iterate, np.array([k])) for k in use])
    # the disturbances of a step are in the change of the state, not in the push
    quiet = np.repeat([data.accel_psd, data.torque_psd], 3)
    mixed = _mixed(axes_known)
    dt = data.dt_s[use, None]
    sigma = _sigma(cov, quiet * dt, mixed) / dt
    starts, ends = timestamps_ns[use], timestamps_ns[use + 1]
    pushes = []
    for steps in np.split(use, np.flatnonzero(np.diff(use) > 1) + 1):
        span = timestamps_ns[steps[0]], timestamps_ns[steps[-1] + 1]
        total = change[steps].sum(axis=0)
        spread = _covariance(T, m.dense, iterate, steps)
        of_total = _sigma(spread, quiet * data.dt_s[steps].sum(), mixed)
        pushes.append(Push(int(span[0]), int(span[1]), total[:3], of_total[:3], total[3:], of_total[3:]))
    accel = change[use] / dt
    return UnknownPushes(starts, ends, accel[:, :3], sigma[:, :3], accel[:, 3:], sigma[:, 3:], tuple(pushes))


def _changes(
    data: MotionData, held: Held, iterate: Iterate, derivative: AxesDerivative
) -> tuple[Array, Array]:
    """Changes (F - 1, 6) of velocity (N) and rate (P), and their derivatives (F - 1, 6, 2 s + c)."""
    plain = np.broadcast_to(np.eye(6), (len(data.dt_s), 6, 6))
    steps = replace(held.steps, W_t=plain[:, :2, :2], W_r=plain)
    states, at = GaussNewton(data).states(held, iterate.vector())
    dJ = inertia_derivative(data.form, at.xi, at.R_inertia)
    error, D = dynamics_jacobians(states, steps, at.J_G(data.form), dJ)
    back, s = derivative.R_GP.T @ _to_the_middle(at, data, held), iterate.n_state
    change = np.concatenate([error[:, 3:6], np.einsum("kij,kj->ki", back, error[:, 9:12])], axis=1)
    T = np.concatenate([D[:, 3:6], back @ D[:, 9:12]], axis=1)
    # the axes along which it is told are uncertain too
    T[:, 3:, 2 * s + 3 : 2 * s + 8] += hat(change[:, 3:]) @ derivative.axes
    return change, T


def _to_the_middle(at: Iterate, data: MotionData, held: Held) -> Array:
    """(F - 1, 3, 3) that carry a change of the rate at the end of a step back to its middle."""
    J_G, half, series = at.J_G(data.form), 0.5 * data.dt_s, held.steps.series
    middle = flows(at.w_G[:-1], J_G, half, series)[1]
    rate = flow_derivatives(middle, J_G, np.zeros((0, 3, 3)), half, series)[3]
    return np.asarray(np.linalg.inv(np.swapaxes(rate, 1, 2)))


def _covariance(T: Array, dense: Array, iterate: Iterate, steps: Ints) -> Array:
    """Of the sum of the changes over consecutive steps (6, 6)."""
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


def _mixed(axes_known: Bools) -> Bools:
    """(3,) components that a turn about an undetermined axis mixes."""
    lost = ~axes_known
    return np.array([lost[1] | lost[2], lost[0] | lost[2], lost[0] | lost[1]])


def in_words(pushes: UnknownPushes, first_ns: int) -> list[str]:
    """One sentence for each push."""
    return [_sentence(push, first_ns) for push in pushes.pushes]


def _sentence(push: Push, first_ns: int) -> str:
    start_s, end_s = ((t - first_ns) * 1e-9 for t in (push.start_ns, push.end_ns))
    size = np.append(push.delta_v_N / push.sigma_delta_v_N, push.delta_w_P / push.sigma_delta_w_P)
    pushed = "pushed" if np.abs(size).max() > SURE else "may have pushed"
    velocity, rate = (float(np.linalg.norm(change)) for change in (push.delta_v_N, push.delta_w_P))
    return (
        f"something unknown {pushed} the target between {start_s:.1f} s and {end_s:.1f} s: its velocity "
        f"changed by {1e3 * velocity:.2g} mm/s, its rate by {np.rad2deg(rate):.2g} deg/s"
    )
