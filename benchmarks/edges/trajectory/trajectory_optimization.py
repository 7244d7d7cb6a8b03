"""Where to fly so that the pose can be told best: the metric along the way, minimised by IPOPT.

    min   mean_k exp(L_k(R_GN (p_k - o_N,k)))         objective "each": L_k = log tr (I + C)^-1 at instant k
          exp(L_K)                                                "end"
          tr (I + sum_k C_k)^-1                                   "together", along G
          + EFFORT mean |a_k|^2 / most^2
    s.t.  p, v from a, constant over each step; p_0, v_0 = 0 given; p_K and v_K = 0 with a goal
          |a_k| <= most
          low <= |p_k - o_k| <= high                    low: all of the body in the image
          cos of the phase and of the angle to the Sun within their limits
          a plane between inspector and keep-out hull, HOLD_CLEAR times a step (`planning.approach`)

L and C are smooth tables of the metric around the target (`view_table.py`). A minimum of such a program is a
local one, so it is solved from several guesses on all sides, and each answer is judged by the true metric:
the best that keeps all limits between the instants, too, is returned, and the straight way beside it.
"""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.edges.trajectory.camera_path import (
    CameraPathMetric,
    CameraPathTask,
    min_range,
    path_metric,
    straight_path,
    sun_in_G,
    target_centres,
)
from benchmarks.edges.trajectory.view_table import SUBDIVISIONS, ViewTable, trace_of_inverse, view_table
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import Array, exp_so3
from polhode.planning.approach.trajectory import (
    HULL_POINTS,
    ApproachTrajectory,
    PointMass,
    hull_points,
    keep_clear,
    min_distance,
    point_mass,
)
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.keep_out.volumes import InstantKeepOut
from polhode.planning.prediction import BodyMotion, FinalEstimate, nominal_motion

EFFORT = 1e-3
RANGE_SLACK = 0.01
TURNS_DEG = (50.0, 110.0)
"""How far around the target the guesses go."""
SIDES = 4
ROUNDS = 3
CLOSE_TO_LIMITS = 1e-4
MAX_ITERATIONS = 300


@dataclass(frozen=True)
class BestTrajectory:
    """The best way that was found, and the straight one; both by the true metric."""

    best: CameraPathMetric
    straight_path: CameraPathMetric
    expected: float
    """the objective of the best way by the tables"""
    starts: int
    """guesses from which a way was found that keeps the limits"""
    tried: int
    gap_m: float
    """least distance of the inspector's middle from the keep-out volume"""


def best_trajectory(
    model: EdgeModel,
    rig: RectifiedRig,
    estimate: FinalEstimate,
    keep_out: InstantKeepOut,
    task: CameraPathTask,
    turns_deg: tuple[float, ...] = TURNS_DEG,
    subdivisions: int = SUBDIVISIONS,
    table: ViewTable | None = None,
) -> BestTrajectory:
    """The way of the least objective from several guesses; the same input gives the same way.

    Guesses are the straight way and those that turn around the target by turns_deg, to SIDES sides each;
    ``subdivisions`` of the table's directions. A table of the same task saves making it.

    Raises InputError where the start or the limits contradict each other, or no way keeps them.
    """
    nodes = nominal_motion(estimate, np.linspace(0.0, task.duration_s, 2 * task.steps + 1))
    _check(model, rig, keep_out, nodes, task)
    baseline = straight_path(model, estimate, task)
    table = table or table_for(model, rig, estimate, task, subdivisions)
    guesses = _guesses(baseline.p_N, target_centres(model, nodes)[::2], turns_deg)
    found: list[tuple[float, int, CameraPathMetric, float, float]] = []
    reasons: list[str] = []
    for number, guess in enumerate(guesses):
        try:
            path, expected = _path_within_limits(model, keep_out, nodes, table, task, baseline, guess)
        except _NoPath as reason:
            reasons.append(str(reason))
            continue
        true = path_metric(model, rig, estimate, task, path)
        found.append((true.value, number, true, expected, min_distance(keep_out, path)))
    if not found:
        raise InputError(
            f"no trajectory was found from any of {len(guesses)} guesses that keeps clearance, range, Sun "
            f"and thrust ({max(set(reasons), key=reasons.count)}); widen the limits or the time"
        )
    _, _, best, expected, gap = min(found, key=lambda one: one[:2])
    reference = path_metric(model, rig, estimate, task, baseline)
    return BestTrajectory(best, reference, expected, len(found), len(guesses), gap)


def table_for(
    model: EdgeModel,
    rig: RectifiedRig,
    estimate: FinalEstimate,
    task: CameraPathTask,
    subdivisions: int = SUBDIVISIONS,
) -> ViewTable:
    """The metric around the target, at the instants of the steps if there is a Sun."""
    if task.sun_N is None:
        return view_table(model, rig, task.range_m, None, subdivisions)
    nodes = nominal_motion(estimate, np.linspace(0.0, task.duration_s, task.steps + 1))
    return view_table(model, rig, task.range_m, sun_in_G(nodes, task.sun_N), subdivisions)


class _NoPath(Exception):
    """No way from one guess."""


@dataclass(frozen=True)
class _Margins:
    """What is asked beyond the limits, for what happens between the instants of the program."""

    clearance_m: float = 0.0
    range_m: float = 0.0
    angle_rad: float = 0.0


def _check(
    model: EdgeModel, rig: RectifiedRig, keep_out: InstantKeepOut, nodes: BodyMotion, task: CameraPathTask
) -> None:
    """Raises InputError for what cannot be kept from the beginning."""
    low, high = task.range_m
    least = min_range(model, rig)
    if low < least:
        raise InputError(
            f"from {low:.3g} m the body does not fit into the image; the nearest range is {least:.3g} m"
        )
    ends = [("start", task.start_N, 0)]
    if task.goal_N is not None:
        ends.append(("goal", task.goal_N, -1))
    for name, place_N, k in ends:
        away = place_N - target_centres(model, nodes)[k]
        far = float(np.linalg.norm(away))
        if not low <= far <= high:
            raise InputError(f"the {name} is {far:.3g} m from the target, outside of {low:g} to {high:g} m")
        instant = 0 if k == 0 else len(keep_out.motion.time_s) - 1
        gap = float(keep_out.signed_distance(instant, place_N[None])[0])
        if gap < task.radius_m + task.clearance_m:
            raise InputError(f"the {name} is inside the keep-out volume or too close to it")
        if task.sun_N is not None:
            low_rad, high_rad = _phases(task)
            if low_rad >= high_rad:
                raise InputError(
                    f"no phase angle is left between {np.degrees(low_rad):.0f} and "
                    f"{np.degrees(high_rad):.0f} degrees"
                )
            phase = float(np.arccos(away @ task.sun_N / far / np.linalg.norm(task.sun_N)))
            if not low_rad <= phase <= high_rad:
                raise InputError(
                    f"the {name} has a phase angle of {np.degrees(phase):.0f} degrees, outside of "
                    f"{np.degrees(low_rad):.0f} to {np.degrees(high_rad):.0f}"
                )


def _phases(task: CameraPathTask) -> tuple[float, float]:
    """Least and largest phase angle; a camera that points at the target looks pi - phase off the Sun."""
    low, high = np.radians(task.phase_deg)
    return float(low), float(min(high, np.pi - np.radians(task.sun_exclusion_deg)))


def _guesses(p_N: Array, o_N: Array, turns_deg: tuple[float, ...]) -> list[Array]:
    """Places (K + 1, 3): the straight ones, and turned around the target to all sides, more and more."""
    away = p_N - o_N
    first = away[0] / np.linalg.norm(away[0])
    aside = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    aside /= np.linalg.norm(aside)
    other = np.cross(first, aside)
    share = np.linspace(0.0, 1.0, len(p_N))
    smooth = share * share * (3.0 - 2.0 * share)
    out = [p_N]
    for turn in np.radians(np.asarray(turns_deg, dtype=np.float64)):
        for n in range(SIDES):
            angle = 2.0 * np.pi * n / SIDES
            axis = np.cos(angle) * aside + np.sin(angle) * other
            R = exp_so3(turn * smooth[:, None] * axis)
            out.append(o_N + np.einsum("kij,kj->ki", R, away))
    return out


def _path_within_limits(
    model: EdgeModel,
    keep_out: InstantKeepOut,
    nodes: BodyMotion,
    table: ViewTable,
    task: CameraPathTask,
    baseline: ApproachTrajectory,
    guess: Array,
) -> tuple[ApproachTrajectory, float]:
    """A way from a guess that keeps the limits between the instants, too, and its objective."""
    margins = _Margins()
    for _ in range(ROUNDS):
        path, expected = _solve(model, keep_out, nodes, table, task, baseline, guess, margins)
        short = _shortfall(model, keep_out, nodes, task, path)
        if max(short.clearance_m, short.range_m, short.angle_rad) <= CLOSE_TO_LIMITS:
            return path, expected
        margins = replace(
            margins,
            clearance_m=margins.clearance_m + _more(short.clearance_m),
            range_m=margins.range_m + _more(short.range_m),
            angle_rad=margins.angle_rad + _more(short.angle_rad),
        )
        guess = path.p_N
    raise _NoPath("limits are broken between the instants of the program")


def _more(short: float) -> float:
    return 1.2 * short + CLOSE_TO_LIMITS if short > CLOSE_TO_LIMITS else 0.0


def _shortfall(
    model: EdgeModel,
    keep_out: InstantKeepOut,
    nodes: BodyMotion,
    task: CameraPathTask,
    path: ApproachTrajectory,
) -> _Margins:
    """By how much a way breaks its limits between the instants."""
    time = keep_out.motion.time_s
    inside = time <= task.duration_s
    p_N, o_N = path.at(time[inside])[0], target_centres(model, keep_out.motion)[inside]
    away = p_N - o_N
    far = np.linalg.norm(away, axis=1)
    low, high = task.range_m
    angle = 0.0
    if task.sun_N is not None:
        phase = np.arccos(np.clip(away @ task.sun_N / far / np.linalg.norm(task.sun_N), -1.0, 1.0))
        low_rad, high_rad = _phases(task)
        angle = max(low_rad - float(phase.min()), float(phase.max()) - high_rad)
    gap = task.radius_m + task.clearance_m - min_distance(keep_out, path)
    return _Margins(gap, max(low - float(far.min()), float(far.max()) - high), angle)


def _solve(
    model: EdgeModel,
    keep_out: InstantKeepOut,
    nodes: BodyMotion,
    table: ViewTable,
    task: CameraPathTask,
    baseline: ApproachTrajectory,
    guess: Array,
    margins: _Margins,
) -> tuple[ApproachTrajectory, float]:
    """The program of the module's head."""
    K, dt = task.steps, task.duration_s / task.steps
    o_N = target_centres(model, nodes)
    flight = point_mass(K, dt, task.start_N, task.max_accel_m_s2)
    program, a, p, v = flight.program, flight.a, flight.p, flight.v
    program.set_initial(p, guess.T)
    velocity = np.gradient(guess, dt, axis=0)
    program.set_initial(v, velocity.T)
    if task.goal_N is not None:
        program.subject_to(p[:, K] == task.goal_N)
        program.subject_to(v[:, K] == 0)
    hull, short_m = hull_points(keep_out.body.points_G, HULL_POINTS)
    grown = keep_out.margin_m() + short_m + task.radius_m + task.clearance_m + margins.clearance_m
    keep_clear(flight, keep_out, hull, grown, guess)
    _within_limits(flight, o_N, task, baseline, margins)
    metric = _metric(p, o_N[::2], nodes, table, task)
    # near 1 whatever the body and the camera
    size = float(ca.Function("size", [p], [metric])(guess.T))
    program.minimize(metric / size + EFFORT * ca.sumsqr(a) / (K * task.max_accel_m_s2**2))
    options: dict[str, Any] = {"print_level": 0, "sb": "yes", "max_iter": MAX_ITERATIONS, "tol": 1e-6}
    if task.objective == "together":
        # second derivatives of the sum take longer than the steps that they save
        options["hessian_approximation"] = "limited-memory"
    program.solver("ipopt", {"print_time": False}, options)
    try:
        found = program.solve()
    except RuntimeError as error:
        raise _NoPath(str(error).splitlines()[-1].strip()) from None
    return flight.trajectory(found), float(found.value(metric))


def _within_limits(
    flight: PointMass, o_N: Array, task: CameraPathTask, baseline: ApproachTrajectory, margins: _Margins
) -> None:
    """Range and Sun at the ends and the middles of the steps; o_N (2 K + 1, 3)."""
    program, K, dt = flight.program, task.steps, flight.dt_s
    places_N, _, _ = baseline.at(np.linspace(0.0, K * dt, 2 * K + 1))
    held = np.linalg.norm(places_N - o_N, axis=1)
    low_rad, high_rad = _phases(task)
    # the given goal is what it is
    last = 2 * K if task.goal_N is None else 2 * K - 1
    for n in range(1, last + 1):
        k = n // 2
        place = flight.p[:, k]
        if n % 2:
            place = place + 0.5 * dt * flight.v[:, k] + 0.125 * dt**2 * flight.a[:, k]
        away = place - o_N[n]
        low, high = task.range_m[0] + margins.range_m, task.range_m[1] - margins.range_m
        if task.fixed_range:
            low = max(low, (1.0 - RANGE_SLACK) * float(held[n]))
            high = max(min(high, (1.0 + RANGE_SLACK) * float(held[n])), (1.0 + RANGE_SLACK) * low)
        program.subject_to(program.bounded(low**2, ca.sumsqr(away), high**2))
        if task.sun_N is not None:
            towards_sun = ca.dot(away, task.sun_N / np.linalg.norm(task.sun_N))
            far = ca.norm_2(away)
            program.subject_to(towards_sun <= np.cos(low_rad + margins.angle_rad) * far)
            program.subject_to(towards_sun >= np.cos(high_rad - margins.angle_rad) * far)


def _metric(p: ca.MX, o_N: Array, nodes: BodyMotion, table: ViewTable, task: CameraPathTask) -> ca.MX:
    """The objective by the tables; nodes at 2 K + 1 instants."""
    K = task.steps
    p_G = [ca.mtimes(ca.DM(nodes.R_NG[2 * k].T), p[:, k] - o_N[k]) for k in range(K + 1)]
    if task.objective == "together":
        tell, D = table.information_of(), len(table.towards_G) * len(table.range_m)
        rows = [ca.DM(table.information[table.at(k)].reshape(D, 21)) for k in range(K + 1)]
        told: ca.MX = tell(p_G[0], rows[0])
        for k in range(1, K + 1):
            told = told + tell(p_G[k], rows[k])
        trace: ca.MX = trace_of_inverse()(told)
        return trace
    value = table.log_trace_of()
    chosen = [K] if task.objective == "end" else list(range(K + 1))
    total = ca.MX(0.0)
    for k in chosen:
        total = total + ca.exp(value(p_G[k], ca.DM(table.log_trace[table.at(k)])))
    return total / len(chosen)
