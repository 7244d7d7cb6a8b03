"""Several motions that fit equally well: the images do not tell how far the target rotates between frames.

A rotation by 240 degrees leads to the same attitude as one by 120 degrees in the opposite direction, and one
by 400 degrees to that of 40. Euler's equation tells them apart if the axis of rotation moves in the body;
otherwise all fit. The most probable motion is reported, the others beside it with their odds; rates, inertia
and axes rest on the choice and not on the data, so they are reported as not determined.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.initialization.multistart import HypothesisFit, best_of_rotations
from polhode.backend.initialization.rates import intervals_differ
from polhode.backend.uncertainty.covariance import with_infinite
from polhode.geometry.lie import Array
from polhode.records.estimate import MotionEstimate, RotationHypothesis

AS_GOOD = 0.02
"""Relative difference of the misfit that is not significant: the wrong direction of a tumbling motion costs
several times the misfit, and small differences may come from the noise model."""
LOG_ODDS_OF_AS_GOOD = 3.0
"""Log odds of that difference."""
TOO_FAR_DEG, FAR_DEG = 225.0, 150.0
"""Rotations beyond the first may be off by a revolution: no direction is accepted. From the second on a
direction is accepted only if the disturbances remain about as small as stated."""
ODDS_OF_OTHER = 0.25
"""Of the other rotation in these cases."""
AMBIGUOUS = "not determined: another motion, with another rotation between frames, fits as well"
OF_STATE = np.r_[np.zeros(6, dtype=np.bool_), np.ones(6, dtype=np.bool_)]
"""Attitude and rate."""
OF_JOINT = np.r_[OF_STATE, np.ones(5, dtype=np.bool_), np.zeros(3, dtype=np.bool_)]
"""Attitude, rate and inertia, of state, inertia and centre of mass."""


@dataclass(frozen=True)
class OpenRotation:
    """A rotation between frames that the data leave open."""

    name: str | None
    """Of the hypothesis that was fitted; None: the chosen motion, a revolution off, without nutation"""
    turn_deg: float
    """Median rotation between frames"""
    odds: float


def choose_hypothesis(
    trials: dict[str, HypothesisFit], dt_s: Array, is_limited: bool = False
) -> tuple[OpenRotation, ...]:
    """The rotations whose best hypotheses fit equally well, the most probable first. dt_s (F - 1,).

    Beforehand all rates up to a stated limit are equally probable (is_limited); without one, less than half a
    revolution between frames is assumed, and the others have the odds ``ODDS_OF_OTHER``.
    """
    # the normalization depends on the rate: it must not decide between two rotations
    names = best_of_rotations(trials)
    least = min(trials[name].misfit for name in names)
    worse = {name: (trials[name].misfit - least) / max(AS_GOOD * least, 1e-300) for name in names}
    turns = {name: _turn_deg(trials[name], dt_s) for name in names if worse[name] <= 1.0}
    other = 1.0 if is_limited else ODDS_OF_OTHER / (1.0 - ODDS_OF_OTHER)
    before = {name: other if turn > 180.0 else 1.0 for name, turn in turns.items()}
    weight = {name: before[name] * float(np.exp(-LOG_ODDS_OF_AS_GOOD * worse[name])) for name in turns}
    return _by_odds([OpenRotation(name, turns[name], weight[name]) for name in turns])


def _by_odds(rotations: list[OpenRotation]) -> tuple[OpenRotation, ...]:
    """The most probable first, their odds adding up to one."""
    total = sum(each.odds for each in rotations)
    ordered = sorted(rotations, key=lambda each: -each.odds)
    return tuple(replace(each, odds=float(each.odds / total)) for each in ordered)


def _turn_deg(trial: HypothesisFit, dt_s: Array) -> float:
    return float(np.rad2deg(np.median(np.linalg.norm(trial.iterate.w_G[:-1], axis=1) * dt_s)))


def open_rotations(
    chosen: tuple[OpenRotation, ...],
    trials: dict[str, HypothesisFit],
    dt_s: Array,
    much_disturbed: bool,
    is_limited: bool = False,
) -> tuple[OpenRotation, ...]:
    """The chosen rotations, or two where a far one was chosen alone, which may be a revolution off.

    Not where intervals differ: a revolution more or less then fits none but the interval that it is fitted
    to. is_limited: a limit is stated, and other rotations than those that were tried are beyond it.
    """
    first = chosen[0]
    is_far = first.turn_deg > TOO_FAR_DEG or (much_disturbed and first.turn_deg > FAR_DEG)
    others = {name: trials[name].misfit for name in best_of_rotations(trials) if name != first.name}
    if len(chosen) > 1 or not is_far or intervals_differ(dt_s) or (is_limited and not others):
        return chosen
    other = min(others, key=lambda name: others[name]) if others else None
    turn_deg = abs(360.0 - first.turn_deg) if other is None else _turn_deg(trials[other], dt_s)
    return replace(first, odds=1.0 - ODDS_OF_OTHER), OpenRotation(other, turn_deg, ODDS_OF_OTHER)


def revolution_off(estimate: MotionEstimate, dt_s: float, rotation: OpenRotation) -> RotationHypothesis:
    """The end of the motion with a revolution less between frames, of a body without nutation."""
    own = end_of(estimate, rotation)
    turn_rad = float(np.linalg.norm(own.w_G)) * dt_s
    w_G = own.w_G * (1.0 - 2.0 * np.pi / max(turn_rad, 1e-6))
    return replace(own, w_G=w_G, J_G=np.eye(3))


def end_of(estimate: MotionEstimate, rotation: OpenRotation) -> RotationHypothesis:
    """The last state of an estimate as one of several hypotheses."""
    mass, noise = estimate.mass, estimate.noise
    assert estimate.covariance_last_body is not None
    return RotationHypothesis(
        odds=rotation.odds,
        turn_deg=rotation.turn_deg,
        r_N=estimate.r_N[-1],
        v_N=estimate.v_N[-1],
        R_NG=estimate.R_NP[-1] @ mass.R_GP.T,
        w_G=mass.R_GP @ estimate.w_P[-1],
        J_G=mass.J_G,
        R_GP=mass.R_GP,
        com_G=mass.com_G,
        covariance=estimate.covariance_last_body,
        accel_psd=noise.accel_psd,
        torque_psd=noise.torque_psd,
        level_decades=(noise.accel_psd_decades, noise.torque_psd_decades),
    )


def with_ambiguous_rotation(
    estimate: MotionEstimate, hypotheses: tuple[RotationHypothesis, ...]
) -> MotionEstimate:
    """The estimate with all that depends on the choice of the rotation undetermined."""
    known, mass = estimate.mass.identifiable, estimate.mass
    detail = {
        name: AMBIGUOUS if name.startswith(("k", "axes")) and not text.startswith("not") else text
        for name, text in known.detail.items()
    }
    known = replace(
        known,
        k1=False,
        k2=False,
        axes=False,
        axes_P=np.zeros(3, dtype=np.bool_),
        detail=detail,
        sigma=np.where(np.arange(8) < 3, known.sigma, np.inf),
    )
    mass = replace(
        mass,
        cov_k=with_infinite(mass.cov_k, np.ones(2, dtype=np.bool_)),
        cov_J=with_infinite(mass.cov_J, np.ones(5, dtype=np.bool_)),
        cov_R_GP=with_infinite(mass.cov_R_GP, np.ones(3, dtype=np.bool_)),
        identifiable=known,
    )
    return replace(
        estimate,
        covariance=np.stack([with_infinite(state, OF_STATE) for state in estimate.covariance]),
        covariance_last_joint=with_infinite(estimate.covariance_last_joint, OF_JOINT),
        mass=mass,
        hypotheses=hypotheses,
    )
