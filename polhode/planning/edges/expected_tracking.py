"""How accurate a tracker's pose will be at one view, before there is an image.

The metric asks where edges lie; an image decides how well each of them is measured, by its contrast, by what
lies beside it, and by what the model does not know. Here rays look at the body along the profile of each
control point, under several Suns, with shadows; the profiles are blurred as an image is, and measured as the
tracker measures an image (``profiles.py``), with its noise but without any drawn:

- a point weighs as much as its profile tells: little where both sides are equally light, or where other
  stripes, shadows, or parts behind explain the same profile;
- where a profile is not what the model makes of it (a shadow's border beside an edge, parts that overlap
  without a common edge), the point is displaced, and the pose with it: an error that no average over points
  removes, and that differs from Sun to Sun.

The covariance has both: the inverse of the mean information over the Suns, and the mean square of the
displacements of the pose.
"""

from dataclasses import dataclass, replace

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose
from polhode.planning.edges.edge_model import EdgeModel, unit_rows
from polhode.planning.edges.observability_metric import (
    EdgeObservability,
    edge_motion,
    observable_covariance,
)
from polhode.planning.edges.profiles import BLUR_PX, STEP_PX, fitted, places
from polhode.planning.edges.stripes import (
    FLOOR_PX,
    HALF_PX,
    MAX_SHIFT_PX,
    SAMPLED_PX,
    stripes_across,
    times_measured,
)
from polhode.planning.edges.visible_edges import SPACING_PX, ControlPoints, control_points, every_point

WHITE_DN = 100.0
"""Grey level of a surface in full sunlight"""
SUN_ANGLE_DEG = 45.0
"""Between the Sun and the camera, where the Sun is not known"""


@dataclass(frozen=True)
class ExpectedLight:
    """Suns, each with the Earth that goes with it."""

    sun_R: Array
    """(k, 3) unit, towards the Sun"""
    earth_R: Array
    """(k, 3) unit, towards the Earth's centre, whose disc fills half the sky"""
    earth: float = 0.2
    """level of a white surface that faces the Earth, in the shadow of the Sun"""


def around_camera(count: int = 4, angle_deg: float = SUN_ANGLE_DEG) -> ExpectedLight:
    """Suns evenly around the camera, each with the Earth beyond the camera, 100 degrees away."""
    around = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    angle = np.deg2rad(angle_deg)
    sun = np.column_stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), 0.0 * around])
    sun[:, 2] = -np.cos(angle)
    return lit_from(sun)


def lit_from(sun_R: Array, earth: float = 0.2, apart_deg: float = 100.0) -> ExpectedLight:
    """Suns (k, 3), each with an Earth so far from it, on the other side of the direction to the camera."""
    sun = np.asarray(sun_R, dtype=np.float64).reshape(-1, 3)
    sun = sun / np.linalg.norm(sun, axis=1, keepdims=True)
    to_camera = np.array([0.0, 0.0, -1.0])
    across = to_camera - sun * (sun @ to_camera)[:, None]
    length = np.linalg.norm(across, axis=1, keepdims=True)
    # a Sun behind the camera has no side: any will do
    across = np.where(length > 1e-6, across / np.maximum(length, 1e-6), np.cross(sun, [1.0, 0.0, 0.0]))
    apart = np.deg2rad(apart_deg)
    return ExpectedLight(sun, np.cos(apart) * sun + np.sin(apart) * across, earth)


@dataclass(frozen=True)
class ExpectedTracking:
    """What a view will tell of the pose."""

    information: EdgeObservability
    """Its C (6, 6) [m^-2, m^-1 rad^-1, rad^-2]: mean over the Suns, without the displacements"""
    displacement: Array
    """(k, 6) of the pose under each Sun [m, rad], by what the model lacks"""

    @property
    def covariance(self) -> Array:
        """(6, 6) [m^2, m rad, rad^2]; inf on the diagonal where unobservable."""
        d = self.displacement
        return np.asarray(self.information.covariance + d.T @ d / len(d))

    @property
    def sigma(self) -> Array:
        """(6,) [m, rad]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def expected_tracking(
    model: EdgeModel,
    rig: RectifiedRig,
    X_RG: Array,
    light: ExpectedLight | None = None,
    known: EdgeModel | None = None,
    about_G: Array | None = None,
    floor_px: float = FLOOR_PX,
    points: ControlPoints | None = None,
) -> ExpectedTracking:
    """Of a tracker of the model's edges at X_RG (4, 4).

    ``light``: a few Suns around the camera unless given. ``known``: all edges of the body, where the model
    has only some of them. ``about_G`` (3,): reference point of the motions, unless the model's centre.
    ``floor_px``: sigma of an edge's place however clear it is. ``points``: the model's control points there,
    if they are known.
    """
    light = light or around_camera()
    o_G = model.centre_G if about_G is None else about_G
    points = control_points(model, rig, X_RG, SPACING_PX) if points is None else points
    # few of them, evenly over the edges, stand for all
    chosen = points[np.arange(0, len(points), max(-(-len(points) // 300), 1))]
    points = replace(chosen, weight=chosen.weight * (len(points) / max(len(chosen), 1)))
    own = every_point(model, rig, X_RG, SAMPLED_PX)
    every = own if known is None or known is model else every_point(known, rig, X_RG, SAMPLED_PX)
    stripes = stripes_across(points, every, X_RG, HALF_PX + MAX_SHIFT_PX)
    f = edge_motion(points, rig, X_RG, o_G)
    length = points.weight / np.maximum(times_measured(points, own), 1.0)
    C, displacement = np.zeros((len(light.sun_R), 6, 6)), np.zeros((len(light.sun_R), 6))
    for k, grey in enumerate(expected_profiles(model, points, rig, X_RG, light)):
        seen = fitted(places(HALF_PX), grey, stripes).of(stripes, f, length, floor_px)
        if seen.counts.any():
            equations, _, _ = seen.normal_equations(seen.settled_places(), narrow=True)
            C[k] = equations.C
            displacement[k] = observable_covariance(equations.C, model.radius_m) @ equations.pull
    return ExpectedTracking(EdgeObservability(C.mean(axis=0), model.radius_m, len(points)), displacement)


def expected_profiles(
    model: EdgeModel, points: ControlPoints, rig: RectifiedRig, X_RG: Array, light: ExpectedLight
) -> Array:
    """Grey levels (k, m, n) under k Suns along the normals of m points, at ``places(HALF_PX)``, blurred.

    Lambertian, one albedo, black sky, shadows of the Sun.
    """
    place = places(HALF_PX)
    # between the samples of a profile: a ray through the edge itself would see one side or the other
    ray = places(HALF_PX + 3.0)[:-1] + 0.5 * STEP_PX
    kernel = np.exp(-0.5 * ((place[:, None] - ray) / BLUR_PX) ** 2)
    kernel /= kernel.sum(axis=1, keepdims=True)
    uv = (points.uv_px[:, None] + ray[:, None] * points.normal_px[:, None]).reshape(-1, 2)
    X_GR = inverse_pose(X_RG)
    R_GR, eye_G = X_GR[:3, :3], X_GR[:3, 3]
    ray_R = np.column_stack([(uv - [rig.cx_px, rig.cy_px]) / rig.focal_px, np.ones(len(uv))])
    hit, p_G, facing_G, normal_G = model.seen(eye_G, unit_rows(ray_R @ R_GR.T))
    # shadows are looked for a little above the face
    grey, lift_m = np.zeros((len(light.sun_R), len(uv))), 2e-4 * model.radius_m
    for level, sun_R, earth_R in zip(grey, light.sun_R, light.earth_R, strict=True):
        sun_G, earth_G = R_GR @ sun_R, R_GR @ earth_R
        lit = (facing_G @ sun_G > 0.0) & (normal_G @ sun_G > 0.0)
        lit[lit] = ~model.occluder.shades(sun_G, p_G[lit] + lift_m * facing_G[lit], 0.5 * lift_m)
        sunlight = np.where(lit, normal_G @ sun_G, 0.0)
        level[hit] = WHITE_DN * (sunlight + light.earth * 0.5 * (1.0 + normal_G @ earth_G))
    return grey.reshape(len(light.sun_R), len(points), len(ray)) @ kernel.T


@dataclass(frozen=True)
class TrackedCovariance:
    """S = a (1 + c (1 - agreement)) P + b D; unless given, fitted to 1,400 trials of 14 bodies.

    ``python -m lab.edges.expected_errors`` fits them. Too small for bodies of revolution, and for thin
    parts in one plane (docs/observability.md).
    """

    noise: float = 0.68
    """a"""
    displacement: float = 0.15
    """b"""
    disagreement: float = 16.0
    """c"""

    def of(self, stated: Array, displacement: Array, agreement: Array | float) -> Array:
        """S (..., 6, 6) [m^2, m rad, rad^2] of P and D (..., 6, 6) and agreements (...)."""
        size = self.noise * (1.0 + self.disagreement * (1.0 - np.asarray(agreement)))
        return np.asarray(size[..., None, None] * stated + self.displacement * displacement)
