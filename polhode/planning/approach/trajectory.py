"""An inspector's trajectory around a tumbling target, outside its keep-out volume at every instant.

The inspector is a sphere whose acceleration, in N, is constant over each step. At each instant a plane
separates it from the convex hull of the grown body; the plane's normal is an unknown of the program, so the
constraint is smooth and exact for the hull.
"""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import trimesh

from polhode.geometry.lie import Array
from polhode.planning.keep_out.volumes import InstantKeepOut

HULL_POINTS = 100
ROUNDS = 4
SEPARATIONS_PER_STEP = 2
"""Instants inside each step at which the separation is required."""


@dataclass(frozen=True)
class ApproachTask:
    """A transfer from rest to rest."""

    start_N: Array
    goal_N: Array
    via_N: Array
    """(3,) point near which to pass"""
    duration_s: float
    steps: int
    radius_m: float
    """of the inspector"""
    clearance_m: float
    """between its surface and the keep-out volume"""
    max_accel_m_s2: float


@dataclass(frozen=True)
class ApproachTrajectory:
    """The plan at the ends of the steps."""

    time_s: Array
    """(K + 1,)"""
    p_N: Array
    v_N: Array
    accel_N: Array
    """(K, 3)"""
    delta_v_m_s: float

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Position, velocity, acceleration (n, 3) at times within the plan."""
        k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.accel_N) - 1)
        dt = (time_s - self.time_s[k])[:, None]
        a = self.accel_N[k]
        return self.p_N[k] + dt * self.v_N[k] + 0.5 * dt**2 * a, self.v_N[k] + dt * a, a


def plan_trajectory(keep_out: InstantKeepOut, task: ApproachTask) -> ApproachTrajectory:
    """Minimize the squared acceleration, with the clearance at every instant; ValueError if infeasible."""
    tightened = task
    for _ in range(ROUNDS):
        trajectory = _solve(keep_out, tightened)
        short = task.radius_m + task.clearance_m - min_distance(keep_out, trajectory)
        if short <= 0.0:
            return trajectory
        # closer between the instants of the program than at them
        tightened = replace(tightened, clearance_m=tightened.clearance_m + 1.2 * short + 1e-4)
    raise ValueError("no trajectory was found that keeps the clearance between the instants of the program")


def min_distance(keep_out: InstantKeepOut, trajectory: ApproachTrajectory) -> float:
    """Smallest distance [m] of the inspector's centre from the volume, over the instants of its motion."""
    p, _, _ = trajectory.at(keep_out.motion.time_s)
    return min(float(keep_out.signed_distance(k, p[k : k + 1])[0]) for k in range(len(p)))


def _solve(keep_out: InstantKeepOut, task: ApproachTask) -> ApproachTrajectory:
    K, dt = task.steps, task.duration_s / task.steps
    farthest = 0.25 * task.max_accel_m_s2 * task.duration_s**2
    if np.linalg.norm(task.goal_N - task.start_N) > farthest:
        raise ValueError(
            f"no trajectory was found: from rest to rest the thrust reaches {farthest:.3g} m in this time"
        )
    hull, short_m = hull_points(keep_out.body.points_G, HULL_POINTS)
    margin = keep_out.margin_m() + short_m + task.radius_m + task.clearance_m
    flight = point_mass(K, dt, task.start_N, task.max_accel_m_s2)
    program, a, p, v = flight.program, flight.a, flight.p, flight.v
    guess = _initial_path(task, K + 1)
    program.set_initial(p, guess.T)
    program.subject_to(p[:, K] == task.goal_N)
    program.subject_to(v[:, K] == 0)
    keep_clear(flight, keep_out, hull, margin, guess)
    program.minimize(ca.sumsqr(a) / task.max_accel_m_s2**2)
    # without the empty name, IPOPT reads ipopt.opt of the current folder, which may be another person's
    options: dict[str, Any] = {"option_file_name": "", "print_level": 0, "sb": "yes", "max_iter": 500}
    program.solver("ipopt", {"print_time": False}, options)
    try:
        found = program.solve()
    except RuntimeError as error:
        raise ValueError(f"no trajectory was found: {str(error).splitlines()[-1].strip()}") from None
    return flight.trajectory(found)


@dataclass(frozen=True)
class PointMass:
    """An optimization program with the motion of an inspector, its acceleration constant over each step."""

    program: ca.Opti
    a: ca.MX
    """(3, K)"""
    p: ca.MX
    """(3, K + 1)"""
    v: ca.MX
    """(3, K + 1)"""
    dt_s: float

    def trajectory(self, found: ca.OptiSol) -> ApproachTrajectory:
        """The plan of a solution."""
        dt = self.dt_s
        accel = np.asarray(found.value(self.a), dtype=np.float64).reshape(3, -1).T
        return ApproachTrajectory(
            np.asarray(dt * np.arange(len(accel) + 1), dtype=np.float64),
            np.asarray(found.value(self.p), dtype=np.float64).T,
            np.asarray(found.value(self.v), dtype=np.float64).T,
            accel,
            float(dt * np.linalg.norm(accel, axis=1).sum()),
        )


def point_mass(steps: int, dt_s: float, start_N: Array, max_accel_m_s2: float) -> PointMass:
    """The program from rest at start_N (3,), with bounded thrust."""
    program = ca.Opti()
    a, p, v = program.variable(3, steps), program.variable(3, steps + 1), program.variable(3, steps + 1)
    program.subject_to(p[:, 0] == start_N)
    program.subject_to(v[:, 0] == 0)
    for k in range(steps):
        program.subject_to(p[:, k + 1] == p[:, k] + dt_s * v[:, k] + 0.5 * dt_s**2 * a[:, k])
        program.subject_to(v[:, k + 1] == v[:, k] + dt_s * a[:, k])
        program.subject_to(ca.sumsqr(a[:, k]) <= max_accel_m_s2**2)
    return PointMass(program, a, p, v, dt_s)


def keep_clear(
    flight: PointMass, keep_out: InstantKeepOut, hull: Array, margin_m: Array, guess: Array
) -> None:
    """Require a separating plane between the inspector and the hull (m, 3) in G at instants inside each step.

    margin_m (T,) at the instants of the volume's motion; guess (K + 1, 3) of the inspector's positions.
    """
    program, dt, motion = flight.program, flight.dt_s, keep_out.motion
    K = flight.a.shape[1]
    u = program.variable(3, K * SEPARATIONS_PER_STEP)
    for k in range(K):
        for h in range(SEPARATIONS_PER_STEP):
            share = (h + 0.5) / SEPARATIONS_PER_STEP
            n = int(np.argmin(np.abs(motion.time_s - (k + share) * dt)))
            position = flight.p[:, k] + share * dt * flight.v[:, k] + 0.5 * (share * dt) ** 2 * flight.a[:, k]
            corners = hull @ motion.R_NG[n].T + motion.p_NG[n]
            normal = u[:, k * SEPARATIONS_PER_STEP + h]
            program.subject_to(ca.sumsqr(normal) <= 1)
            # the plane through the corner that is farthest along the normal
            gap = ca.dot(normal, position) - ca.mtimes(ca.DM(corners), normal)
            program.subject_to(gap >= float(margin_m[n]))
            away = (1 - share) * guess[k] + share * guess[k + 1] - motion.com_N[n]
            program.set_initial(normal, away / np.linalg.norm(away))


def hull_points(points: Array, count: int) -> tuple[Array, float]:
    """Points (m, 3) spread over the hull, and how far the hull protrudes from theirs [m]."""
    corners = np.asarray(trimesh.convex.convex_hull(points).vertices)
    chosen = [int(np.argmax(np.linalg.norm(corners - corners.mean(axis=0), axis=1)))]
    away = np.linalg.norm(corners - corners[chosen[0]], axis=1)
    while len(chosen) < min(count, len(corners)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(corners - corners[chosen[-1]], axis=1))
    few = corners[chosen]
    # the support function is largest at a corner of the hull: distance of each corner from the smaller hull
    planes = trimesh.convex.convex_hull(few)
    beyond = np.einsum(
        "fi,nfi->nf", planes.face_normals, corners[:, None] - planes.triangles_center[None]
    ).max(axis=1)
    return few, float(max(beyond.max(), 0.0))


def _initial_path(task: ApproachTask, count: int) -> Array:
    """A first guess (count, 3): the parabola through start, via and goal."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    s = s * s * (3.0 - 2.0 * s)
    middle = task.via_N - 0.5 * (task.start_N + task.goal_N)
    return np.asarray((1 - s) * task.start_N + s * task.goal_N + 4.0 * s * (1 - s) * middle)
