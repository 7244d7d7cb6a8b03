"""How far corners are from their epipolar lines."""

import numpy as np

from polhode.calibration.adjustment import CornerData, RigState
from polhode.calibration.lenses import Lens, normalized_by_newton
from polhode.geometry import fisheye
from polhode.geometry.lie import Array, Ints


def rays(lens: Lens, uv_px: Array) -> Array:
    """Unit rays (n, 3) of pixels (n, 2); NaN: there is none."""
    if lens.is_fisheye:
        return fisheye.rays(uv_px, lens.K, lens.coefficients)
    flat = normalized_by_newton(lens, uv_px)
    ray = np.column_stack([flat, np.ones(len(flat))])
    return np.asarray(ray / np.linalg.norm(ray, axis=1, keepdims=True))


def common_corners(data: tuple[CornerData, CornerData]) -> tuple[Ints, Ints]:
    """Indices of the corners that both cameras see in the same pair."""
    keys = [
        [(int(view), *point) for view, point in zip(each.view, each.p_B.tolist(), strict=True)]
        for each in data
    ]
    place = {key: k for k, key in enumerate(keys[1])}
    both = [(k, place[key]) for k, key in enumerate(keys[0]) if key in place]
    left, right = np.array(both, dtype=np.int64).reshape(-1, 2).T
    return left, right


def epipolar_px(state: RigState, left_px: Array, right_px: Array) -> Array:
    """(n,) signed distance of right pixels (n, 2) from the epipolar planes of left ones [px].

    The angle between the right ray and the plane through the left ray and the baseline, times the pixels that
    an angle has where the right ray is seen.
    """
    left = rays(state.lenses[0], left_px) @ state.X_10[:3, :3].T
    right = rays(state.lenses[1], right_px)
    normal = np.cross(state.X_10[:3, 3], left)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    angle = np.arcsin(np.clip((normal * right).sum(axis=1), -1.0, 1.0))
    # by a step of one pixel along each axis of the image
    change = [((rays(state.lenses[1], right_px + step) - right) * normal).sum(axis=1) for step in np.eye(2)]
    return np.asarray(angle / np.hypot(change[0], change[1]))


def epipolar_errors(state: RigState, data: tuple[CornerData, CornerData]) -> tuple[Array, Array]:
    """Right pixels (n, 2) of the corners that both cameras see, and their epipolar errors (n,) [px]."""
    left, right = common_corners(data)
    right_px = data[1].uv_px[right]
    return right_px, epipolar_px(state, data[0].uv_px[left], right_px)
