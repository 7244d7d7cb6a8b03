"""From a motion fitted without its known wrench to one fitted with it.

The wrench is given along the principal axes, whose half-turns are a convention: four fits, the best is kept.
Where two moments may be equal their axes may also be exchanged, which adds as many.
"""

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.problem.inertia import principal_axes
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.problem import MotionData, hold
from polhode.backend.problem.wrench import LN_MASS, LN_SCALE, N_WRENCH, Impulses
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3

MAYBE_EQUAL = 0.1
"""Logarithm of two moments' ratio below which their axes may be exchanged."""
MOST_TRIALS = 4
"""Fits, of the orders and half-turns that fit the change of momentum best."""
PASSES = (4, 4, 4)
LARGEST_LN = 14.0
"""Of mass [kg] and scale, where the motion shows nothing of the push."""


@dataclass(frozen=True)
class Attached:
    """A motion with its wrench, and how much worse the other directions of the axes fit."""

    iterate: Iterate
    runner_up: dict[str, float]


@dataclass(frozen=True)
class Guess:
    """Axes of the torque in G, the unknowns that go with them, and what they leave of the momentum."""

    name: str
    R_torque: Array
    wrench: Array
    misfit: float


def attach_wrench(data: MotionData, iterate: Iterate) -> Attached:
    """Fit the wrench of ``data`` too, from a motion that was fitted with its steps left loose.

    Raises RunFailure when no direction of the axes leads to a solution.
    """
    assert data.impulses is not None
    guesses = _guesses(data, iterate, data.impulses)
    found: dict[str, tuple[Iterate, float]] = {}
    for guess in sorted(guesses, key=lambda guess: guess.misfit)[:MOST_TRIALS]:
        at = replace(iterate, wrench=guess.wrench, R_torque=guess.R_torque)
        fitted = _fit(data, at)
        if fitted is not None:
            found[guess.name] = fitted
    if not found:
        raise RunFailure("no motion is consistent with the known forces and torques of wrench0")
    best = min(found, key=lambda name: found[name][1])
    costs = {name: cost - found[best][1] for name, (_, cost) in found.items() if name != best}
    return Attached(found[best][0], costs)


def _fit(data: MotionData, iterate: Iterate) -> tuple[Iterate, float] | None:
    solver, cost = GaussNewton(data), np.inf
    for iterations in PASSES:
        try:
            held = hold(data, iterate)
            solution = solver.solve(held, iterate.vector(), iterations)
        except LinAlgError:
            return None
        iterate, cost = iterate.moved_to(solution.x), solution.cost + held.half_log_det
    return (iterate, float(cost)) if np.isfinite(cost) else None


def _guesses(data: MotionData, iterate: Iterate, known: Impulses) -> list[Guess]:
    moments, R_GP = principal_axes(iterate.J_G(data.form))
    ln_mass = _ln_inverse(_slope(iterate.v_N, known.so_far[:, :3])[0])
    if known.largest[1] == 0.0:
        return [_guess("no torque", R_GP, 0.0, ln_mass, 0.0)]
    guesses = []
    momentum_N = np.einsum("fij,fj->fi", iterate.R_NG, iterate.w_G @ iterate.J_G(data.form))
    for name, turn in _directions(moments):
        R = R_GP @ turn
        impulse_N = np.concatenate(
            [np.zeros((1, 3)), np.cumsum(_impulses_N(data, iterate, known, R), axis=0)]
        )
        inverse_scale, misfit = _slope(momentum_N, impulse_N)
        guesses.append(_guess(name, R, _ln_inverse(inverse_scale), ln_mass, misfit))
    return guesses


def _guess(name: str, R_torque: Array, ln_scale: float, ln_mass: float, misfit: float) -> Guess:
    wrench = np.zeros(N_WRENCH)
    wrench[LN_SCALE], wrench[LN_MASS] = ln_scale, ln_mass
    return Guess(name, R_torque, wrench, misfit)


def _impulses_N(data: MotionData, iterate: Iterate, known: Impulses, R_torque: Array) -> Array:
    """Impulse of the torque in each step (F - 1, 3), turned to N in its middle [N m s]."""
    half = exp_so3(0.5 * data.dt_s[:, None] * iterate.w_G[:-1])
    R_N = iterate.R_NG[:-1] @ half @ R_torque
    return np.asarray(np.einsum("kij,kj->ki", R_N, np.diff(known.so_far[:, 3:], axis=0)))


def _slope(series: Array, impulse: Array) -> tuple[float, float]:
    """Factor that makes impulse (F, 3) the change of series (F, 3), and the mean square that it leaves."""
    series, impulse = series - series.mean(axis=0), impulse - impulse.mean(axis=0)
    size = float(np.sum(impulse**2))
    factor = float(np.sum(series * impulse)) / size if size > 0.0 else 0.0
    # what pushes backwards pushes the wrong way
    return factor, float(np.mean((series - max(factor, 0.0) * impulse) ** 2))


def _ln_inverse(factor: float) -> float:
    return float(-np.log(max(factor, np.exp(-LARGEST_LN))))


def _directions(moments: Array) -> list[tuple[str, Array]]:
    """Half-turns of the principal axes, and exchanges of those whose moments may be equal, by name."""
    out = []
    for order in permutations(range(3)):
        gaps = [abs(np.log(moments[a] / moments[b])) for a, b in enumerate(order)]
        if max(gaps) > MAYBE_EQUAL:
            continue
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[list(order), range(3)] = signs
            if np.linalg.det(turn) > 0.0:
                name = " ".join(
                    f"{'+' if s > 0 else '-'}{'xyz'[n]}" for n, s in zip(order, signs, strict=True)
                )
                out.append((f"torque along {name}", turn))
    return out
