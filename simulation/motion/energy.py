"""Loss of the target's rotational energy, by drag or by friction inside."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from polhode.config import scene as config
from polhode.errors import InputError
from polhode.lie import Array
from polhode.simulation.motion.integrate import advance, body_rate, no_forces

MAX_LAG = 1.0
"""Maximum of friction times body rate over the smallest moment, the lag of the ball; beyond, the law is
invalid.
"""
MIN_EXCESS = 1e-9
"""A spin with a smaller share of excess energy counts as one about a principal axis, without friction."""


def energy_of_momentum(h_P: ArrayLike, moments: ArrayLike) -> Array:
    """Rotational energy 0.5 h.J^-1 h, h_P (..., 3) [N m s], moments (3,) [kg m^2] -> (...) [J]."""
    return np.asarray(0.5 * np.sum(np.square(h_P) / np.asarray(moments), axis=-1))


def excess_energy(h_P: ArrayLike, moments: ArrayLike) -> Array:
    """Energy above that of a spin about the greatest axis with the same momentum: (..., 3) -> (...) [J]."""
    J = np.asarray(moments, dtype=np.float64)
    # Each term is small near that spin; the difference of the two energies would suffer from cancellation.
    return np.asarray(0.5 * np.sum(np.square(h_P) * (1.0 / J - 1.0 / J[0]), axis=-1))


def loss_coefficients(motion: config.Motion, moments: Array, w_P: Array) -> tuple[float, float]:
    """Coefficients of drag [1/s] and friction [kg m^2 s] for the energy loss of the scene.

    w_P (3,) [rad/s] at the first frame. Raises InputError if friction cannot cause it, or the loss is total.
    """
    if motion.energy_loss == 0.0:
        return 0.0, 0.0
    if motion.energy_loss == 1.0:
        raise InputError("scene.motion.energy_loss is 1: all energy is never lost; give a share below 1")
    if motion.energy_loss_by == "drag":
        return drag_for_loss(motion.energy_loss, motion.energy_loss_s), 0.0
    return 0.0, friction_for_loss(motion.energy_loss, motion.energy_loss_s, moments, w_P)


def drag_for_loss(share: float, duration_s: float) -> float:
    """c [1/s] of the torque -c h: the energy is E0 exp(-2 c t)."""
    return float(-np.log1p(-share) / (2.0 * duration_s))


def friction_for_loss(share: float, duration_s: float, moments: Array, w_P: Array) -> float:
    """Coefficient [kg m^2 s] with which ``share`` of the excess energy is gone after ``duration_s``.

    Nothing else acts. Raises InputError for a spin about a principal axis, and for a loss so fast that the
    ball inside would not follow the body.
    """
    largest = MAX_LAG * moments[2] ** 2 / max(float(np.linalg.norm(moments * w_P)), 1e-300)
    _require_wobble(moments, w_P)

    def missing(log_friction: float) -> float:
        friction = float(np.exp(log_friction))
        h_P = momentum_of_rate(w_P, moments, friction)
        forces = no_forces(moments)._replace(friction=friction)
        state = np.concatenate([np.zeros(6), [1.0, 0.0, 0.0, 0.0], h_P])
        left = excess_energy(advance(state, 0.0, duration_s, forces)[10:13], moments)
        return float(left / excess_energy(h_P, moments)) - (1.0 - share)

    low, high = float(np.log(1e-12 * largest)), float(np.log(largest))
    short = missing(high)
    if short > 0:
        raise InputError(
            f"scene.motion.energy_loss: friction takes at most {share - short:.2g} of the excess energy in "
            f"{duration_s:g} s; give a smaller share or a longer energy_loss_s"
        )
    return float(np.exp(brentq(missing, low, high, xtol=1e-12, rtol=1e-14)))


def momentum_of_rate(w_P: Array, moments: Array, friction: float) -> Array:
    """Angular momentum h_P (3,) [N m s] of a body with friction inside at the rate w_P (3,) [rad/s]."""
    h_P = moments * w_P
    for _ in range(100):
        h_P = h_P + moments * (w_P - body_rate(h_P, moments, friction))
    return np.asarray(h_P)


def _require_wobble(moments: Array, w_P: Array) -> None:
    h_P = moments * w_P
    energy = float(energy_of_momentum(h_P, moments))
    rest = np.sort(0.5 * h_P**2 / moments)[:-1].sum()
    if rest <= MIN_EXCESS * energy or excess_energy(h_P, moments) <= MIN_EXCESS * energy:
        raise InputError(
            "scene.motion.energy_loss: friction takes no energy from a spin about a principal axis; "
            "tilt spin_rpm or set energy_loss_by to drag"
        )
