"""The rectified camera: projection, its inverse, and how noise goes through it."""

import numpy as np

from polhode.geometry.camera import RectifiedRig

RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480, disparity_offset_px=3.0)


def test_triangulation_inverts_projection() -> None:
    p_R = np.random.default_rng(0).uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 3.0], (50, 3))
    np.testing.assert_allclose(RIG.triangulate(RIG.project(p_R)), p_R, rtol=1e-12)


def test_the_triangulation_jacobian_matches_finite_differences() -> None:
    p_R = np.random.default_rng(1).uniform([-0.3, -0.3, 0.4], [0.3, 0.3, 3.0], (20, 3))
    uvd = RIG.project(p_R)
    numeric = [(RIG.triangulate(uvd + e) - RIG.triangulate(uvd - e)) / 2e-5 for e in 1e-5 * np.eye(3)]
    np.testing.assert_allclose(
        RIG.triangulation_jacobian(p_R), np.stack(numeric, axis=-1), rtol=1e-6, atol=1e-9
    )
