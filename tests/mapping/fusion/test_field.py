"""The field as it grows: frames added, taken away, moved; what is with_covariance when little is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose, transform_points
from polhode.mapping.fusion.block_grid import (
    CHANNELS,
    COLOUR,
    COLOUR_WEIGHT,
    DISTANCE,
    EDGE,
    FREE,
    FREE_SPACE_WEIGHT,
    SQUARE,
    VIEWS,
    WEIGHT,
    WEIGHT_SQUARED,
    BlockGrid,
    pack_keys,
    unpack_keys,
)
from polhode.mapping.fusion.depth_frame import frame_tensors
from polhode.mapping.fusion.field import Field, fuse
from polhode.mapping.fusion.integration import allocate, integrate
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.surface import DepthMap, SurfaceModel
from tests.mapping.analytic_depth import DISTANCE_M, RIG, depth_of, views_of

VOXEL_M = 3e-3
CONFIG = Mapping(voxel_mm=VOXEL_M * 1e3, shared_sigma=0.0, relief_sigma=0.0, border_sigma=0.0)
Frames = list[tuple[DepthMap, Array]]


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = trimesh.creation.box((0.12, 0.10, 0.08))
    return mesh


@pytest.fixture(scope="module")
def frames(box: trimesh.Trimesh) -> Frames:
    return views_of(box, 24, sigma_m=1e-3)


def moved(X_RG: Array, shift_m: float, turn_rad: float, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return np.asarray(X_RG @ make_pose(exp_so3(rng.normal(0, turn_rad, 3)), rng.normal(0, shift_m, 3)))


def filled(frames: Frames) -> Field:
    field = Field(RIG, CONFIG, VOXEL_M)
    for depth, X_RG in frames:
        field.add(depth, X_RG)
    return field


def between(a: SurfaceModel, b: SurfaceModel) -> float:
    """Largest distance of a vertex of either mesh from the nearest of the other [voxels]."""
    A, B = np.asarray(a.mesh.vertices), np.asarray(b.mesh.vertices)
    return float(max(cKDTree(A).query(B)[0].max(), cKDTree(B).query(A)[0].max())) / VOXEL_M


def reference(grid: BlockGrid, depth: DepthMap, X_RG: Array) -> Array:
    """(n 512, 8) what a frame adds to the voxels of a grid, by NumPy, in double precision."""
    frame = frame_tensors(depth, RIG)
    assert frame is not None
    inner = np.stack(np.meshgrid(*[np.arange(EDGE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    voxel = unpack_keys(grid.keys).numpy()[:, None] * EDGE + inner
    p = transform_points(X_RG, VOXEL_M * voxel.reshape(-1, 3))
    u, v = (
        np.round(RIG.focal_px * p[:, axis] / p[:, 2] + centre - first).astype(int)
        for axis, centre, first in ((0, RIG.cx_px, frame.u0), (1, RIG.cy_px, frame.v0))
    )
    h, w = frame.depth_m.shape
    inside = (u >= 0) & (u < w) & (v >= 0) & (v < h)
    z, weight, cosine, grey = (
        np.where(inside, image.numpy()[v.clip(0, h - 1), u.clip(0, w - 1)], 0.0)
        for image in (frame.depth_m, frame.weight, frame.cosine, frame.intensity)
    )
    distance = (z - p[:, 2]) * cosine
    weight = np.where((weight > 0.0) & (distance > -grid.behind_m), weight, 0.0)
    near = (weight > 0.0) & (distance < grid.front_m)
    part = near * weight * np.clip((distance + grid.behind_m) / (grid.behind_m - 0.5 * VOXEL_M), 0.0, 1.0)
    lit = part * (0.01 + np.clip((grey - 8.0) / 40.0, 0.0, 1.0) * np.clip((252.0 - grey) / 20.0, 0.0, 1.0))
    out = np.zeros((len(p), CHANNELS))
    out[:, WEIGHT], out[:, DISTANCE], out[:, SQUARE] = part, part * distance, part * distance**2
    out[:, VIEWS], out[:, FREE] = near, np.where(near, 0.0, FREE_SPACE_WEIGHT * weight)
    out[:, COLOUR], out[:, COLOUR_WEIGHT], out[:, WEIGHT_SQUARED] = lit * grey, lit, part**2
    return out


def test_compiled_loops_are_the_sums_over_all_voxels(frames: Frames) -> None:
    grid = BlockGrid(VOXEL_M, 1024.0)
    expected: Array = np.zeros((0, CHANNELS))
    for depth, X_RG in frames[:3]:
        tensors = frame_tensors(depth, RIG)
        assert tensors is not None
        allocate(grid, tensors, X_RG, RIG)
    for k, (depth, X_RG) in enumerate([*frames[:3], frames[2]]):
        tensors = frame_tensors(depth, RIG)
        assert tensors is not None
        integrate(grid, tensors, X_RG, RIG, remove=k == 3)
        if k < 2:
            expected = reference(grid, depth, X_RG) + (expected if k else 0.0)
    found = grid.values.reshape(-1, CHANNELS).numpy()
    # single precision puts a voxel in a thousand into the next pixel
    same = found[:, VIEWS] == expected[:, VIEWS]
    same &= (found[:, FREE] > 0) == (expected[:, FREE] > 0)
    assert len(grid) > 100 and same.mean() > 0.998
    close = np.isclose(found[same], expected[same], rtol=1e-3, atol=1e-2).all(axis=1)
    assert close.mean() > 0.998
    # every point of the truncation band has its block
    at = band_points(frames[0])
    block = np.floor(np.round(at / VOXEL_M) / EDGE).astype(np.int64)
    assert bool((grid.find(pack_keys(torch.from_numpy(block))) >= 0).all())


def band_points(frame: tuple[DepthMap, Array]) -> Array:
    """(n, 3) points in G of a frame's depth, at both ends of the truncation band."""
    depth, X_RG = frame
    v, u = np.nonzero(np.isfinite(depth.depth_m))
    ray = np.column_stack([(u - RIG.cx_px) / RIG.focal_px, (v - RIG.cy_px) / RIG.focal_px, np.ones(len(u))])
    z = depth.depth_m[v, u].astype(np.float64)
    grid = BlockGrid(VOXEL_M, 1.0)
    ends = [ray * (z + off)[:, None] for off in (-grid.front_m, 0.0, grid.behind_m)]
    return transform_points(inverse_pose(X_RG), np.concatenate(ends))


def test_a_frame_taken_away_leaves_nothing(frames: Frames) -> None:
    field = filled(frames[:6])
    before = field.surface()
    wrong = moved(frames[7][1], 0.02, 0.2, seed=1)
    field.add(frames[7][0], wrong)
    assert between(field.surface(), before) > 1.0
    lost = np.stack([X for _, X in frames[:6]] + [np.full((4, 4), np.nan)])
    assert field.move(lost) == 1
    after = field.surface()
    assert len(after.mesh.faces) == len(before.mesh.faces)
    assert between(after, before) < 1e-3
    np.testing.assert_allclose(np.sort(after.sigma_m), np.sort(before.sigma_m), rtol=1e-3)
    assert "1 of 7 frames have no finite pose" in after.warnings[0]


def test_fused_again_after_better_poses_is_fused_from_scratch(frames: Frames) -> None:
    at_first = [(d, moved(X, 2e-3, 0.02, seed=k) if k % 4 == 0 else X) for k, (d, X) in enumerate(frames)]
    field = filled(at_first)
    better = np.stack([X for _, X in frames])
    assert between(field.surface(), filled(frames).surface()) > 0.5
    assert field.move(better) == 6
    again, scratch = field.surface(), filled(frames).surface()
    # single precision rounds what was added and taken away
    assert between(again, scratch) < 0.01
    np.testing.assert_array_equal(np.sort(again.views), np.sort(scratch.views))


def test_what_all_poses_share_moves_the_mesh_alone(frames: Frames) -> None:
    field = filled(frames)
    shared = make_pose(exp_so3([0.1, -0.2, 0.05]), [0.03, -0.01, 0.02])
    poses = np.stack([X @ shared for _, X in frames])
    poses[5] = moved(poses[5], 2e-3, 0.02, seed=5)
    assert field.move(poses) == 1
    scratch = filled([(d, X) for (d, _), X in zip(frames, poses, strict=True)]).surface()
    surface = field.surface()
    # other voxels, which cut the box's edges and its noise elsewhere, the same surface
    off = distance_to_surface(scratch.mesh, np.asarray(surface.mesh.vertices)) / VOXEL_M
    assert np.mean(off) < 0.15 and np.percentile(off, 99) < 0.8
    assert field.move(poses) == 0


def test_when_most_poses_change_the_field_is_rebuilt(frames: Frames) -> None:
    field = filled(frames)
    poses = np.stack([moved(X, 2e-3, 0.02, seed=k) for k, (_, X) in enumerate(frames)])
    assert field.move(poses) == len(frames)
    scratch = filled([(d, X) for (d, _), X in zip(frames, poses, strict=True)]).surface()
    np.testing.assert_array_equal(field.surface().mesh.vertices, scratch.mesh.vertices)


def test_frames_that_memory_does_not_hold_stay_as_they_are(frames: Frames) -> None:
    field = Field(RIG, CONFIG, VOXEL_M, kept_mib=0.2)
    for depth, X_RG in frames:
        field.add(depth, X_RG)
    # what they miss are a few blocks at rims, and the separation of the sides there
    assert between(field.surface(), filled(frames).surface()) < 1.5
    with pytest.raises(ValueError, match="frames were dropped"):
        field.move(np.stack([X for _, X in frames]))


def test_frames_whose_poses_are_doubtful_or_unknown_weigh_less(box: trimesh.Trimesh, frames: Frames) -> None:
    shift, turn, count = 4e-3, 0.04, len(frames)
    known, unknown = np.tile(1e-10 * np.eye(6), (count, 1, 1)), np.zeros((count, 6, 6))
    wrong = list(frames)
    for k in range(0, count, 3):
        wrong[k] = (frames[k][0], moved(frames[k][1], shift, turn, seed=k))
        known[k] = np.diag([shift**2] * 3 + [turn**2] * 3)
        unknown[k, 0, 0] = (np.nan, np.inf)[k % 2]
    by_known, by_unknown, without = (
        fuse(wrong, RIG, CONFIG, covariance_G=covariance) for covariance in (known, unknown, None)
    )
    error = [
        distance_to_surface(box, np.asarray(s.mesh.vertices)).mean() for s in (by_known, by_unknown, without)
    ]
    assert max(error[:2]) < 0.7 * error[2]
    assert by_unknown.warnings == (
        "8 of 24 frames have a pose of unknown precision: they count as if 12 mm off",
    )
    # where nothing else saw the body they make the surface, with sigmas that say how little is known
    alone = fuse(frames, RIG, CONFIG, covariance_G=np.full((count, 6, 6), np.nan))
    assert len(alone.mesh.faces) > 1000 and "24 of 24" in alone.warnings[0]
    assert np.median(alone.sigma_m) > 3.0 * np.median(fuse(frames, RIG, CONFIG).sigma_m)


def test_a_turn_matters_far_from_its_axis_and_along_the_normal_alone() -> None:
    plate = trimesh.creation.box((0.16, 0.12, 0.01))
    X_RG = make_pose(np.eye(3), [0.0, 0.0, DISTANCE_M])
    depth = depth_of(plate, X_RG, 1e-9, np.random.default_rng(0))
    depth = replace(depth, sigma_m=np.where(np.isfinite(depth.depth_m), 1e-3, np.nan).astype(np.float32))
    turn = 0.02
    covariance = np.diag([5.0, 5.0, 0.0, 0.0, turn**2, 0.0])
    tensors = frame_tensors(depth, RIG, covariance, X_RG[:3, 3])
    assert tensors is not None
    row = round(RIG.cy_px) - tensors.v0
    for x_m in (0.0, 0.05):
        column = round(RIG.cx_px + RIG.focal_px * x_m / (DISTANCE_M - 0.005)) - tensors.u0
        sigma = float(tensors.weight[row, column]) ** -0.5
        # shifts within the plane, however large, change no distance along the normal
        assert sigma == pytest.approx(np.hypot(1e-3, x_m * turn), rel=0.05, abs=2e-4)


def test_frames_that_say_too_little_give_a_warning(frames: Frames) -> None:
    surface = fuse(frames, RIG, CONFIG.model_copy(update={"memory_mib": 2.0}))
    assert any("field of 2 MiB is full" in warning for warning in surface.warnings)
    assert not surface.mesh.is_watertight
    # frames that do not overlap give what was seen and a warning
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    # three poses that put the same side in three places
    frames = [
        (depth, X_RG @ make_pose(np.eye(3), [0.4 * k, 0.0, 0.0]))
        for k, (depth, X_RG) in enumerate(views_of(ball, 1, sigma_m=5e-4) * 4)
    ]
    surface = fuse(frames, RIG, CONFIG)
    assert len(surface.mesh.faces) > 1000
    assert not surface.mesh.is_watertight
    assert surface.views.max() == 1
    assert "nothing confirms it" in surface.warnings[0]


def test_depth_with_holes_is_fused_without_them_and_without_valid_depth_there_is_no_surface(
    box: trimesh.Trimesh, frames: Frames
) -> None:
    rng, broken = np.random.default_rng(0), []
    for depth, X_RG in frames:
        bad = rng.random(depth.depth_m.shape) < 0.3
        broken.append((replace(depth, depth_m=np.where(bad, np.nan, depth.depth_m).astype(np.float32)), X_RG))
    surface = fuse(broken, RIG, CONFIG)
    error = distance_to_surface(box, np.asarray(surface.mesh.vertices))
    assert np.isfinite(surface.mesh.vertices).all() and np.isfinite(surface.sigma_m).all()
    assert error.mean() < VOXEL_M / 3 and surface.warnings == ()
    for value in (np.nan, 0.0, -1.0, np.inf):
        blind = [(replace(d, depth_m=np.full_like(d.depth_m, value)), X) for d, X in frames[:4]]
        surface = fuse(blind, RIG, Mapping())
        assert len(surface.mesh.faces) == 0
        assert surface.warnings == ("no frame has valid depth: there is no surface",)


def test_depth_beyond_all_reason_takes_no_memory_and_poses_can_be_mended(frames: Frames) -> None:
    far = [(replace(d, depth_m=d.depth_m * 1e6), X) for d, X in frames[:3]]
    field = filled(far)
    assert field.bytes == 0
    assert len(field.surface().mesh.faces) == 0
    assert field.move(np.stack([X for _, X in far])) == 3
    assert len(field.surface().mesh.faces) == 0
    # poses that put all beyond the field can be mended
    beyond = make_pose(np.eye(3), [1e6, 0.0, 0.0])
    field = filled([(d, X @ beyond) for d, X in frames[:6]])
    assert field.bytes == 0
    assert field.move(np.stack([X for _, X in frames[:6]])) == 6
    scratch = filled(frames[:6]).surface()
    np.testing.assert_array_equal(field.surface().mesh.vertices, scratch.mesh.vertices)


def test_memory_grows_with_the_surface() -> None:
    grid = BlockGrid(VOXEL_M, memory_mib=2.0**30)
    ends, keys = [], torch.arange(2500, dtype=torch.int64)
    for k, part in enumerate(keys.split(450)):
        grid.allocate(part)
        grid.values[-1] = float(k + 1)
        ends.append(len(grid) - 1)
    assert grid._values.nbytes <= 1.5 * grid.bytes + 2**24
    torch.testing.assert_close(grid.keys, keys)
    assert grid.values[ends, 0, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert float(grid.values.sum()) == 21.0 * grid.values[0].numel()
