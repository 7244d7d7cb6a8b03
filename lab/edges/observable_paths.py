"""The camera path from which the pose of a tumbling target is best observable, by IPOPT.

    min   mean_k exp(L_k(R_GN (p_k - o_N,k))) + EFFORT mean |a_k|^2 / most^2       L_k = log tr (I + C)^-1
    s.t.  p, v from a, constant over each step; p_0, v_0 = 0 given
          |a_k| <= most
          low <= |p_k - o_k| <= high                    low: all of the body in the image
          cos of the phase and of the angle to the Sun within their limits
          a plane between inspector and keep-out hull, SEPARATIONS_PER_STEP times a step (`planning.approach`)

L is a smooth table of the metric around the target (`view_table.py`). A minimum of such a program is a local
one, so it is solved from several guesses on all sides, and each result is evaluated by the true metric: the
best that keeps all limits between the instants, too, is returned.

The camera is at the inspector's centre and points at o, the centre of the target's model. N does not rotate;
the Sun is fixed in it.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from lab.edges.view_table import ViewTable, camera_attitude, trace_of_inverse, view_table
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose
from polhode.planning.approach.trajectory import (
    HULL_POINTS,
    ApproachTrajectory,
    hull_points,
    keep_clear,
    min_distance,
    point_mass,
)
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.information import views_along
from polhode.planning.edges.observability_metric import motion_scale
from polhode.planning.keep_out.volumes import InstantKeepOut
from polhode.planning.prediction import BodyMotion, FinalEstimate, nominal_motion
from polhode.runtime.errors import InputError

EFFORT = 1e-3
TURN_DEG, SIDES = 70.0, 4
"""How far around the target the guesses go, and to how many sides"""
ROUNDS = 3
"""In which limits that are violated between the instants are tightened"""
VIOLATION = 1e-4
"""[m, rad] that counts as none"""
MAX_ITERATIONS = 300
VIEWS_PER_STEP = 4
"""Instants at which a path is evaluated"""
BORDER_PX = 5.0
UP_N = np.array([0.0, -1.0, 0.0])
"""The camera's y axis points away from it"""


@dataclass(frozen=True)
class CameraPathTask:
    """A path from rest, in N, and the target around which it leads."""

    model: EdgeModel
    rig: RectifiedRig
    estimate: FinalEstimate
    keep_out: InstantKeepOut
    sun_N: Array
    """(3,) unit, towards the Sun"""
    start_N: Array
    duration_s: float = 60.0
    steps: int = 12
    max_accel_m_s2: float = 0.01
    max_range_m: float = 4.3
    distance_m: float = 0.25
    """of the inspector's centre from the keep-out volume"""
    phase_deg: tuple[float, float] = (15.0, 120.0)
    """between Sun and camera, seen from the target: below, the inspector shades it; above, a camera that
    points at the target looks within 60 degrees of the Sun"""

    @property
    def min_range_m(self) -> float:
        """From which all of the body is in the image, in any orientation of the camera."""
        radius = float(
            np.linalg.norm(np.asarray(self.model.surface.vertices) - self.model.centre_G, axis=1).max()
        )
        half = 0.5 * min(self.rig.width_px, self.rig.height_px) - BORDER_PX
        return radius / float(np.sin(np.arctan(half / self.rig.focal_px))) + 0.02

    def motion(self, count: int) -> BodyMotion:
        """Predicted at so many even instants."""
        return nominal_motion(self.estimate, np.linspace(0.0, self.duration_s, count))

    def centres(self, motion: BodyMotion) -> Array:
        """o in N (T, 3)."""
        return np.asarray(motion.p_NG + motion.R_NG @ self.model.centre_G)

    def sun_G(self, motion: BodyMotion) -> Array:
        """(T, 3)."""
        return np.asarray(np.einsum("tji,j->ti", motion.R_NG, self.sun_N))


@dataclass(frozen=True)
class EvaluatedPath:
    """A path with its views."""

    path: ApproachTrajectory
    X_RG: Array
    """(F, 4, 4) at even instants"""
    sun_R: Array
    """(F, 3)"""
    value: float
    """of the objective by the true metric"""


def straight_path(task: CameraPathTask) -> ApproachTrajectory:
    """The straight path to the nearest range, from rest to rest: accelerating, then braking.

    Raises InputError when the thrust is too small for the distance.
    """
    K, dt = task.steps, task.duration_s / task.steps
    end = task.centres(task.motion(2))[1]
    away = task.start_N - end
    goal = end + task.min_range_m * away / np.linalg.norm(away)
    # ones, then minus ones; a middle step of an odd number rests
    push = np.sign(0.5 * (K - 1) - np.arange(K))
    accel = push[:, None] * (goal - task.start_N) / (dt**2 * float((push * (K - 0.5 - np.arange(K))).sum()))
    if np.linalg.norm(accel[0]) > task.max_accel_m_s2:
        raise InputError("the thrust is too small for the straight path")
    v = np.vstack([np.zeros(3), np.cumsum(dt * accel, axis=0)])
    p = task.start_N + np.vstack([np.zeros(3), np.cumsum(dt * v[:-1] + 0.5 * dt**2 * accel, axis=0)])
    time = np.linspace(0.0, task.duration_s, K + 1)
    return ApproachTrajectory(time, p, v, accel, float(dt * np.linalg.norm(accel, axis=1).sum()))


def evaluated(task: CameraPathTask, path: ApproachTrajectory) -> EvaluatedPath:
    """The true metric along a path."""
    count = VIEWS_PER_STEP * task.steps + 1
    motion = task.motion(count)
    p_N, o_N = path.at(np.linspace(0.0, task.duration_s, count))[0], task.centres(motion)
    X_NR = np.tile(np.eye(4), (count, 1, 1))
    for X, p, o in zip(X_NR, p_N, o_N, strict=True):
        X[:3, :3], X[:3, 3] = camera_attitude(o - p, UP_N).T, p
    X_RG, sun_G = np.asarray(inverse_pose(X_NR) @ motion.X_NG), task.sun_G(motion)
    views = views_along(task.model, task.rig, X_RG, task.model.centre_G, sun_G=sun_G)
    scale = motion_scale(task.model.radius_m)
    C = np.stack([view.metric.C for view in views]) * np.outer(scale, scale)
    sun_R = np.einsum("tij,tj->ti", X_RG[:, :3, :3], sun_G)
    return EvaluatedPath(path, X_RG, sun_R, float(trace_of_inverse(C).mean()))


def best_path(task: CameraPathTask) -> EvaluatedPath:
    """The path of the least objective from several guesses; the same input gives the same path.

    Guesses are the straight path and those that turn around the target. Raises InputError where none leads to
    a path within the limits.
    """
    nodes = task.motion(2 * task.steps + 1)
    ranges = task.min_range_m, task.max_range_m
    table = view_table(task.model, task.rig, ranges, task.sun_G(task.motion(task.steps + 1)))
    found = []
    for guess in _guesses(straight_path(task).p_N, task.centres(nodes)[::2]):
        try:
            found.append(evaluated(task, _path_within_limits(task, nodes, table, guess)))
        except RuntimeError:
            continue
    if not found:
        raise InputError("no path keeps clearance, range, Sun and thrust")
    return min(found, key=lambda each: each.value)


def _guesses(p_N: Array, o_N: Array) -> list[Array]:
    """Positions (K + 1, 3): the straight path, and turned around the target to all sides, more and more."""
    away = p_N - o_N
    first = away[0] / np.linalg.norm(away[0])
    aside = np.cross(first, np.eye(3)[int(np.argmin(np.abs(first)))])
    aside /= np.linalg.norm(aside)
    share = np.linspace(0.0, 1.0, len(p_N))
    turn = np.deg2rad(TURN_DEG) * share * share * (3.0 - 2.0 * share)
    out = [p_N]
    for angle in 2.0 * np.pi * np.arange(SIDES) / SIDES:
        axis = np.cos(angle) * aside + np.sin(angle) * np.cross(first, aside)
        out.append(o_N + np.einsum("kij,kj->ki", exp_so3(turn[:, None] * axis), away))
    return out


def _path_within_limits(
    task: CameraPathTask, nodes: BodyMotion, table: ViewTable, guess: Array
) -> ApproachTrajectory:
    """A path from a guess that keeps the limits between the instants, too. Raises RuntimeError."""
    margins = np.zeros(3)
    for _ in range(ROUNDS):
        path = _solve(task, nodes, table, guess, margins)
        violation = _violation(task, path)
        if violation.max() <= VIOLATION:
            return path
        margins = margins + np.where(violation > VIOLATION, 1.2 * violation + VIOLATION, 0.0)
        guess = path.p_N
    raise RuntimeError("limits are violated between the instants of the program")


def _violation(task: CameraPathTask, path: ApproachTrajectory) -> Array:
    """By how much a path violates clearance [m], range [m] and phase [rad]."""
    motion = task.keep_out.motion
    inside = motion.time_s <= task.duration_s
    away = path.at(motion.time_s[inside])[0] - task.centres(motion)[inside]
    far = np.linalg.norm(away, axis=1)
    phase = np.arccos(np.clip(away @ task.sun_N / far, -1.0, 1.0))
    low, high = np.deg2rad(task.phase_deg)
    return np.array(
        [
            task.distance_m - min_distance(task.keep_out, path),
            max(task.min_range_m - far.min(), far.max() - task.max_range_m),
            max(low - phase.min(), phase.max() - high),
        ]
    )


def _solve(
    task: CameraPathTask, nodes: BodyMotion, table: ViewTable, guess: Array, margins: Array
) -> ApproachTrajectory:
    """The program of the module's docstring; nodes at 2 K + 1 instants. Raises RuntimeError."""
    K, dt, o_N = task.steps, task.duration_s / task.steps, task.centres(nodes)
    flight = point_mass(K, dt, task.start_N, task.max_accel_m_s2)
    program, a, p, v = flight.program, flight.a, flight.p, flight.v
    program.set_initial(p, guess.T)
    program.set_initial(v, np.gradient(guess, dt, axis=0).T)
    hull, short_m = hull_points(task.keep_out.body.points_G, HULL_POINTS)
    keep_clear(
        flight, task.keep_out, hull, task.keep_out.margin_m() + short_m + task.distance_m + margins[0], guess
    )
    low, high = task.min_range_m + margins[1], task.max_range_m - margins[1]
    nearest, farthest = np.cos(np.deg2rad(task.phase_deg) + np.array([1.0, -1.0]) * margins[2])
    for n in range(1, 2 * K + 1):
        k = n // 2
        place = p[:, k] if n % 2 == 0 else p[:, k] + 0.5 * dt * v[:, k] + 0.125 * dt**2 * a[:, k]
        away = place - o_N[n]
        program.subject_to(program.bounded(low**2, ca.sumsqr(away), high**2))
        towards_sun, far = ca.dot(away, task.sun_N), ca.norm_2(away)
        program.subject_to(towards_sun <= nearest * far)
        program.subject_to(towards_sun >= farthest * far)
    value, metric = table.log_trace_of(), ca.MX(0.0)
    for k in range(K + 1):
        p_G = ca.mtimes(ca.DM(nodes.R_NG[2 * k].T), p[:, k] - o_N[2 * k])
        metric += ca.exp(value(p_G, ca.DM(table.log_trace[k]))) / (K + 1)
    # near 1 whatever the body and the camera
    size = float(ca.Function("size", [p], [metric])(guess.T))
    program.minimize(metric / size + EFFORT * ca.sumsqr(a) / (K * task.max_accel_m_s2**2))
    options: dict[str, Any] = {"print_level": 0, "sb": "yes", "max_iter": MAX_ITERATIONS, "tol": 1e-6}
    program.solver("ipopt", {"print_time": False}, options | {"option_file_name": ""})
    return flight.trajectory(program.solve())
