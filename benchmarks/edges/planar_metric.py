"""The simplified pose problem of Eaton and Naasz (2012): three degrees of freedom from bearings of edges.

A rigid flat model moves in a plane before a camera at the origin that looks along the first axis (C). State
x = (p1, p2, theta): place of the model's origin along the two axes of C [m] and its turn [rad]. An edge is a
point e (2,) of the model [m]; it is seen in the direction ``s = p + R(theta) e`` at the bearing

    phi = atan2(s2, s1)   [rad], in (-pi, pi]

The slides write arccos, which has no sign (``folded_bearings``), and print the last term of s2 as
``- e2 cos(theta)``, which is no rotation (``printed_directions``). See docs/observability_planar.md.

With H = d phi / d x (n, 3) and bearings of standard deviation sigma, the covariance of the least-squares
state is sigma^2 (H^T H)^-1; its position is that of the model's origin. Components may be hidden: their
variance is infinite.
"""

from dataclasses import dataclass

import numpy as np

from polhode.errors import InputError
from polhode.lie import Array

COMPONENTS = ("p1", "p2", "theta")
SINGULAR = 1e-10
"""Singular values of H, columns scaled to length 1, that count as zero; relative to the largest."""
ROUNDING = 1e-13
"""A column of H shorter than this share of what it could be is 0."""
SHARE = 1e-6
"""A component with a larger share in a hidden direction is hidden."""
SAME_PLACE = 1e-9
"""Edges nearer than this are one; relative to their greatest distance from the camera."""
MAX_ITERATIONS = 50
MAX_HALVINGS = 20
STEP = 1e-11
"""A step of less than this, in bearings [rad], ends the iteration."""
BLUR = 1e-14
"""Rounding of a bearing [rad], generously; costs that differ by less than it makes are alike."""


@dataclass(frozen=True)
class PlanarEstimate:
    """Least-squares states of any number of cases."""

    state: Array
    """(..., 3)"""
    cost: Array
    """(...,) half the sum of squared residuals [rad^2]"""
    iterations: Array
    """(...,) Gauss-Newton steps taken"""
    converged: Array
    """(...,) bool"""


def wrapped(angle: Array) -> Array:
    """Angles [rad] in [-pi, pi]; small ones keep all their digits."""
    return np.asarray(angle - 2.0 * np.pi * np.round(np.asarray(angle) / (2.0 * np.pi)))


def rotation(theta: Array) -> Array:
    """(...,) [rad] -> (..., 2, 2), counter-clockwise."""
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def directions(state: Array, edges: Array) -> Array:
    """Where the edges (n, 2) are [m], from the camera; state (..., 3) -> (..., n, 2)."""
    state, edges = _checked(state, edges)
    return np.asarray(_turned(state, edges) + state[..., None, :2])


def bearings(state: Array, edges: Array) -> Array:
    """(..., n) [rad] in (-pi, pi]; state (..., 3), edges (n, 2). An edge at the camera is an InputError."""
    s = directions(state, edges)
    _away_from_camera(s)
    return np.arctan2(s[..., 1], s[..., 0])


def folded_bearings(state: Array, edges: Array) -> Array:
    """The slides' ``arccos(s1 / |s|)``, in [0, pi]: an edge below the axis looks as if it were above."""
    s = directions(state, edges)
    _away_from_camera(s)
    return np.asarray(np.arccos(s[..., 0] / np.linalg.norm(s, axis=-1)))


def printed_directions(state: Array, edges: Array) -> Array:
    """``directions`` as the slides print them: the last term of s2 is ``- e2 cos(theta)``."""
    state, edges = _checked(state, edges)
    c, s = np.cos(state[..., 2:]), np.sin(state[..., 2:])
    first = state[..., :1] + edges[:, 0] * c - edges[:, 1] * s
    second = state[..., 1:2] + edges[:, 0] * s - edges[:, 1] * c
    return np.stack([first, second], axis=-1)


def jacobian(state: Array, edges: Array) -> Array:
    """H = d bearings / d state: (..., n, 3) in [rad/m, rad/m, rad/rad]; state (..., 3), edges (n, 2).

    d phi = (s1 ds2 - s2 ds1) / |s|^2 and ds / d theta is R e turned by 90 degrees, so a row is
    (-s2, s1, s . R e) / |s|^2.
    """
    state, edges = _checked(state, edges)
    turned = _turned(state, edges)
    s = turned + state[..., None, :2]
    _away_from_camera(s)
    rows = np.stack([-s[..., 1], s[..., 0], (s * turned).sum(axis=-1)], axis=-1)
    return np.asarray(rows / (s**2).sum(axis=-1)[..., None])


def metric(state: Array, edges: Array) -> Array:
    """(H^T H)^-1 (..., 3, 3) in [m^2/rad^2], [m/rad], [1]; state (..., 3), edges (n, 2).

    Where a component is hidden its variance is inf and its covariances are 0; what the bearings do determine
    stays finite.
    """
    scaled, length = _scaled_jacobian(state, edges)
    # Rows beyond the number of edges are directions that no edge sees.
    _, some, rows = np.linalg.svd(scaled)
    values = np.zeros(length.shape)
    values[..., : some.shape[-1]] = np.where(some > SINGULAR * some[..., :1], some, 0.0)
    seen = values > 0.0
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=seen)
    half = rows * inverse[..., None] / length[..., None, :]
    cov = np.swapaxes(half, -1, -2) @ half
    lost = (~seen[..., None] & (np.abs(rows) > SHARE)).any(axis=-2)
    cov = np.where(lost[..., None] | lost[..., None, :], 0.0, cov)
    return np.where(lost[..., None] & np.eye(3, dtype=bool), np.inf, cov)


def covariance(state: Array, edges: Array, sigma_rad: float) -> Array:
    """(..., 3, 3) of (p1, p2, theta) [m^2, m rad, rad^2] for bearings of the standard deviation sigma."""
    if not (np.isfinite(sigma_rad) and sigma_rad > 0.0):
        raise InputError(f"sigma_rad: {sigma_rad} is no standard deviation; give a positive angle")
    return metric(state, edges) * sigma_rad**2


def hidden(state: Array, edges: Array) -> str | None:
    """Why the state (3,) does not follow from the bearings of the edges (n, 2); None where it does."""
    cov = metric(state, edges)
    lost = [name for name, value in zip(COMPONENTS, np.diag(cov), strict=True) if np.isinf(value)]
    if not lost:
        return None
    s = directions(state, edges)
    reach = np.linalg.norm(s, axis=1).max()
    apart = np.linalg.norm(s[:, None] - s, axis=-1) > SAME_PLACE * reach
    places = sum(bool(apart[i, :i].all()) for i in range(len(s)))
    across = s[:, 0] * s[0, 1] - s[:, 1] * s[0, 0]
    if places < 3:
        reason = f"{places} of 3 bearings that are needed: the edges lie at {places} different places"
        if places == 1:
            reason = "1 of 3 bearings that are needed: all edges lie at one place"
    elif np.all(np.abs(across) <= SAME_PLACE * reach**2):
        reason = "all edges lie on one line through the camera, which moves along it unseen"
    else:
        reason = "the camera lies on one circle with all edges, or too near it to tell"
    return f"{', '.join(lost)} not determined: {reason}"


def linear_estimate(prior: Array, edges: Array, measured_rad: Array) -> Array:
    """The slides' one step: x_a + (H^T H)^-1 H^T z with H and z = measured - predicted at the prior x_a.

    prior (..., 3), edges (n, 2), measured_rad (..., n) -> (..., 3). Differences are taken around the circle.
    """
    prior, edges = _checked(prior, edges)
    _determined(prior, edges)
    return prior + _step(prior, edges, wrapped(measured_rad - bearings(prior, edges)))


def gauss_newton(prior: Array, edges: Array, measured_rad: Array) -> PlanarEstimate:
    """Least squares of the bearings themselves: the linear step again and again, halved while it does harm.

    prior (..., 3), edges (n, 2), measured_rad (..., n). A case that ends elsewhere than at a minimum is told
    by ``converged``.
    """
    prior, edges = _checked(prior, edges)
    measured_rad = np.asarray(measured_rad, dtype=np.float64)
    shape = np.broadcast_shapes(prior.shape[:-1], measured_rad.shape[:-1])
    x = np.broadcast_to(prior, (*shape, 3)).reshape(-1, 3).copy()
    z = np.broadcast_to(measured_rad, (*shape, len(edges))).reshape(-1, len(edges))
    _determined(prior, edges)
    residual = wrapped(z - bearings(x, edges))
    cost = 0.5 * (residual**2).sum(axis=1)
    iterations, done, stuck = np.zeros(len(x), int), np.zeros(len(x), bool), np.zeros(len(x), bool)
    for _ in range(MAX_ITERATIONS):
        running = np.flatnonzero(~done & ~stuck)
        if not len(running):
            break
        step = _step(x[running], edges, residual[running])
        seen = np.abs(np.einsum("cij,cj->ci", jacobian(x[running], edges), step)).max(axis=1)
        scale, waiting = np.ones(len(running)), np.ones(len(running), bool)
        for _ in range(MAX_HALVINGS):
            rows = running[waiting]
            trial = x[rows] + scale[waiting, None] * step[waiting]
            left = wrapped(z[rows] - bearings(trial, edges))
            new = 0.5 * (left**2).sum(axis=1)
            # Near the minimum rounding decides which of two costs is less; it must not stop the iteration.
            blur = BLUR * np.abs(residual[rows]).sum(axis=1)
            good = (new <= cost[rows] + blur) | (seen[waiting] < STEP)
            x[rows[good]], residual[rows[good]], cost[rows[good]] = trial[good], left[good], new[good]
            waiting[np.flatnonzero(waiting)[good]] = False
            if not waiting.any():
                break
            scale[waiting] *= 0.5
        iterations[running] += 1
        stuck[running] = waiting
        done[running] = ~waiting & (seen < STEP)
    return PlanarEstimate(
        x.reshape(*shape, 3), cost.reshape(shape), iterations.reshape(shape), done.reshape(shape)
    )


def _step(state: Array, edges: Array, residual: Array) -> Array:
    """(..., 3) least-squares solution of H dx = residual (..., n), by H with columns of length 1."""
    scaled, length = _scaled_jacobian(state, edges)
    solution = np.linalg.pinv(scaled, rcond=SINGULAR) @ residual[..., None]
    return np.asarray(solution[..., 0] / length)


def _scaled_jacobian(state: Array, edges: Array) -> tuple[Array, Array]:
    """H (..., n, 3) with columns of length 1, so that metres and radians are alike; their lengths (..., 3).

    A column that is rounding alone, beside what the lever arms could give, becomes 0 and its length 1.
    """
    H = jacobian(state, edges)
    length = np.linalg.norm(H, axis=-2)
    reach = 1.0 / np.linalg.norm(directions(state, edges), axis=-1)
    arms = np.stack([reach, reach, reach * np.linalg.norm(edges, axis=1)], axis=-1)
    real = length > ROUNDING * np.linalg.norm(arms, axis=-2)
    length = np.where(real, length, 1.0)
    return np.where(real[..., None, :], H / length[..., None, :], 0.0), length


def _determined(states: Array, edges: Array) -> None:
    """InputError at the first of the states (..., 3) where something is hidden."""
    lost = np.isinf(metric(states, edges)).any(axis=(-1, -2))
    if lost.any():
        reason = hidden(states[lost][0] if states.ndim > 1 else states, edges)
        raise InputError(f"edges: {reason}; add edges elsewhere")


def _turned(state: Array, edges: Array) -> Array:
    """R(theta) e: (..., n, 2)."""
    return np.asarray(np.einsum("...ij,nj->...ni", rotation(state[..., 2]), edges))


def _checked(state: Array, edges: Array) -> tuple[Array, Array]:
    state, edges = np.asarray(state, dtype=np.float64), np.asarray(edges, dtype=np.float64)
    if edges.ndim != 2 or edges.shape[1] != 2 or not len(edges) or not np.isfinite(edges).all():
        raise InputError(
            f"edges: shape {edges.shape}; give at least one point (e1, e2) in metres, all finite"
        )
    if state.ndim < 1 or state.shape[-1] != 3 or not np.isfinite(state).all():
        raise InputError(f"state: shape {state.shape}; give (p1 [m], p2 [m], theta [rad]), all finite")
    return state, edges


def _away_from_camera(s: Array) -> None:
    at_camera = np.flatnonzero((s == 0.0).all(axis=-1).reshape(-1, s.shape[-2]).any(axis=0))
    if len(at_camera):
        raise InputError(f"edge {at_camera[0]} lies in the camera and has no bearing; move it or the model")
