"""Rigs of every kind measure points of the true surface: the first pair of each scene of configs/rigs."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from polhode.config import Frontend
from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth
from polhode.frontend.features.stereo import RootSift
from polhode.frontend.rectification import RectifiedPair, Rectifier, make_rectifier
from polhode.frontend.segmentation import target_mask
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.rig_calibration import StereoCalibration
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, load_scene, plan_sequence
from polhode.simulation.stereo_camera import mount_pose

RIGS = Path(__file__).parents[2] / "configs" / "rigs"
NAMES = sorted(path.stem for path in RIGS.glob("*.yaml"))


@dataclass(frozen=True)
class Seen:
    """The first pair of a scene, rectified."""

    plan: SequencePlan
    rectifier: Rectifier
    pair: RectifiedPair

    def off_m(self, p_R: Array) -> Array:
        """Distances (n,) of points (n, 3) from the true surface [m]."""
        X_GR = inverse_pose(self.plan.target.X_NG[0]) @ self.plan.X_NC[0] @ self.rectifier.X_CR
        return distance_to_surface(self.plan.body.mesh, transform_points(X_GR, p_R))


@cache
def seen(name: str) -> Seen:
    scene, seed = load_scene(RIGS / f"{name}.yaml")
    quick = scene.render.model_copy(update={"samples": 1, "bounces": 0})
    plan = plan_sequence(scene.model_copy(update={"frames": 1, "render": quick}), seed)
    left, right = plan.cameras
    X_BC = mount_pose(scene.rig)
    calibration = StereoCalibration(
        left.K,
        right.K,
        left.dist,
        right.dist,
        X_BC @ left.X_CK,
        X_BC @ right.X_CK,
        left.width_px,
        left.height_px,
        fisheye0=left.fisheye,
        fisheye1=right.fisheye,
        right_size_px=(right.width_px, right.height_px),
    )
    rectifier, renderer = make_rectifier(calibration), FrameRenderer(plan)
    image0, image1 = (rectifier(renderer.render_image(0, side)[0].astype(np.uint8), side) for side in (0, 1))
    return Seen(plan, rectifier, RectifiedPair(image0, image1, target_mask(image0), target_mask(image1)))


def footprint_m(one: Seen) -> float:
    """Depth of one pixel of disparity at the target [m]."""
    rig, z = one.rectifier.rig, float(np.linalg.norm(one.plan.target.X_NG[0][:3, 3]))
    return z**2 / (rig.focal_px * rig.baseline_m)


@pytest.mark.parametrize("name", NAMES)
def test_features_lie_on_the_surface(name: str) -> None:
    one = seen(name)
    found = RootSift(Frontend())(one.pair, one.rectifier.rig)
    off = one.off_m(found.p_R)
    assert len(found) > 100
    assert np.median(off) < 0.4 * footprint_m(one)
    assert np.mean(off > 3.0 * footprint_m(one)) < 0.05


@pytest.mark.parametrize("name", NAMES)
def test_depth_lies_on_the_surface(name: str) -> None:
    one = seen(name)
    pair, rig = one.pair, one.rectifier.rig
    depth = compute_depth(pair.left, pair.right, pair.mask_left, rig, Depth(method="sgbm")).depth_m
    v, u = np.nonzero(np.isfinite(depth))
    assert len(u) > 0.3 * pair.mask_left.sum()
    some = slice(None, None, 1 + len(u) // 4000)
    z = depth[v, u][some].astype(np.float64)
    p_R = (
        np.column_stack([(u[some] - rig.cx_px) * z, (v[some] - rig.cy_px) * z, rig.focal_px * z])
        / rig.focal_px
    )
    off = one.off_m(p_R)
    assert np.median(off) < 0.4 * footprint_m(one)
    assert np.mean(off > 3.0 * footprint_m(one)) < 0.05


def test_the_converging_rig_sees_infinity_out_of_its_images() -> None:
    rig = seen("converging").rectifier.rig
    assert abs(rig.disparity_offset_px) > 0.7 * rig.width_px


def test_the_vertical_rig_is_turned_by_a_quarter() -> None:
    rectifier = seen("vertical").rectifier
    np.testing.assert_allclose(abs(rectifier.X_CR[:3, :3].round()), [[0, 1, 0], [1, 0, 0], [0, 0, 1]])
