"""Depth of every family of bodies against an independent ray cast, in double precision."""

import cv2
import numpy as np
import pytest

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Ints, exp_so3, inverse_pose, make_pose, transform_points
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.frame_renderer import render_products
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, build_cameras

RIG = config.Rig(width_px=160, height_px=120, focal_px=150.0, distortion=(-0.2, 0.05, 1e-3, -5e-4))
RAYS = 150


def _independent_depth(triangles_K: Array, camera: Camera, pixel: Ints) -> Array:
    """Depth (n,) [m] at pixels counted row by row: Moeller and Trumbore 1997 on every triangle; NaN: a miss.

    The rays are OpenCV's own.
    """
    v, u = np.divmod(pixel, camera.width_px)
    uv = np.stack([u, v], axis=1).astype(np.float64)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-14)
    flat = cv2.undistortPoints(uv, camera.K, camera.dist, criteria=stop).reshape(-1, 2)
    a, b, c = np.moveaxis(triangles_K, 1, 0)
    e1, e2 = b - a, c - a
    q = np.cross(-a, e1)
    along = np.einsum("fk,fk->f", e2, q)
    depth = np.full(len(pixel), np.nan)
    for n, ray in enumerate(np.column_stack([flat, np.ones(len(flat))])):
        p = np.cross(ray, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / np.einsum("fk,fk->f", e1, p)
            first, second = np.einsum("fk,fk->f", -a, p) * inverse, (q @ ray) * inverse
            t = along * inverse
        hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (t > 0)
        if hit.any():
            depth[n] = t[hit].min()
    return depth


@pytest.mark.parametrize("family", ["dish", "truss"])
def test_depth_agrees_with_an_independent_ray_cast_within_ten_micrometres(family: str) -> None:
    body = build_body(config.TargetBody.model_validate({"family": family, "size_m": 0.3}), 3)
    renderer = Renderer(body, config.Scene(), 3)
    _, camera = build_cameras(RIG)
    X_NG = make_pose(exp_so3([0.5, -0.7, 0.3]), [0.05, 0.0, 3.0 * body.radius_m])
    depth = render_products(renderer, camera, camera.X_CK, X_NG, ("depth",)).depth
    assert depth is not None
    rng = np.random.default_rng(1)
    pixel = rng.choice(np.flatnonzero(np.isfinite(depth)), RAYS, replace=False)
    beside = rng.choice(np.flatnonzero(np.isnan(depth)), RAYS // 5, replace=False)
    triangles_K = transform_points(inverse_pose(camera.X_CK) @ X_NG, body.mesh.triangles.reshape(-1, 3))
    triangles_K = triangles_K.reshape(-1, 3, 3)
    expected = _independent_depth(triangles_K, camera, pixel)
    assert np.abs(depth.ravel()[pixel] - expected).max() < 1e-5
    assert np.isnan(_independent_depth(triangles_K, camera, beside)).all()
