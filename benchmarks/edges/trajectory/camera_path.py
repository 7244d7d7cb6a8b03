"""A camera that watches a tumbling target: what is asked of its way, and what the way gives.

The camera is at the inspector's middle and points at o, the middle of the target's model. N does not turn;
the Sun stands still in it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from benchmarks.edges.trajectory.view_table import camera_attitude
from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import Array, inverse_pose
from polhode.planning.approach.trajectory import ApproachTrajectory
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.information import feature_information, variances
from polhode.planning.prediction import BodyMotion, FinalEstimate, nominal_motion

Objective = Literal["each", "end", "together"]
"""each: mean over the instants of tr (I + C)^-1, every pose on its own; end: that of the last instant;
together: tr (I + sum of C)^-1 along G over the instants, for a motion that is known."""
LOOKED_AT = 4
"""Instants a step at which a way is judged."""


@dataclass(frozen=True)
class CameraPathTask:
    """A way from rest, in N."""

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
    """At each step the range of the straight way, to RANGE_SLACK: then only the direction is chosen"""
    sun_N: Array | None = None
    """(3,) towards the Sun; without it all edges are in even light"""
    sun_exclusion_deg: float = 30.0
    """least angle between the optical axis and the Sun"""
    phase_deg: tuple[float, float] = (15.0, 120.0)
    """between Sun and camera, seen from the target: below, the inspector shades it"""
    up_N: tuple[float, float, float] = (0.0, -1.0, 0.0)
    """the camera's y axis points away from it"""
    objective: Objective = "each"


@dataclass(frozen=True)
class CameraPathMetric:
    """What a way gives, by the true metric: edges that are in sight, clear of others, in the light of each
    instant."""

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
    """(6,) root of the mean variance over the views that tell the degree of freedom [m/px, rad/px]"""
    told: Array
    """(6,) share of the views that tell it"""


def min_range(model: EdgeModel, rig: RectifiedRig, border_px: float = 5.0) -> float:
    """From where on all of the body is in the image of a camera that points at o, however it is turned."""
    radius = float(np.linalg.norm(np.asarray(model.surface.vertices) - model.middle_G, axis=1).max())
    sides = [
        rig.cx_px + 0.5,
        rig.width_px - 0.5 - rig.cx_px,
        rig.cy_px + 0.5,
        rig.height_px - 0.5 - rig.cy_px,
    ]
    return radius / float(np.sin(np.arctan((min(sides) - border_px) / rig.focal_px)))


def target_centres(model: EdgeModel, motion: BodyMotion) -> Array:
    """o in N (T, 3)."""
    return np.asarray(motion.p_NG + motion.R_NG @ model.middle_G)


def sun_in_G(motion: BodyMotion, sun_N: Array) -> Array:
    """(T, 3) unit."""
    return np.asarray(np.einsum("tji,j->ti", motion.R_NG, sun_N / np.linalg.norm(sun_N)))


def straight_path(model: EdgeModel, estimate: FinalEstimate, task: CameraPathTask) -> ApproachTrajectory:
    """The straight way to the goal, or to the nearest range: half of the time faster, half of it slower.

    Raises InputError when the thrust does not reach so far.
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
    """The true metric along a way, LOOKED_AT times a step."""
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
    told = np.isfinite(each)
    with np.errstate(invalid="ignore"):
        mean = np.where(told, each, 0.0).sum(axis=0) / told.sum(axis=0)
    sigma = np.where(told.any(axis=0), np.sqrt(mean), np.inf)
    scaled = information.scaled.sum(axis=1)
    if task.objective == "together":
        scaled = information.accumulated(X_RG[:, :3, :3]).scaled.sum(axis=1) / LOOKED_AT
    elif task.objective == "end":
        scaled = scaled[-1:]
    value = float(np.trace(np.linalg.inv(scaled + np.eye(6)), axis1=1, axis2=2).mean())
    return CameraPathMetric(
        path, time, p_N, X_RG, sun_R, total, far, value, np.asarray(sigma), told.mean(axis=0)
    )


def camera_poses(p_N: Array, o_N: Array, motion: BodyMotion, up_N: Array) -> Array:
    """X_RG (T, 4, 4) of cameras at p_N (T, 3) that point at o_N (T, 3)."""
    X_NR = np.tile(np.eye(4), (len(p_N), 1, 1))
    for X, p, o in zip(X_NR, p_N, o_N, strict=True):
        X[:3, :3] = camera_attitude(o - p, up_N).T
        X[:3, 3] = p
    return np.asarray(inverse_pose(X_NR) @ motion.X_NG)
