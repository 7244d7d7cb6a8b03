"""Corners of a board as a known rig sees them, for the tests of this room."""

import numpy as np

from polhode.calibration.adjustment import CornerData, RigState
from polhode.calibration.lenses import Lens, Model, project
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points

SIZE = (640, 480)
VALUES: dict[Model, list[float]] = {
    "brown5": [520.0, 523.0, 325.0, 233.0, -0.28, 0.09, 0.0006, -0.0004, -0.012],
    "brown8": [520.0, 523.0, 325.0, 233.0, 0.21, -0.06, 0.0006, -0.0004, 0.003, 0.45, -0.02, 0.006],
    "fisheye": [240.0, 241.0, 322.0, 236.0, 0.03, -0.012, 0.004, -0.001],
}


def lens(model: Model, shift_px: float = 0.0) -> Lens:
    """A lens whose principal point is off by so much."""
    values = np.array(VALUES[model])
    values[2:4] += shift_px
    return Lens(model, values)


def board_points(columns: int = 9, rows: int = 6, square_m: float = 0.03) -> Array:
    """(n, 3) the inner corners."""
    j, i = np.mgrid[:rows, :columns]
    return np.column_stack([square_m * i.ravel(), square_m * j.ravel(), np.zeros(columns * rows)])


def rig(model: Model, views: int, rng: np.random.Generator) -> RigState:
    """Two lenses 8 cm apart, slightly turned, and boards in front of them."""
    middle = board_points().mean(axis=0)
    poses = []
    for _ in range(views):
        R = exp_so3(rng.uniform(-0.6, 0.6, 3))
        wide = 0.5 if model == "fisheye" else 0.22
        at = np.array([0.04, 0.0, 0.0]) + rng.uniform([-wide, -wide, 0.36], [wide, wide, 0.7]) * [
            0.45,
            0.35,
            1.0,
        ]
        poses.append(make_pose(R, at - R @ middle))
    X_10 = make_pose(exp_so3([0.01, -0.03, 0.02]), [-0.08, 0.001, -0.002])
    return RigState((lens(model), lens(model, 4.0)), np.array(poses), X_10)


def seen_corners(
    truth: RigState, sigma_px: float, rng: np.random.Generator, size_px: tuple[int, int] = SIZE
) -> tuple[CornerData, ...]:
    """What both cameras see of the boards, as far as it is in the image."""
    p_B = board_points()
    out = []
    for c, each in enumerate(truth.lenses):
        views, points, pixels = [], [], []
        for v, X_0B in enumerate(truth.X_CB):
            X_CB = X_0B if c == 0 else truth.X_10 @ X_0B
            uv = project(each, transform_points(X_CB, p_B))
            inside = ((uv > 2.0) & (uv < np.array(size_px) - 3.0)).all(axis=1)
            views += [v] * int(inside.sum())
            points.append(p_B[inside])
            pixels.append(uv[inside] + sigma_px * rng.standard_normal((int(inside.sum()), 2)))
        out.append(CornerData(np.array(views), np.concatenate(points), np.concatenate(pixels)))
    return tuple(out)
