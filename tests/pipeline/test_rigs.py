"""Rigs of every kind measure points of the true surface: the first pair of each scene of configs/rigs."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config import Frontend
from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth
from polhode.frontend.features.stereo import RootSift
from polhode.frontend.rectification import RectifiedPair, make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.rig_calibration import StereoCalibration
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import load_scene, plan_sequence
from polhode.simulation.stereo_camera import mount_pose

RIGS = sorted((Path(__file__).parents[2] / "configs" / "rigs").glob("*.yaml"))


@pytest.mark.parametrize("file", RIGS, ids=[path.stem for path in RIGS])
def test_features_and_depth_lie_on_the_surface(file: Path) -> None:
    scene, seed = load_scene(file)
    quick = scene.render.model_copy(update={"samples": 1, "bounces": 0})
    plan = plan_sequence(scene.model_copy(update={"frames": 1, "render": quick}), seed)
    left, right = plan.cameras
    X_BC = mount_pose(scene.rig)
    calibration = StereoCalibration(
        *(left.K, right.K, left.dist, right.dist, X_BC @ left.X_CK, X_BC @ right.X_CK),
        *(left.width_px, left.height_px),
        fisheye0=left.fisheye,
        fisheye1=right.fisheye,
        right_size_px=(right.width_px, right.height_px),
    )
    rectifier, renderer = make_rectifier(calibration), FrameRenderer(plan)
    rig, X_CR = rectifier.rig, rectifier.X_CR
    left_image, right_image = (
        rectifier(renderer.render_image(0, side)[0].astype(np.uint8), side) for side in (0, 1)
    )
    pair = RectifiedPair(left_image, right_image, target_mask(left_image), target_mask(right_image))

    def assert_on_surface(p_R: Array) -> None:
        """Points (n, 3), against the depth of one pixel of disparity at the target [m]."""
        footprint_m = float(plan.target.X_NG[0][:3, 3] @ plan.target.X_NG[0][:3, 3]) / (
            rig.focal_px * rig.baseline_m
        )
        X_GR = inverse_pose(plan.target.X_NG[0]) @ plan.X_NC[0] @ X_CR
        off_m = distance_to_surface(plan.body.mesh, transform_points(X_GR, p_R))
        assert np.median(off_m) < 0.4 * footprint_m and np.mean(off_m > 3.0 * footprint_m) < 0.05

    found = RootSift(Frontend())(pair, rig)
    assert len(found) > 100
    assert_on_surface(found.p_R)
    depth = compute_depth(pair.left, pair.right, pair.mask_left, rig, Depth(method="sgbm")).depth_m
    v, u = np.nonzero(np.isfinite(depth))
    assert len(u) > 0.3 * pair.mask_left.sum()
    some = slice(None, None, 1 + len(u) // 4000)
    z = depth[v, u][some].astype(np.float64)
    rays = np.column_stack([u[some] - rig.cx_px, v[some] - rig.cy_px, np.full(len(z), rig.focal_px)])
    assert_on_surface(rays * z[:, None] / rig.focal_px)
    if file.stem == "converging":
        # it sees infinity out of its images
        assert abs(rig.disparity_offset_px) > 0.7 * rig.width_px
    if file.stem == "vertical":
        np.testing.assert_allclose(abs(X_CR[:3, :3].round()), [[0, 1, 0], [1, 0, 0], [0, 0, 1]])
