"""Forces and torques on the target: known ones, white disturbances, loss of energy by drag or friction.

Known forces and torques are also written to ``wrench0/``, in rows so dense that it matters little whether a
reader interpolates between them or keeps each until the next.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints
from polhode.runtime.errors import InputError
from polhode.simulation.motion import integrate
from polhode.simulation.motion.integrate import Forces, advance, body_rate, no_forces
from polhode.simulation.motion.mass import MassDistribution

MAX_CELL_S = 0.025
"""A white disturbance is constant for at most this long, and at most 1/20 of the frames' interval."""
MAX_CELLS = 2_000_000
"""Of the disturbances, and rows of the known wrench: 14 hours of the shortest."""
MAX_STEPS = 10_000_000
"""Of the integration, which makes some hundred thousand in a second."""
MAX_ROW_S = 0.05
"""Time between rows of the known wrench."""


def acting_forces(
    scene: config.Scene, mass: MassDistribution, w_P: Array, stop_s: float, seed: int
) -> Forces:
    """All forces and torques until ``stop_s`` after the first frame, for a target with w_P (3,) [rad/s]
    there.

    The disturbances up to any time depend on the seed and the interval between frames only.
    Raises InputError for an impossible loss of energy.
    """
    motion = scene.motion
    drag_hz, friction = loss_coefficients(motion, mass.moments, w_P)
    cell_s = float(min(MAX_CELL_S, scene.interval_s / 20))
    noisy = motion.accel_psd > 0 or motion.torque_psd > 0
    cells = int(np.ceil(stop_s / cell_s)) + 1 if noisy else 0
    rows = stop_s / MAX_ROW_S if motion.pushes and motion.pushes_known else 0.0
    if max(cells, rows) > MAX_CELLS:
        raise InputError(
            f"scene: disturbances or pushes over {stop_s:g} s take {max(cells, rows):.3g} steps, above "
            f"{MAX_CELLS:g}; give fewer frames, a shorter truth_horizon_s or a longer interval_s"
        )
    # White: the step of the velocity over a cell has the variance psd * cell_s on each axis.
    unit = np.random.default_rng([seed, 0x30]).normal(size=(cells, 6)) if cells else np.zeros((1, 6))
    white_accel_N = unit[:, :3] * np.sqrt(motion.accel_psd / cell_s)
    white_torque_P = unit[:, 3:] * np.sqrt(motion.torque_psd / cell_s) * mass.moments[1]
    edges_s = [edge for push in motion.pushes for edge in push_interval_s(push)]
    knots_s = np.unique(np.concatenate([cell_s * np.arange(1, cells), edges_s]))
    middles_s = np.zeros(1)
    if len(knots_s) > 0:
        between_s = 0.5 * (knots_s[1:] + knots_s[:-1])
        middles_s = np.concatenate([knots_s[:1] - 1.0, between_s, knots_s[-1:] + 1.0])
    cell = np.clip(np.floor(middles_s / cell_s).astype(int), 0, max(cells - 1, 0))
    accel_N, torque_P = white_accel_N[cell], white_torque_P[cell]
    for push in motion.pushes:
        start_s, end_s = push_interval_s(push)
        on = (start_s <= middles_s) & (middles_s < end_s)
        accel_N[on] += np.array(push.force_N) / mass.mass_kg
        torque_P[on] += push.torque_P
    # A motion of so many steps of integration that it would take hours is refused.
    inside = np.clip(np.concatenate([[0.0], knots_s, [np.inf]]), 0.0, stop_s)
    impulse = float(np.abs(np.cumsum(torque_P * np.diff(inside)[:, None], axis=0)).max())
    rate_rad_s = float(np.abs(w_P).sum()) + impulse / float(mass.moments.min())
    per_second = rate_rad_s / integrate.MAX_ROTATION_RAD + drag_hz
    if not per_second * stop_s <= MAX_STEPS:
        raise InputError(
            f"scene.motion: spin, torques and losses reach {rate_rad_s:.3g} rad/s within {stop_s:g} s, "
            f"{per_second * stop_s:.3g} steps of integration, above {MAX_STEPS:g}; give less of them"
        )
    return Forces(mass.moments, knots_s, accel_N, torque_P, drag_hz, friction)


def is_free(motion: config.Motion) -> bool:
    """Whether no force or torque acts on the target."""
    return not (motion.pushes or motion.accel_psd or motion.torque_psd or motion.energy_loss)


def push_interval_s(push: config.WrenchPulse) -> tuple[float, float]:
    """Start of a push and its end, which is exclusive [s]."""
    return push.start_s, push.start_s + push.duration_s


def known_wrench(motion: config.Motion, timestamps_ns: Ints) -> tuple[Ints, Array, Array] | None:
    """Times (n,) [ns], forces (n, 3) in N [N], torques (n, 3) in P [N m]; None without any.

    ``timestamps_ns`` are those of the frames and of the truth beyond them. The rows go from the
    first to the last of them at 20 Hz or more, with two rows 1 ns apart where the wrench jumps.
    """
    if not motion.pushes or not motion.pushes_known:
        return None
    last_ns = int(timestamps_ns[-1] - timestamps_ns[0])
    spans_ns = [tuple(round(edge * 1e9) for edge in push_interval_s(push)) for push in motion.pushes]
    even_ns = np.linspace(0, last_ns, int(np.ceil(last_ns * 1e-9 / MAX_ROW_S)) + 1).round().astype(np.int64)
    edges_ns = [edge for start, end in spans_ns for edge in (start - 1, start, end - 1, end)]
    rows_ns = np.unique(np.concatenate([even_ns, edges_ns]))
    rows_ns = rows_ns[(rows_ns >= 0) & (rows_ns <= last_ns)]
    force_N, torque_P = np.zeros((len(rows_ns), 3)), np.zeros((len(rows_ns), 3))
    for push, (start_ns, end_ns) in zip(motion.pushes, spans_ns, strict=True):
        on = ((start_ns <= rows_ns) & (rows_ns < end_ns)).astype(np.float64)[:, None]
        force_N += on * push.force_N
        torque_P += on * push.torque_P
    return timestamps_ns[0] + rows_ns, force_N, torque_P


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
        # The torque is -c h, and the energy E0 exp(-2 c t).
        return float(-np.log1p(-motion.energy_loss) / (2.0 * motion.energy_loss_s)), 0.0
    return 0.0, friction_for_loss(motion.energy_loss, motion.energy_loss_s, moments, w_P)


def friction_for_loss(share: float, duration_s: float, moments: Array, w_P: Array) -> float:
    """Coefficient [kg m^2 s] with which ``share`` of the excess energy is gone after ``duration_s``.

    Nothing else acts. Raises InputError for a spin about a principal axis, and for a loss so fast that the
    ball inside would not follow the body.
    """
    # The law holds up to a lag of the ball (friction times body rate over the smallest moment) of 1.
    largest = moments[2] ** 2 / max(float(np.linalg.norm(moments * w_P)), 1e-300)
    still_P = moments * w_P
    energy = float(energy_of_momentum(still_P, moments))
    rest = np.sort(0.5 * still_P**2 / moments)[:-1].sum()
    if min(rest, float(excess_energy(still_P, moments))) <= MIN_EXCESS * energy:
        raise InputError(
            "scene.motion.energy_loss: friction takes no energy from a spin about a principal axis; "
            "tilt spin_rpm or set energy_loss_by to drag"
        )

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
