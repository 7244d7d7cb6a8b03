"""Fit of a motion with a known wrench, starting from one fitted without it; absolute mass and inertia.

The wrench is given along the principal axes, whose half-turns are a convention: up to four fits are tried and
the best is kept. Where two moments may be equal, their axes may also be exchanged, which doubles the
candidates. Known forces and torques make mass and inertia observable in kilograms, not only up to scale.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np

from polhode.backend.initialization.multistart import HypothesisFit, solve_briefly
from polhode.backend.problem.inertia import principal_axes
from polhode.backend.problem.iterate import N_CONSTANTS, Iterate
from polhode.backend.problem.wrench import LN_MASS, LN_SCALE, N_WRENCH
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.uncertainty.covariance import Marginals, and_constants, body_jacobians
from polhode.backend.uncertainty.principal_axes import AxesDerivative
from polhode.geometry.lie import Array, exp_so3
from polhode.records.estimate import MassProperties
from polhode.runtime.errors import RunFailure

MAX_EQUAL_LN_RATIO = 0.1
"""Logarithm of two moments' ratio below which their axes may be exchanged."""
MAX_LN_SIGMA = 0.3
"""Largest standard deviation of a logarithm that counts as determined."""


@dataclass(frozen=True)
class WrenchGuess:
    """Axes of the torque in G, logarithms of the inertia's scale and mass, and the misfit of the momentum."""

    name: str
    R_torque: Array
    ln_scale: float
    misfit: float


def fit_known_wrench(fit: MotionFit) -> tuple[Iterate, dict[str, float]]:
    """Fit the known wrench too, from a motion that was fitted with loose steps where the wrench acts.

    Returns the motion with its wrench, and the additional cost of the other directions of the axes.

    Raises RunFailure if no direction of the axes leads to a solution.
    """
    assert fit.data.impulses is not None
    wrench = np.zeros(N_WRENCH)
    wrench[LN_MASS] = _ln_inverse(_slope(fit.iterate.v_N, fit.data.impulses.cumulative[:, :3])[0])
    found: dict[str, HypothesisFit] = {}
    for guess in sorted(_guesses(fit), key=lambda guess: guess.misfit)[:4]:
        wrench = wrench.copy()
        wrench[LN_SCALE] = guess.ln_scale
        at = replace(fit.iterate, wrench=wrench, R_torque=guess.R_torque)
        fitted = solve_briefly(MotionFit(fit.data, at), [], (4, 4, 4), recenter=False)
        if fitted is not None:
            found[guess.name] = fitted
    if not found:
        raise RunFailure("no motion is consistent with the known forces and torques of wrench0")
    best = min(found, key=lambda name: found[name].cost)
    costs = {name: each.cost - found[best].cost for name, each in found.items() if name != best}
    return found[best].iterate, costs


def _guesses(fit: MotionFit) -> Iterator[WrenchGuess]:
    iterate, known, J_G = fit.iterate, fit.data.impulses, fit.iterate.J_G(fit.data.form)
    assert known is not None
    moments, R_GP = principal_axes(J_G)
    if known.largest[1] == 0.0:
        yield WrenchGuess("no torque", R_GP, 0.0, 0.0)
        return
    momentum_N = np.einsum("fij,fj->fi", iterate.R_NG, iterate.w_G @ J_G)
    # the impulse of the torque in each step, in N by the attitude at its middle
    half = exp_so3(0.5 * fit.data.dt_s[:, None] * iterate.w_G[:-1])
    impulses_P = np.diff(known.cumulative[:, 3:], axis=0)
    for name, turn in _directions(moments):
        R = R_GP @ turn
        steps_N = np.asarray(np.einsum("kij,kj->ki", iterate.R_NG[:-1] @ half @ R, impulses_P))
        impulse_N = np.concatenate([np.zeros((1, 3)), np.cumsum(steps_N, axis=0)])
        inverse_scale, misfit = _slope(momentum_N, impulse_N)
        yield WrenchGuess(name, R, _ln_inverse(inverse_scale), misfit)


def _slope(series: Array, impulse: Array) -> tuple[float, float]:
    """Factor that best fits impulse (F, 3) to the change of series (F, 3), and the mean square residual."""
    series, impulse = series - series.mean(axis=0), impulse - impulse.mean(axis=0)
    size = float(np.sum(impulse**2))
    factor = float(np.sum(series * impulse)) / size if size > 0.0 else 0.0
    # a negative factor would mean a negative mass or inertia
    return factor, float(np.mean((series - max(factor, 0.0) * impulse) ** 2))


def _ln_inverse(factor: float) -> float:
    """Logarithm of mass [kg] or scale; at most 14, where the wrench has no visible effect."""
    return float(-np.log(max(factor, np.exp(-14.0))))


def _directions(moments: Array) -> Iterator[tuple[str, Array]]:
    """Half-turns of the principal axes, and exchanges of those whose moments may be equal, by name."""
    for order in permutations(range(3)):
        gaps = [abs(np.log(moments[a] / moments[b])) for a, b in enumerate(order)]
        if max(gaps) > MAX_EQUAL_LN_RATIO:
            continue
        for signs in product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[list(order), range(3)] = signs
            if np.linalg.det(turn) > 0.0:
                axes = zip(order, signs, strict=True)
                yield "torque along " + " ".join(f"{'+' if s > 0 else '-'}{'xyz'[n]}" for n, s in axes), turn


def with_absolute_scale(
    mass: MassProperties, fit: MotionFit, m: Marginals, derivative: AxesDerivative
) -> MassProperties:
    """Mass properties with mass and middle moment in absolute units; unchanged without a known wrench."""
    known, wrench, n = fit.data.impulses, fit.iterate.wrench, fit.iterate.n_states
    if wrench is None or m.wrench_information is None or known is None:
        return mass
    at, along = np.r_[n + 3 : n + 8, n + 8 + LN_SCALE], np.append(derivative.ln_middle, 1.0)
    middle, of_mass = float(np.linalg.eigvalsh(fit.iterate.J_G(fit.data.form))[1]), n + 8 + LN_MASS
    last = and_constants(body_jacobians(fit.iterate, fit.data.camera_N)[-1])
    of_last = np.r_[n - fit.iterate.n_state : n + N_CONSTANTS]
    cov_ln_scale = last @ m.dense[np.ix_(of_last, at)] @ along
    # standard deviations without the prior, from the data alone
    alone = 1.0 / np.sqrt(np.maximum(np.diag(m.wrench_information), 1e-12))
    found, detail = dict[str, Any](), dict(mass.identifiable.detail)
    for name, field_name, what, size, ln, variance, alone_sigma in (
        ("mass", "mass_kg", "force", known.largest[0], wrench[LN_MASS], m.dense[of_mass, of_mass], alone[1]),
        ("inertia_scale", "inertia_scale_kg_m2", "torque", known.largest[1],
         wrench[LN_SCALE] + np.log(middle), along @ m.dense[np.ix_(at, at)] @ along, alone[0]),
    ):  # fmt: skip
        sigma, determined = float(np.sqrt(variance)), bool(alone_sigma < MAX_LN_SIGMA)
        found[field_name] = float(np.exp(ln))
        found[f"sigma_{field_name}"] = float(np.exp(ln) * sigma) if determined else np.inf
        if determined:
            detail[name] = f"determined, standard deviation about {100.0 * sigma:.2g} %"
        elif size > 0.0:
            detail[name] = (
                f"not determined: the effect of the known {what} is too small compared with the disturbances"
            )
        else:
            detail[name] = f"not determined: no known {what} acts"
    known_parts = replace(mass.identifiable, detail=detail)
    return replace(mass, identifiable=known_parts, cov_ln_scale=cov_ln_scale, **found)
