"""An inspector's trajectory around a tumbling target, outside its keep-out volume at every instant.

The inspector is a sphere whose acceleration, in N, is constant over each step. At each instant a plane
separates it from the convex hull of the grown body; the plane's normal is an unknown of the program, so the
constraint is smooth and exact for the hull.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
import trimesh

from polhode.geometry.lie import Array
from polhode.planning.keep_out.queries import InstantKeepOut


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
    for _ in range(4):
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
    hull, short_m = hull_points(keep_out.body.points_G, 100)
    alone_m = short_m + task.radius_m + task.clearance_m
    bodies = [(each.motion, each.margin_m() + alone_m) for each in keep_out.hypotheses]
    program = ca.Opti()
    a, p, v = program.variable(3, K), program.variable(3, K + 1), program.variable(3, K + 1)
    program.subject_to(p[:, 0] == task.start_N)
    program.subject_to(p[:, K] == task.goal_N)
    program.subject_to(v[:, 0] == 0)
    program.subject_to(v[:, K] == 0)
    # the first guess: the parabola through start, via and goal, from rest to rest
    s = np.linspace(0.0, 1.0, K + 1)[:, None]
    s = s * s * (3.0 - 2.0 * s)
    middle = task.via_N - 0.5 * (task.start_N + task.goal_N)
    guess = (1 - s) * task.start_N + s * task.goal_N + 4.0 * s * (1 - s) * middle
    program.set_initial(p, guess.T)
    for k in range(K):
        program.subject_to(p[:, k + 1] == p[:, k] + dt * v[:, k] + 0.5 * dt**2 * a[:, k])
        program.subject_to(v[:, k + 1] == v[:, k] + dt * a[:, k])
        program.subject_to(ca.sumsqr(a[:, k]) <= task.max_accel_m_s2**2)
        # the separation is required at two instants inside each step
        for share, (motion, margin_m) in product((0.25, 0.75), bodies):
            n = int(np.argmin(np.abs(motion.time_s - (k + share) * dt)))
            position = p[:, k] + share * dt * v[:, k] + 0.5 * (share * dt) ** 2 * a[:, k]
            corners, normal = hull @ motion.R_NG[n].T + motion.p_NG[n], program.variable(3)
            program.subject_to(ca.sumsqr(normal) <= 1)
            # the plane through the corner that is farthest along the normal
            gap = ca.dot(normal, position) - ca.mtimes(ca.DM(corners), normal)
            program.subject_to(gap >= float(margin_m[n]))
            away = (1 - share) * guess[k] + share * guess[k + 1] - motion.com_N[n]
            program.set_initial(normal, away / np.linalg.norm(away))
    program.minimize(ca.sumsqr(a) / task.max_accel_m_s2**2)
    # without the empty name, IPOPT reads ipopt.opt of the current folder, which may be another person's
    options: dict[str, Any] = {"option_file_name": "", "print_level": 0, "sb": "yes", "max_iter": 500}
    program.solver("ipopt", {"print_time": False}, options)
    try:
        found = program.solve()
    except RuntimeError as error:
        raise ValueError(f"no trajectory was found: {str(error).splitlines()[-1].strip()}") from None
    p_N, v_N, accel_N = (np.asarray(found.value(each), dtype=np.float64).T for each in (p, v, a))
    delta_v_m_s = float(dt * np.linalg.norm(accel_N, axis=1).sum())
    return ApproachTrajectory(dt * np.arange(K + 1.0), p_N, v_N, accel_N, delta_v_m_s)


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
