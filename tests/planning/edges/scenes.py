"""A camera, a pose, bodies and their images, for the tests of what edges tell."""

import cv2
import numpy as np
import trimesh

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.information import FeatureInformation, by_feature, views_along

RIG = RectifiedRig(800.0, 319.5, 239.5, 0.1, 640, 480)
BOX = (0.8, 0.55, 0.35)
POSE = make_pose(exp_so3([0.5, 0.6, 0.2]), [0.04, -0.03, 2.5])


def drawn(
    mesh: trimesh.Trimesh, X_RG: Array, seed: int = 0, light: tuple[float, ...] = (0.5, -0.6, -0.62)
) -> Array:
    """Image (H, W) of a convex mesh: each face as bright as it is turned to a light, over a black sky."""
    fine = 4
    canvas = np.zeros((RIG.height_px * fine, RIG.width_px * fine), dtype=np.float32)
    corners = transform_points(X_RG, np.asarray(mesh.triangles).reshape(-1, 3)).reshape(-1, 3, 3)
    normals = np.asarray(mesh.face_normals) @ X_RG[:3, :3].T
    towards = np.array(light) / np.linalg.norm(light)
    for triangle, normal in zip(corners, normals, strict=True):
        if normal @ triangle[0] < 0.0:
            uv = (RIG.project(triangle)[:, :2] + 0.5) * fine - 0.5
            low = np.maximum(np.floor(uv.min(axis=0)).astype(int), 0)
            high = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 1, canvas.shape[::-1])
            x, y = np.meshgrid(*(np.arange(a, max(a, b)) for a, b in zip(low, high, strict=True)))
            # cells whose middle lies on one side of all three edges
            sides = [
                (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                for a, b in zip(uv, np.roll(uv, -1, axis=0), strict=True)
            ]
            inside = np.all(np.array(sides) >= 0.0, axis=0) | np.all(np.array(sides) <= 0.0, axis=0)
            level = 40.0 + 160.0 * max(float(normal @ towards), 0.0)
            canvas[low[1] : high[1], low[0] : high[0]][inside] = level
    image = cv2.resize(canvas, (RIG.width_px, RIG.height_px), interpolation=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    return np.asarray(image + np.random.default_rng(seed).standard_normal(image.shape))


def bevelled_box(extents_m: tuple[float, float, float], bevel_m: float) -> trimesh.Trimesh:
    """A box whose edges are cut off at 45 degrees."""
    corners = []
    for axis in range(3):
        half = 0.5 * np.array(extents_m) - bevel_m
        half[axis] += bevel_m
        corners.append(half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T)
    hull: trimesh.Trimesh = trimesh.convex.convex_hull(np.vstack(corners))
    return hull


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


def information_at(model: EdgeModel, X_RG: Array) -> FeatureInformation:
    """About the model's centre."""
    views = views_along(model, RIG, X_RG, model.centre_G)
    C = np.stack([by_feature(view.points, view.f, model.size) for view in views])
    return FeatureInformation(C, model.radius_m)
