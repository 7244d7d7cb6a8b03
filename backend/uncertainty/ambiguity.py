"""Two motions that fit equally well: the target may rotate in either direction between frames.

The shorter rotations are reported, as with any sampled signal; rates, inertia and axes then rest on this
assumption and not on the data, so they are reported as not determined.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.backend.initialization.multistart import HypothesisFit
from polhode.backend.initialization.rates import OPPOSITE_DIRECTION
from polhode.backend.uncertainty.covariance import with_infinite
from polhode.geometry.lie import Array
from polhode.records.estimate import MotionEstimate

AS_GOOD = 0.02
"""Relative difference of the misfit that is not significant: the wrong direction of a tumbling motion costs
several times the misfit, and small differences may come from the noise model."""
TOO_FAR_DEG, FAR_DEG = 225.0, 150.0
"""Rotations beyond the first may be off by a revolution: no direction is accepted. From the second on a
direction is accepted only if the disturbances remain about as small as stated."""
AMBIGUOUS = (
    "not determined: another motion, with the opposite direction of rotation between frames, fits as well"
)
OF_STATE = np.r_[np.zeros(6, dtype=np.bool_), np.ones(6, dtype=np.bool_)]
"""Attitude and rate."""
OF_JOINT = np.r_[OF_STATE, np.ones(5, dtype=np.bool_), np.zeros(3, dtype=np.bool_)]
"""Attitude, rate and inertia, of state, inertia and centre of mass."""


@dataclass(frozen=True)
class HypothesisChoice:
    """The chosen hypothesis, and median rotations [deg] of it and of one that fits equally well, if any."""

    name: str
    turns_deg: tuple[float, float] | None


def choose_hypothesis(trials: dict[str, HypothesisFit], dt_s: Array) -> HypothesisChoice:
    """The best hypothesis; of two directions that fit equally well, the shorter rotations. dt_s (F - 1,)."""
    bests = []
    for other in (False, True):
        names = [name for name in trials if name.endswith(OPPOSITE_DIRECTION) == other]
        bests += [min(names, key=lambda name: trials[name].cost)] if names else []
    # the normalization depends on the rate: it must not decide between two directions
    bests.sort(key=lambda name: trials[name].misfit)
    if len(bests) < 2 or trials[bests[1]].misfit > (1.0 + AS_GOOD) * trials[bests[0]].misfit:
        return HypothesisChoice(bests[0], None)
    turns = {name: _turn_deg(trials[name], dt_s) for name in bests}
    short, far = sorted(bests, key=lambda name: turns[name])
    return HypothesisChoice(short, (turns[short], turns[far]))


def _turn_deg(trial: HypothesisFit, dt_s: Array) -> float:
    return float(np.rad2deg(np.median(np.linalg.norm(trial.iterate.w_G[:-1], axis=1) * dt_s)))


def ambiguous_turns_deg(
    choice: HypothesisChoice, trial: HypothesisFit, dt_s: Array, much_disturbed: bool
) -> tuple[float, float] | None:
    """Median rotations [deg] of the motion and of the one that fits equally well; None if there is none."""
    turn = _turn_deg(trial, dt_s)
    if choice.turns_deg is None and (turn > TOO_FAR_DEG or (much_disturbed and turn > FAR_DEG)):
        return turn, abs(360.0 - turn)
    return choice.turns_deg


def with_ambiguous_rotation(estimate: MotionEstimate, turns_deg: tuple[float, float]) -> MotionEstimate:
    """The estimate with all that depends on the direction of rotation undetermined, and a warning."""
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
    warning = (
        f"the direction of rotation is ambiguous: {turns_deg[0]:.0f} degrees between frames, as reported, or "
        f"{turns_deg[1]:.0f} in the opposite direction; a higher frame rate would resolve it"
    )
    return replace(
        estimate,
        covariance=np.stack([with_infinite(state, OF_STATE) for state in estimate.covariance]),
        covariance_last_joint=with_infinite(estimate.covariance_last_joint, OF_JOINT),
        mass=mass,
        warnings=(*estimate.warnings, warning),
        rotation_is_ambiguous=True,
    )
