"""The camera trajectory from which the pose of a tumbling target is best observable, by IPOPT.

    min   mean_k exp(L_k(R_GN (p_k - o_N,k))) + EFFORT mean |a_k|^2 / most^2       L_k = log tr (I + C)^-1
    s.t.  p, v from a, constant over each step; p_0, v_0 = 0 given; p_K and v_K = 0 with a goal
          |a_k| <= most
          low <= |p_k - o_k| <= high                    low: all of the body in the image
          cos of the phase and of the angle to the Sun within their limits
          a plane between inspector and keep-out hull, SEPARATIONS_PER_STEP times a step (`planning.approach`)

L is a smooth table of the metric around the target (`view_table.py`). A minimum of such a program is a local
one, so it is solved from several guesses on all sides, and each result is evaluated by the true metric: the
best that keeps all limits between the instants, too, is returned, with the straight path for comparison.

The camera is at the inspector's centre and points at o, the centre of the target's model. N does not rotate;
the Sun is fixed in it.
"""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.edges.view_table import SUBDIVISIONS, ViewTable, camera_attitude, view_table
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import Array, exp_so3, inverse_pose
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
from polhode.planning.edges.information import feature_information, variances
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
LOOKED_AT = 4
"""Instants per step at which a path is evaluated."""


@dataclass(frozen=True)
class CameraPathTask:
    """A path from rest, in N."""

    start_N: Array
    duration_s: float
    steps: int
    max_accel_m_s2: float
    range_m: tuple[float, float]
    """of the camera from o; the nearer one at least `min_range`"""
    radius_m: float
    """of the inspector"""
    clearance_m: float
    """between its surface and the keep-out volume"""
    goal_N: Array | None = None
    """(3,) end, at rest; without it anywhere within the ranges, at any speed"""
    fixed_range: bool = False
    """At each step the range of the straight path, to RANGE_SLACK: only the direction is chosen"""
    sun_N: Array | None = None
    """(3,) towards the Sun; without it all edges are in even light"""
    sun_exclusion_deg: float = 30.0
    """least angle between the optical axis and the Sun"""
    phase_deg: tuple[float, float] = (15.0, 120.0)
    """between Sun and camera, seen from the target: below, the inspector shades it"""
    up_N: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """the camera's y axis points away from it"""


@dataclass(frozen=True)
class CameraPathMetric:
    """The true metric along a path: visible edges, separate from others, in the light of each instant."""

    path: ApproachTrajectory
    time_s: Array
    """(F,)"""
    p_N: Array
    """(F, 3) of the camera"""
    X_RG: Array
    """(F, 4, 4)"""
    sun_R: Array | None
    """(F, 3)"""
    C: Array
    """(F, 6, 6) along R's axes"""
    range_m: Array
    """(F,)"""
    value: float
    """of the objective"""
    sigma: Array
    """(6,) root of the mean variance over the views that determine the degree of freedom [m/px, rad/px]"""
    determined: Array
    """(6,) share of the views that determine it"""


def min_range(model: EdgeModel, rig: RectifiedRig, border_px: float = 5.0) -> float:
    """Range from which all of the body is in the image of a camera that points at o, in any orientation."""
    radius = float(np.linalg.norm(np.asarray(model.surface.vertices) - model.centre_G, axis=1).max())
    sides = [
        rig.cx_px + 0.5,
        rig.width_px - 0.5 - rig.cx_px,
        rig.cy_px + 0.5,
        rig.height_px - 0.5 - rig.cy_px,
    ]
    return radius / float(np.sin(np.arctan((min(sides) - border_px) / rig.focal_px)))


def target_centres(model: EdgeModel, motion: BodyMotion) -> Array:
    """o in N (T, 3)."""
    return np.asarray(motion.p_NG + motion.R_NG @ model.centre_G)


def sun_in_G(motion: BodyMotion, sun_N: Array) -> Array:
    """(T, 3) unit."""
    return np.asarray(np.einsum("tji,j->ti", motion.R_NG, sun_N / np.linalg.norm(sun_N)))


def straight_path(model: EdgeModel, estimate: FinalEstimate, task: CameraPathTask) -> ApproachTrajectory:
    """The straight path to the goal, or to the nearest range: accelerating, then braking.

    Raises InputError when the thrust is too small for the distance.
    """
    K, dt = task.steps, task.duration_s / task.steps
    goal = task.goal_N
    if goal is None:
        end = target_centres(model, nominal_motion(estimate, np.array([0.0, task.duration_s])))[1]
        away = task.start_N - end
        goal = end + task.range_m[0] * away / np.linalg.norm(away)
    # ones, then minus ones; a middle step of an odd number rests
    push = np.sign(0.5 * (K - 1) - np.arange(K))
    reach = dt**2 * float((push * (K - 0.5 - np.arange(K))).sum())
    accel = push[:, None] * (goal - task.start_N) / reach
    if np.linalg.norm(accel[0]) > task.max_accel_m_s2:
        most = task.max_accel_m_s2 * reach
        raise InputError(
            f"the goal is {np.linalg.norm(goal - task.start_N):.3g} m away; from rest to rest the thrust "
            f"reaches {most:.3g} m in {task.duration_s:g} s"
        )
    v = np.vstack([np.zeros(3), np.cumsum(dt * accel, axis=0)])
    p = task.start_N + np.vstack([np.zeros(3), np.cumsum(dt * v[:-1] + 0.5 * dt**2 * accel, axis=0)])
    time = np.linspace(0.0, task.duration_s, K + 1)
    return ApproachTrajectory(time, p, v, accel, float(dt * np.linalg.norm(accel, axis=1).sum()))


def path_metric(
    model: EdgeModel,
    rig: RectifiedRig,
    estimate: FinalEstimate,
    task: CameraPathTask,
    path: ApproachTrajectory,
) -> CameraPathMetric:
    """The true metric along a path, LOOKED_AT times per step."""
    time = np.linspace(0.0, task.duration_s, LOOKED_AT * task.steps + 1)
    motion = nominal_motion(estimate, time)
    p_N = path.at(time)[0]
    o_N = target_centres(model, motion)
    X_RG = camera_poses(p_N, o_N, motion, np.asarray(task.up_N))
    sun_G = sun_R = None
    far = np.linalg.norm(p_N - o_N, axis=1)
    if task.sun_N is not None:
        sun_G = sun_in_G(motion, task.sun_N)
        sun_R = np.einsum("tij,tj->ti", X_RG[:, :3, :3], sun_G)
    information = feature_information(model, rig, X_RG, sun_G, clear=True)
    total = information.total
    each = variances(total, model.radius_m)
    determined = np.isfinite(each)
    with np.errstate(invalid="ignore"):
        mean = np.where(determined, each, 0.0).sum(axis=0) / determined.sum(axis=0)
    sigma = np.where(determined.any(axis=0), np.sqrt(mean), np.inf)
    value = float(trace_of_inverse(information.scaled.sum(axis=1)).mean())
    return CameraPathMetric(
        path, time, p_N, X_RG, sun_R, total, far, value, np.asarray(sigma), determined.mean(axis=0)
    )


def camera_poses(p_N: Array, o_N: Array, motion: BodyMotion, up_N: Array) -> Array:
    """X_RG (T, 4, 4) of cameras at p_N (T, 3) that point at o_N (T, 3)."""
    X_NR = np.tile(np.eye(4), (len(p_N), 1, 1))
    for X, p, o in zip(X_NR, p_N, o_N, strict=True):
        X[:3, :3] = camera_attitude(o - p, up_N).T
        X[:3, 3] = p
    return np.asarray(inverse_pose(X_NR) @ motion.X_NG)


def trace_of_inverse(C: Array) -> Array:
    """tr (I + C)^-1 (...,) of information C (..., 6, 6) with translations in radii."""
    return np.asarray(np.trace(np.linalg.inv(C + np.eye(6)), axis1=-2, axis2=-1))


@dataclass(frozen=True)
class BestTrajectory:
    """The best path found, and the straight one; both by the true metric."""

    best: CameraPathMetric
    straight_path: CameraPathMetric
    expected: float
    """the objective of the best path by the table"""
    starts: int
    """guesses that led to a path within the limits"""
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
    """The path of the least objective from several guesses; the same input gives the same path.

    Guesses are the straight path and those that turn around the target by turns_deg, to SIDES sides each;
    ``subdivisions`` of the table's directions. A table of the same task saves making it.

    Raises InputError where the start or the limits contradict each other, or no path keeps them.
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
    """No path from one guess."""


@dataclass(frozen=True)
class _Margins:
    """Added to the limits, to allow for violations between the instants of the program."""

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
    """Positions (K + 1, 3): the straight path, and turned around the target to all sides, more and more."""
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
    """A path from a guess that keeps the limits between the instants, too, and its objective."""
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
    raise _NoPath("limits are violated between the instants of the program")


def _more(short: float) -> float:
    return 1.2 * short + CLOSE_TO_LIMITS if short > CLOSE_TO_LIMITS else 0.0


def _shortfall(
    model: EdgeModel,
    keep_out: InstantKeepOut,
    nodes: BodyMotion,
    task: CameraPathTask,
    path: ApproachTrajectory,
) -> _Margins:
    """By how much a path violates its limits between the instants."""
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
    """The program of the module's docstring."""
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
    options["option_file_name"] = ""
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
    straight_m = np.linalg.norm(places_N - o_N, axis=1)
    low_rad, high_rad = _phases(task)
    # no limits at a given goal
    last = 2 * K if task.goal_N is None else 2 * K - 1
    for n in range(1, last + 1):
        k = n // 2
        place = flight.p[:, k]
        if n % 2:
            place = place + 0.5 * dt * flight.v[:, k] + 0.125 * dt**2 * flight.a[:, k]
        away = place - o_N[n]
        low, high = task.range_m[0] + margins.range_m, task.range_m[1] - margins.range_m
        if task.fixed_range:
            low = max(low, (1.0 - RANGE_SLACK) * float(straight_m[n]))
            high = max(min(high, (1.0 + RANGE_SLACK) * float(straight_m[n])), (1.0 + RANGE_SLACK) * low)
        program.subject_to(program.bounded(low**2, ca.sumsqr(away), high**2))
        if task.sun_N is not None:
            towards_sun = ca.dot(away, task.sun_N / np.linalg.norm(task.sun_N))
            far = ca.norm_2(away)
            program.subject_to(towards_sun <= np.cos(low_rad + margins.angle_rad) * far)
            program.subject_to(towards_sun >= np.cos(high_rad - margins.angle_rad) * far)


def _metric(p: ca.MX, o_N: Array, nodes: BodyMotion, table: ViewTable, task: CameraPathTask) -> ca.MX:
    """The objective by the table; nodes at 2 K + 1 instants."""
    value, total = table.log_trace_of(), ca.MX(0.0)
    for k in range(task.steps + 1):
        p_G = ca.mtimes(ca.DM(nodes.R_NG[2 * k].T), p[:, k] - o_N[k])
        total = total + ca.exp(value(p_G, ca.DM(table.log_trace[table.at(k)])))
    return total / (task.steps + 1)
