"""First guesses of the inertia: a single start was seen to end, confident, in a wrong basin."""

import numpy as np

from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.lie import Array, hat

N_HYPOTHESES = 5
"""Most guesses; more are tried where the sense of the turns is open."""


def inertia_hypotheses(R_NG: Array, w_G: Array) -> dict[str, Array]:
    """Second moments (3, 3) in G by name, from attitudes (F, 3, 3) and body rates (F, 3) [rad/s]."""
    guesses = {"sphere": np.eye(3)}
    J = inertia_from_momentum(R_NG, w_G)
    if J is not None:
        guesses["momentum"] = second_moments_from_inertia(J)
    axis = spin_axis(w_G)
    along = np.outer(axis, axis)
    # a stretched body has large second moments along its axis and a small moment of inertia about it
    guesses["prolate"] = np.eye(3) + 1.5 * along
    guesses["oblate"] = np.eye(3) - 0.6 * along
    side = wobble_axis(w_G, axis)
    guesses["flat across"] = np.eye(3) + 1.0 * along - 0.5 * np.outer(side, side)
    return guesses


def inertia_from_momentum(R_NG: Array, w_G: Array) -> Array | None:
    """J (3, 3) for which R J w is most nearly constant, I + D with a unit prior on D; None when impossible.

    The momentum itself is eliminated by its mean. The noise of the rates, from their second differences, sets
    how much the data may say against the sphere.
    """
    if len(w_G) < 4:
        return None
    x, y, z = w_G[:, 0], w_G[:, 1], w_G[:, 2]
    o = np.zeros_like(x)
    columns = [[x, o, o, y, z, o], [o, y, o, x, o, z], [o, o, z, o, x, y]]
    h = R_NG @ np.stack([np.stack(row, axis=-1) for row in columns], axis=1)
    rows = (h - h.mean(axis=0)).reshape(-1, 6)
    curvature = np.diff(w_G, 2, axis=0)
    noise = np.median(np.abs(curvature)) / 0.6745 / np.sqrt(6.0) + 1e-6
    sphere = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    normal = rows.T @ rows + noise**2 * np.eye(6)
    a, b, c, d, e, f = sphere + np.linalg.solve(normal, -rows.T @ (rows @ sphere))
    J = np.array([[a, d, e], [d, b, f], [e, f, c]])
    values = np.linalg.eigvalsh(J)
    return J if values[0] > 0.0 and values[0] + values[1] > values[2] else None


def spin_axis(w_G: Array) -> Array:
    """Principal direction (3,) of the rates."""
    _, vectors = np.linalg.eigh(w_G.T @ w_G + 1e-12 * np.eye(3))
    return np.asarray(vectors[:, -1])


def wobble_axis(w_G: Array, axis: Array) -> Array:
    """Direction (3,) across the spin in which the rates vary most."""
    across = w_G @ (hat(axis) @ hat(axis))
    _, vectors = np.linalg.eigh(
        across.T @ across + 1e-12 * np.diag([1.0, 0.9, 0.8]) - 1e3 * np.outer(axis, axis)
    )
    return np.asarray(vectors[:, -1])
