"""Fit of a motion with a known wrench, starting from one fitted without it; absolute mass and inertia.

The wrench is given along the principal axes, whose half-turns are a convention: up to four fits are tried and
the best is kept. Where two moments may be equal, their axes may also be exchanged, which doubles the
candidates. Known forces and torques make mass and inertia observable in kilograms, not only up to scale.
"""

from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.problem.inertia import InertiaForm, principal_axes
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import LN_MASS, LN_SCALE, N_WRENCH, Impulses
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import linearization_point
from polhode.backend.uncertainty.covariance import Marginals
from polhode.backend.uncertainty.principal_axes import AxesDerivative
from polhode.errors import RunFailure
from polhode.lie import Array, exp_so3
from polhode.records import MassProperties

MAYBE_EQUAL = 0.1
"""Logarithm of two moments' ratio below which their axes may be exchanged."""
MAX_FITS = 4
"""Number of fits: the orders and half-turns of the axes that best match the change of momentum."""
PASSES = (4, 4, 4)
MAX_LN = 14.0
"""Largest logarithm of mass [kg] and scale, where the wrench has no visible effect."""
MAX_SIGMA = 0.3
"""Largest standard deviation of a logarithm that counts as determined."""


@dataclass(frozen=True)
class WrenchGuess:
    """Axes of the torque in G, the unknowns of the wrench, and the misfit of the momentum."""

    name: str
    R_torque: Array
    wrench: Array
    misfit: float


@dataclass(frozen=True)
class LogEstimate:
    """Logarithm of a positive quantity, its standard deviation, and whether it is determined."""

    value: float
    sigma: float
    determined: bool


def fit_known_wrench(data: MotionData, iterate: Iterate) -> tuple[Iterate, dict[str, float]]:
    """Fit the wrench of ``data`` too, from a motion that was fitted with loose steps where the wrench acts.

    Returns the motion with its wrench, and the additional cost of the other directions of the axes.

    Raises RunFailure if no direction of the axes leads to a solution.
    """
    assert data.impulses is not None
    guesses = _guesses(data, iterate, data.impulses)
    found: dict[str, tuple[Iterate, float]] = {}
    for guess in sorted(guesses, key=lambda guess: guess.misfit)[:MAX_FITS]:
        at = replace(iterate, wrench=guess.wrench, R_torque=guess.R_torque)
        fitted = _fit(data, at)
        if fitted is not None:
            found[guess.name] = fitted
    if not found:
        raise RunFailure("no motion is consistent with the known forces and torques of wrench0")
    best = min(found, key=lambda name: found[name][1])
    costs = {name: cost - found[best][1] for name, (_, cost) in found.items() if name != best}
    return found[best][0], costs


def _fit(data: MotionData, iterate: Iterate) -> tuple[Iterate, float] | None:
    solver, cost = GaussNewton(data), np.inf
    for iterations in PASSES:
        try:
            fixed = linearization_point(data, iterate)
            solution = solver.solve(fixed, iterate.vector(), iterations)
        except LinAlgError:
            return None
        iterate, cost = iterate.moved_to(solution.x), solution.cost + fixed.half_log_det
    return (iterate, float(cost)) if np.isfinite(cost) else None


def _guesses(data: MotionData, iterate: Iterate, known: Impulses) -> list[WrenchGuess]:
    moments, R_GP = principal_axes(iterate.J_G(data.form))
    ln_mass = _ln_inverse(_slope(iterate.v_N, known.cumulative[:, :3])[0])
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


def _guess(name: str, R_torque: Array, ln_scale: float, ln_mass: float, misfit: float) -> WrenchGuess:
    wrench = np.zeros(N_WRENCH)
    wrench[LN_SCALE], wrench[LN_MASS] = ln_scale, ln_mass
    return WrenchGuess(name, R_torque, wrench, misfit)


def _impulses_N(data: MotionData, iterate: Iterate, known: Impulses, R_torque: Array) -> Array:
    """Impulse of the torque in each step (F - 1, 3) [N m s], in N by the attitude at its middle."""
    half = exp_so3(0.5 * data.dt_s[:, None] * iterate.w_G[:-1])
    R_N = iterate.R_NG[:-1] @ half @ R_torque
    return np.asarray(np.einsum("kij,kj->ki", R_N, np.diff(known.cumulative[:, 3:], axis=0)))


def _slope(series: Array, impulse: Array) -> tuple[float, float]:
    """Factor that best fits impulse (F, 3) to the change of series (F, 3), and the mean square residual."""
    series, impulse = series - series.mean(axis=0), impulse - impulse.mean(axis=0)
    size = float(np.sum(impulse**2))
    factor = float(np.sum(series * impulse)) / size if size > 0.0 else 0.0
    # a negative factor would mean a negative mass or inertia
    return factor, float(np.mean((series - max(factor, 0.0) * impulse) ** 2))


def _ln_inverse(factor: float) -> float:
    return float(-np.log(max(factor, np.exp(-MAX_LN))))


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


def with_absolute_scale(
    mass: MassProperties,
    iterate: Iterate,
    form: InertiaForm,
    m: Marginals,
    derivative: AxesDerivative,
    known: Impulses | None,
) -> MassProperties:
    """Mass properties with mass and middle moment in absolute units; unchanged without a known wrench."""
    if iterate.wrench is None or m.wrench_information is None or known is None:
        return mass
    scale, kilograms = _logarithms(iterate, form, m, derivative)
    force, torque = (size > 0.0 for size in known.largest)
    detail = {
        **mass.identifiable.detail,
        "mass": _description(kilograms, force, "force"),
        "inertia_scale": _description(scale, torque, "torque"),
    }
    return replace(
        mass,
        mass_kg=float(np.exp(kilograms.value)),
        sigma_mass_kg=_sigma(kilograms),
        inertia_scale_kg_m2=float(np.exp(scale.value)),
        sigma_inertia_scale_kg_m2=_sigma(scale),
        identifiable=replace(mass.identifiable, detail=detail),
    )


def _logarithms(
    iterate: Iterate, form: InertiaForm, m: Marginals, derivative: AxesDerivative
) -> tuple[LogEstimate, LogEstimate]:
    """Logarithms of the middle moment [kg m^2] and of the mass [kg]."""
    assert iterate.wrench is not None and m.wrench_information is not None
    n = iterate.n_states
    at = np.r_[n + 3 : n + 8, n + 8 + LN_SCALE]
    along: Array = np.append(derivative.ln_middle, 1.0)
    middle = float(np.linalg.eigvalsh(iterate.J_G(form))[1])
    # standard deviations without the prior, from the data alone
    alone = 1.0 / np.sqrt(np.maximum(np.diag(m.wrench_information), 1e-12))
    ln_scale = LogEstimate(
        float(iterate.wrench[LN_SCALE] + np.log(middle)),
        float(np.sqrt(along @ m.dense[np.ix_(at, at)] @ along)),
        bool(alone[0] < MAX_SIGMA),
    )
    of_mass = n + 8 + LN_MASS
    sigma = float(np.sqrt(m.dense[of_mass, of_mass]))
    return ln_scale, LogEstimate(float(iterate.wrench[LN_MASS]), sigma, bool(alone[1] < MAX_SIGMA))


def _sigma(logarithm: LogEstimate) -> float:
    return float(np.exp(logarithm.value) * logarithm.sigma) if logarithm.determined else np.inf


def _description(logarithm: LogEstimate, acts: bool, what: str) -> str:
    if logarithm.determined:
        return f"determined, standard deviation about {100.0 * logarithm.sigma:.2g} %"
    if not acts:
        return f"not determined: no known {what} acts"
    return f"not determined: the effect of the known {what} is too small compared with the disturbances"
