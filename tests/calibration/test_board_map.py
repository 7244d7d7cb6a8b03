"""A map of a board follows a lens, and wrong points do not move it."""

import numpy as np
import pytest

from polhode.calibration.board_map import fitted_map, misfit
from polhode.calibration.boards import make_board
from polhode.calibration.lenses import Lens, Model, project
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points

SIZE = (720, 540)
BOARD = make_board("charuco", "7x5", 0.045)
LENSES: dict[Model, list[float]] = {
    "brown5": [650.0, 652.0, 350.0, 275.0, -0.25, 0.08, 0.001, -0.0005, 0.0],
    "fisheye": [320.0, 321.0, 372.0, 262.0, 0.03, -0.008, 0.002, -0.0005],
}


def seen(model: Model, p_m: Array) -> Array:
    """A board that is tilted, and before a fisheye near the border of the image."""
    turn = exp_so3([0.2, -0.5, 0.3])
    at = np.array([-0.1, -0.1, 0.4]) if model == "brown5" else np.array([0.05, -0.12, 0.14])
    X_CB = make_pose(turn, at)
    p = transform_points(X_CB, np.column_stack([p_m, np.zeros(len(p_m))]))
    return project(Lens(model, np.array(LENSES[model])), p)


@pytest.mark.parametrize("model", ["brown5", "fisheye"])
def test_corners_are_expected_within_a_pixel_by_others_of_which_some_are_wrong(model: Model) -> None:
    rng = np.random.default_rng(2)
    p_m = rng.uniform([0.0, 0.0], [7 * 0.045, 5 * 0.045], (68, 2))
    uv_px = seen(model, p_m) + 0.3 * rng.standard_normal((68, 2))
    uv_px[::9] += rng.uniform(5.0, 20.0, uv_px[::9].shape)
    uv_px[5] = np.nan
    found = fitted_map(p_m, uv_px, SIZE)
    assert found is not None
    wanted = BOARD.points[:, :2]
    off = np.linalg.norm(found(wanted) - seen(model, wanted), axis=1)
    assert off.max() < 1.0
    h = 1e-4
    true = [
        np.linalg.norm(seen(model, wanted + d) - seen(model, wanted - d), axis=1) / (2.0 * h)
        for d in (np.array([h, 0.0]), np.array([0.0, h]))
    ]
    np.testing.assert_allclose(found.scale(wanted, 0.01), np.min(true, axis=0), rtol=0.1)


def test_a_fisheye_fits_its_own_board_and_no_board_fits_permuted_points() -> None:
    p_m = BOARD.points[:, :2]
    uv_px = seen("fisheye", p_m)
    assert misfit(p_m, uv_px, BOARD.square_m, SIZE) < 0.06
    other = np.random.default_rng(1).permutation(p_m)
    assert misfit(other, uv_px, BOARD.square_m, SIZE) > 0.5
    assert misfit(p_m[:3], uv_px[:3], BOARD.square_m, SIZE) == 0.0
    # too few points have no map
    p_m = BOARD.points[:8, :2]
    uv_px = seen("brown5", p_m)
    uv_px[0] = np.nan
    assert fitted_map(p_m, uv_px, SIZE) is None
