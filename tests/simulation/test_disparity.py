"""Images against truth: what is seen in the left image lies in the right one where the correspondence says.

In windows all over the target, left = gain * right(true place + shift) + offset is solved for the shift by
least squares. The true place carries every pixel of the window along, so slanted and curved faces do not bias
the shift, and the shift is the error: of truth and image together, and of the matching.
"""

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Bools
from polhode.simulation.dataset.correspondence import correspond, view_of
from polhode.simulation.dataset.plan import SequencePlan, plan_sequence
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import expose

PARALLEL = {"width_px": 240, "height_px": 180, "focal_px": 250.0}
TOED_IN = PARALLEL | {
    "distortion": [-0.2, 0.05, 1e-3, -5e-4],
    "right_rotation_deg": [0.5, -6.0, 0.8],
    "right_offset_mm": [0.0, 1.5, -2.0],
}
HALF_PX, STEP_PX = 6, 5
SHARPEST_SIGMA_PX = 0.1


def _plan(family: str, rig: dict[str, Any]) -> SequencePlan:
    scene = {
        "frames": 1,
        "rig": rig,
        "body": {"family": family, "size_m": 0.22},
        "motion": {"position_m": [0.03, 0.0, 0.5], "attitude_deg": [20, 30, 10]},
        # Without the light from part to part, which takes a second to prepare.
        "light": {"sun_direction_N": [0.2, -0.4, -1.0], "earth": 0.0},
        "render": {"bounces": 0},
    }
    return plan_sequence(config.Scene.model_validate(scene), 4)


def _image(plan: SequencePlan, renderer: Renderer, index: int) -> Array:
    camera = plan.cameras[index]
    level = renderer.picture(camera, plan.X_NC[0] @ camera.X_CK, plan.target.X_NG[0]).level
    return expose(level, plan.scene.sensor, np.random.default_rng([7, index])).astype(np.float64)


def _shifts(left: Array, right: Array, uv_right: Array, usable: Bools) -> Array:
    """Shift (n, 2) in u and v [px] of the windows that have enough texture; uv_right (H, W, 2)."""

    def sampled(image: Array) -> Array:
        return np.asarray(map_coordinates(image, [uv_right[..., 1], uv_right[..., 0]], order=3))

    warped, along_v, along_u = (
        sampled(image) for image in (right, np.gradient(right, axis=0), np.gradient(right, axis=1))
    )
    shifts = []
    for v in range(HALF_PX, left.shape[0] - HALF_PX, STEP_PX):
        for u in range(HALF_PX, left.shape[1] - HALF_PX, STEP_PX):
            window = np.s_[v - HALF_PX : v + HALF_PX + 1, u - HALF_PX : u + HALF_PX + 1]
            if not usable[window].all():
                continue
            columns = [warped, np.ones_like(warped), along_u, along_v]
            A = np.stack([column[window].ravel() for column in columns], axis=1)
            solution, *_ = np.linalg.lstsq(A, left[window].ravel(), rcond=None)
            residual = left[window].ravel() - A @ solution
            variance = residual @ residual / (len(A) - 4) * np.linalg.pinv(A.T @ A)[[2, 3], [2, 3]]
            if solution[0] > 0.3 and np.sqrt(variance).max() / solution[0] < SHARPEST_SIGMA_PX:
                shifts.append(solution[2:] / solution[0])
    return np.array(shifts).reshape(-1, 2)


def _bias_and_scatter(shifts: Array) -> tuple[Array, Array]:
    """Median (2,) and robust standard deviation (2,) [px]."""
    median = np.median(shifts, axis=0)
    return median, 1.4826 * np.median(np.abs(shifts - median), axis=0)


@pytest.mark.parametrize(("family", "rig"), [("free_flyer", PARALLEL), ("asteroid", TOED_IN)])
def test_the_right_image_is_where_the_truth_says_within_a_twentieth_of_a_pixel(
    family: str, rig: dict[str, Any]
) -> None:
    """Default noise and lens. The median is the images' bias; the scatter is mostly the matching's own."""
    plan = _plan(family, rig)
    renderer = Renderer(plan.body, plan.scene, plan.seed)
    left, right = (_image(plan, renderer, index) for index in (0, 1))
    a, b = (view_of(plan, 0, index) for index in (0, 1))
    truth = correspond(RayCaster(plan.body), a, b, a.camera.pixel_grid())
    uv_right = np.nan_to_num(truth.uv_b_px)
    shifts = _shifts(left, right, uv_right, truth.visible)
    assert len(shifts) > 100
    median, scatter = _bias_and_scatter(shifts)
    assert np.abs(median).max() < 0.03
    assert scatter.max() < 0.15
    # The measure is not blind: it finds a truth that is moved.
    moved = _shifts(left, right, uv_right + np.array([0.2, 0.0]), truth.visible)
    assert -0.3 < _bias_and_scatter(moved)[0][0] - median[0] < -0.15
