"""A camera and views of a notched block, for the tests of what edges tell."""

import numpy as np
import trimesh

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.information import FeatureInformation, by_feature, views_along

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)


def block() -> EdgeModel:
    """A box with one corner cut off: 15 edges."""
    half = np.array([0.45, 0.3, 0.21])
    corners = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    cut = half - np.diag([0.3, 0.22, 0.2])
    points = np.vstack([corners[~(corners > 0).all(axis=1)], cut])
    return edge_model(trimesh.convex.convex_hull(points))


def poses(count: int, seed: int = 0, range_m: float = 3.0) -> Array:
    """X_RG (count, 4, 4), the body's origin ahead of the camera."""
    rng = np.random.default_rng(seed)
    turns = exp_so3(rng.normal(size=(count, 3)) * 1.5)
    return np.asarray([make_pose(R, [0.05, -0.03, range_m + 0.2 * k]) for k, R in enumerate(turns)])


def information_at(model: EdgeModel, X_RG: Array, sun_G: Array | None = None) -> FeatureInformation:
    """About the model's centre."""
    views = views_along(model, RIG, X_RG, model.centre_G, sun_G=sun_G)
    C = np.stack([by_feature(view.points, view.f, model.size) for view in views])
    return FeatureInformation(C, model.radius_m)


def seen(model: EdgeModel, count: int = 4) -> FeatureInformation:
    return information_at(model, poses(count))
