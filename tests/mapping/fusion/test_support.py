"""Which voxels count: frames that agree, not frames that are many."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import make_pose
from polhode.mapping.fusion.block_grid import (
    CHANNELS,
    DISTANCE,
    FREE,
    SQUARE,
    VIEWS,
    WEIGHT,
    WEIGHT_SQUARED,
)
from polhode.mapping.fusion.field import Field
from polhode.mapping.fusion.surface_extraction import known_voxels, scatter_m
from polhode.records.mesh_metrics import distance_to_surface
from tests.mapping.analytic_depth import RIG, views_of

VOXEL_M = 2e-3
CONFIG = Mapping(agreeing_voxels=0.7, scatter_voxels=1.6, carved_share=0.3)


def voxel(
    said_voxels: list[float], through: float = 0.0, weights: list[float] | None = None
) -> NDArray[np.float32]:
    """(1, 1, 8): sums of what frames said (of unit weight), and the weight of those that look through."""
    d = np.array(said_voxels) * VOXEL_M
    w = np.ones(len(d)) if weights is None else np.array(weights)
    out = np.zeros((1, 1, CHANNELS), dtype=np.float32)
    out[..., WEIGHT], out[..., VIEWS], out[..., WEIGHT_SQUARED] = w.sum(), len(d), np.square(w).sum()
    out[..., DISTANCE], out[..., SQUARE], out[..., FREE] = (w * d).sum(), (w * d * d).sum(), through
    return out


def is_known(said_voxels: list[float], through: float = 0.0, min_views: int = 3) -> bool:
    return bool(known_voxels(voxel(said_voxels, through), VOXEL_M, CONFIG, min_views)[0, 0])


def test_voxels_count_where_frames_agree() -> None:
    assert scatter_m(voxel([-1.0, 0.0, 2.0]))[0, 0] == pytest.approx(
        np.std([-1.0, 0.0, 2.0]) * VOXEL_M, rel=1e-5
    )
    # two frames count where they agree
    assert is_known([0.5, -0.5])
    assert not is_known([1.0, -1.0])
    assert not is_known([0.0])
    assert is_known([0.0], min_views=1)
    # far from the surface on average, so they do not set what is usual
    assert is_known([1.0, 2.0, 3.0, 2.0])
    assert not is_known([4.0, 0.0, 4.0, 0.0, 4.0])
    # what frames look through is left out
    assert is_known([0.1, 0.0, -0.1], through=1.0)
    assert not is_known([0.1, 0.0, -0.1], through=1.5)
    # empty space is known by those who look through
    empty = np.zeros((1, 1, CHANNELS), dtype=np.float32)
    assert not known_voxels(empty, VOXEL_M, CONFIG, 1).any()
    empty[..., FREE] = 2.0
    assert known_voxels(empty, VOXEL_M, CONFIG, 1).all()
    # where all depth is poor the limits follow
    poor = np.concatenate([voxel([3.0, -3.0, 3.0, -3.0])] * 9 + [voxel([9.0, -9.0, 9.0, -9.0])])
    assert known_voxels(poor, VOXEL_M, CONFIG, 3).reshape(-1).tolist() == [True] * 9 + [False]


@pytest.mark.parametrize("weight", [1.0, 0.1, 0.01, 1e-4])
def test_a_frame_does_not_confirm_another_by_its_poor_weight(weight: float) -> None:
    def confirmed(said_voxels: list[float]) -> bool:
        return bool(known_voxels(voxel(said_voxels, weights=[1.0, weight]), VOXEL_M, CONFIG, 3)[0, 0])

    assert confirmed([0.5, -0.5])
    assert not confirmed([0.0, 2.0])


def test_thin_parts_beside_the_body_stay() -> None:
    """A boom whose foot is out of sight: 1 % of the area, and no smaller than what a mission must not hit."""
    body = trimesh.creation.box((0.2, 0.2, 0.2))
    boom = trimesh.creation.box((0.012, 0.012, 0.05))
    boom.apply_translation((0.0, 0.0, 0.16))
    both = trimesh.util.concatenate([body, boom])
    assert isinstance(both, trimesh.Trimesh)
    config = Mapping(voxel_mm=VOXEL_M * 1e3)
    field = Field(RIG, config, VOXEL_M)
    for depth, X_RG in views_of(both, 24, sigma_m=5e-4):
        field.add(depth, X_RG)
    surface = field.surface()
    points = trimesh.sample.sample_surface(boom, 500, seed=0)[0]
    sides = points[np.abs(points[:, 2] - 0.16) < 0.02]
    assert np.quantile(distance_to_surface(surface.mesh, sides), 0.9) < VOXEL_M


def test_poses_that_all_scatter_give_a_surface_still_and_a_speck_is_none() -> None:
    config = Mapping(voxel_mm=1.0, agreeing_voxels=0.01, scatter_voxels=0.05)
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    depth, X_RG = views_of(box, 1, sigma_m=1e-3)[0]
    field = Field(RIG, config, 1e-3)
    for k in range(6):
        # along the viewing direction, by a part of the truncation
        field.add(depth, make_pose(np.eye(3), np.array([0.0, 0.0, 6e-4 * (-1) ** k])) @ X_RG)
    surface = field.surface()
    assert surface.warnings == ()
    seen = (depth.depth_m > 0).sum() * (np.nanmedian(depth.depth_m) / RIG.focal_px) ** 2
    assert surface.mesh.area > 0.7 * seen
    row, column = np.argwhere(depth.depth_m > 0).mean(axis=0).astype(int)
    speck = np.full_like(depth.depth_m, np.nan)
    speck[row : row + 2, column : column + 2] = depth.depth_m[row : row + 2, column : column + 2]
    field = Field(RIG, Mapping(voxel_mm=1.0), 1e-3)
    for _ in range(4):
        field.add(replace(depth, depth_m=speck), X_RG)
    surface = field.surface()
    assert len(surface.mesh.faces) == 0
    assert "too small" in surface.warnings[-1]
