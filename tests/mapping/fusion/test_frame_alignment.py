"""A frame's pose from the surface that other frames show."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.geometry.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.mapping.fusion.depth_frame import frame_tensors
from polhode.mapping.fusion.field import Field, fuse
from polhode.mapping.fusion.frame_alignment import (
    DepthPoints,
    FieldLookup,
    FieldSamples,
    FrameAlignment,
    align,
    depth_points,
    distances,
)
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.surface import DepthMap
from tests.mapping.analytic_depth import DISTANCE_M, FINE_RIG, depth_of, views_of

VOXEL_M = 1.5e-3
CONFIG = Mapping(voxel_mm=VOXEL_M * 1e3, shared_sigma=0.0, relief_sigma=0.0, border_sigma=0.0)
SHIFT_M, TURN_RAD = 3e-3, np.deg2rad(1.0)
PRIOR = np.diag([SHIFT_M**2] * 3 + [TURN_RAD**2] * 3)
SHARE = 0.3


@pytest.fixture(scope="module")
def body() -> trimesh.Trimesh:
    """No turn leaves it as it is."""
    parts: list[trimesh.Trimesh] = [trimesh.creation.box((0.12, 0.10, 0.08)) for _ in range(2)]
    parts[1].apply_scale([0.4, 0.5, 0.6])
    parts[1].apply_transform(make_pose(exp_so3([0.3, -0.2, 0.5]), [0.05, 0.03, 0.04]))
    return parts[0] + parts[1]


@pytest.fixture(scope="module")
def seen(body: trimesh.Trimesh) -> FieldLookup:
    return surface_of(body)


def surface_of(mesh: trimesh.Trimesh) -> FieldLookup:
    field = Field(FINE_RIG, CONFIG, VOXEL_M)
    for depth, X_RG in views_of(mesh, 24, sigma_m=1e-3, rig=FINE_RIG):
        field.add(depth, X_RG)
    return field.lookup()


def aligned(depth: DepthMap, X_RG: Array, surface: FieldLookup, prior: Array = PRIOR) -> FrameAlignment:
    tensors = frame_tensors(depth, FINE_RIG)
    assert tensors is not None
    return align(depth_points(tensors, X_RG, FINE_RIG), prior, surface, SHARE)


def view(mesh: trimesh.Trimesh, seed: int) -> tuple[DepthMap, Array, Array]:
    """Depth from somewhere, the pose, and one that is off."""
    rng = np.random.default_rng(seed)
    X_RG = make_pose(exp_so3(rng.normal(0.0, 1.0, 3)), [0.0, 0.0, DISTANCE_M])
    wrong = make_pose(exp_so3(rng.normal(0.0, TURN_RAD, 3)), rng.normal(0.0, SHIFT_M, 3))
    return depth_of(mesh, X_RG, 1e-3, rng, FINE_RIG), X_RG, X_RG @ wrong


def off(X_RG: Array, truth_RG: Array) -> Array:
    """(6,) shift [m] and turn [rad] of the truth about a pose, along G."""
    D = inverse_pose(X_RG) @ truth_RG
    return np.concatenate([D[:3, 3], log_so3(D[:3, :3])])


def sphere_at(p_G: Array) -> FieldSamples:
    """Distances from a ball that is not round the origin, as a field tells them."""
    away = p_G - np.array([0.02, -0.01, 0.03])
    length = np.linalg.norm(away, axis=1)
    return FieldSamples(length - 0.05, away / length[:, None], np.full(len(p_G), 1e-6))


def test_the_derivative_is_that_of_the_distance() -> None:
    rng = np.random.default_rng(0)
    p_G, x = rng.normal(0.0, 0.05, (40, 3)), rng.normal(0.0, 0.3, 6)
    step = 1e-6
    numeric = [
        (distances(x + d, p_G, sphere_at)[0] - distances(x - d, p_G, sphere_at)[0]) / (2 * step)
        for d in step * np.eye(6)
    ]
    np.testing.assert_allclose(distances(x, p_G, sphere_at)[1], np.column_stack(numeric), atol=1e-8)


@pytest.fixture(scope="module")
def ball() -> tuple[trimesh.Trimesh, FieldLookup]:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    return mesh, surface_of(mesh)


def test_the_field_between_voxels(ball: tuple[trimesh.Trimesh, FieldLookup]) -> None:
    surface = ball[1]
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(400, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = rng.uniform(-1.5, 1.5, 400) * VOXEL_M
    points = normal * (0.05 + height)[:, None]
    at = surface(points)
    assert np.isfinite(at.distance_m).mean() > 0.9
    known = np.isfinite(at.distance_m)
    assert np.sqrt(np.mean((at.distance_m - height)[known] ** 2)) < 0.25 * VOXEL_M
    assert np.median(np.sum(at.gradient_G * normal, axis=1)[known]) == pytest.approx(1.0, abs=0.1)
    # the same numbers where the field's frame is another
    X_FG = make_pose(exp_so3([0.2, -0.4, 0.1]), [0.03, 0.01, -0.02])
    moved = replace(surface, X_FG=X_FG)(points @ X_FG[:3, :3] - X_FG[:3, :3].T @ X_FG[:3, 3])
    np.testing.assert_allclose(moved.distance_m, at.distance_m, atol=1e-9)
    np.testing.assert_allclose(moved.gradient_G @ X_FG[:3, :3].T, at.gradient_G, atol=1e-6)
    # the gradient is that of the distance
    step = 1e-7
    for axis in np.eye(3):
        slope = (surface(points + step * axis).distance_m - surface(points - step * axis).distance_m) / (
            2 * step
        )
        agree = np.isclose(slope, at.gradient_G @ axis, atol=1e-4) | np.isnan(slope)
        # but for points that lie on a voxel's face
        assert agree.mean() > 0.99
    assert np.isnan(surface(np.full((3, 3), 0.4)).distance_m).all()
    assert np.isnan(surface(np.full((1, 3), 1e9)).distance_m).all()


def test_a_pose_that_is_off_is_found_again_within_its_sigma(body: trimesh.Trimesh, seen: FieldLookup) -> None:
    nees, errors = [], []
    for seed in range(8):
        depth, truth, wrong = view(body, seed)
        found = aligned(depth, wrong, seen)
        assert found.refused is None
        error = off(found.apply(wrong), truth)
        nees.append(error @ np.linalg.solve(found.covariance_G, error))
        errors.append(error)
        # no direction is known worse than before
        assert np.linalg.eigvalsh(PRIOR - found.covariance_G).min() > -1e-3 * SHIFT_M**2
    # six would be right for errors of depth that are alike over 12 px; these are independent
    assert np.mean(nees) < 6.0
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert rms[:3].max() < 0.15 * SHIFT_M and rms[3:].max() < 0.35 * TURN_RAD
    # directions that are exact stay so
    depth, truth, _ = view(body, 4)
    prior = np.diag([0.0, 0.0, SHIFT_M**2, 0.0, 0.0, 0.0])
    found = aligned(depth, truth @ make_pose(np.eye(3), [0.0, 0.0, 4e-3]), seen, prior)
    assert found.refused is None
    np.testing.assert_allclose(found.correction, [0, 0, -4e-3, 0, 0, 0], atol=5e-4)
    np.testing.assert_allclose(found.correction[[0, 1, 3, 4, 5]], 0.0, atol=1e-15)
    # holes of nan cost nothing else
    depth, truth, wrong = view(body, 1)
    bad = np.random.default_rng(0).random(depth.depth_m.shape) < 0.5
    found = aligned(
        replace(depth, depth_m=np.where(bad, np.nan, depth.depth_m).astype(np.float32)), wrong, seen
    )
    assert found.refused is None and np.isfinite(found.covariance_G).all()
    assert np.linalg.norm(off(found.apply(wrong), truth)[:3]) < 0.8e-3


def test_a_balls_turn_stays_at_the_prior(ball: tuple[trimesh.Trimesh, FieldLookup]) -> None:
    depth, truth, wrong = view(ball[0], 3)
    found = aligned(depth, wrong, ball[1])
    assert found.refused is None
    # the shift that a turn about the origin leaves alone is found, and the turn is not touched
    assert np.linalg.norm(off(found.apply(wrong), truth)[:3]) < 0.3e-3
    assert np.linalg.norm(found.correction[3:]) < 0.15 * TURN_RAD
    sigma = np.sqrt(np.diag(found.covariance_G))
    # the noise of the gradients feigns a little
    assert sigma[:3].max() < 0.2 * SHIFT_M and sigma[3:].min() > 0.75 * TURN_RAD


def test_sliding_on_a_plane_stays_at_the_prior() -> None:
    rng = np.random.default_rng(0)

    def plane(p_G: Array) -> FieldSamples:
        normal = np.tile([0.0, 0.0, 1.0], (len(p_G), 1))
        return FieldSamples(p_G[:, 2].copy(), normal, np.full(len(p_G), 1e-8))

    p_G = np.column_stack([rng.uniform(-0.1, 0.1, (2000, 2)), rng.normal(2e-3, 1e-3, 2000)])
    found = align(DepthPoints(p_G, np.full(2000, 1e-6), 0.1), PRIOR, plane, SHARE)
    assert found.refused is None
    np.testing.assert_allclose(found.correction[[0, 1, 5]], 0.0, atol=1e-4)
    assert found.correction[2] == pytest.approx(2e-3, abs=2e-4)
    sigma = np.sqrt(np.diag(found.covariance_G))
    np.testing.assert_allclose(sigma[[0, 1, 5]], [SHIFT_M, SHIFT_M, TURN_RAD], rtol=0.02)
    assert sigma[2] < 0.1 * SHIFT_M and sigma[[3, 4]].max() < 0.2 * TURN_RAD


def test_depth_that_is_wrong_in_a_third_of_the_image(body: trimesh.Trimesh, seen: FieldLookup) -> None:
    for seed in range(2):
        depth, truth, wrong = view(body, seed)
        rng = np.random.default_rng(seed)
        # some far off, some by as much as the field reaches
        scale = np.where(rng.random(depth.depth_m.shape) < 0.5, 6e-3, 0.1)
        bad = rng.random(depth.depth_m.shape) < 0.3
        broken = np.where(bad, depth.depth_m + scale * rng.uniform(-0.2, 1.0, bad.shape), depth.depth_m)
        found = aligned(replace(depth, depth_m=broken.astype(np.float32)), wrong, seen)
        error = off(found.apply(wrong), truth)
        assert found.refused is None
        assert error @ np.linalg.solve(found.covariance_G, error) < 17.0
        assert np.linalg.norm(error[:3]) < 1e-3


def test_what_is_refused_leaves_the_pose_as_it_was(body: trimesh.Trimesh, seen: FieldLookup) -> None:
    depth, truth, wrong = view(body, 2)
    elsewhere = wrong @ make_pose(np.eye(3), [0.5, 0.0, 0.0])
    for X_RG, prior, why in (
        (elsewhere, PRIOR, "too little of it lies near known surface"),
        (truth @ make_pose(np.eye(3), [0.0, 0.0, 5e-3]), PRIOR * 0.07, "it contradicts the motion"),
        (truth @ make_pose(np.eye(3), [4e-3, 4e-3, 4e-3]), PRIOR * 0.01, "it does not fit the surface"),
    ):
        found = aligned(depth, X_RG, seen, prior)
        assert found.refused == why
        np.testing.assert_array_equal(found.apply(X_RG), X_RG)
        np.testing.assert_array_equal(found.covariance_G, prior)


def test_doubtful_frames_are_aligned_before_the_surface_is_made(body: trimesh.Trimesh) -> None:
    exact = views_of(body, 24, sigma_m=1e-3, rig=FINE_RIG)
    rng = np.random.default_rng(0)
    covariance, frames = np.tile(1e-10 * np.eye(6), (24, 1, 1)), list(exact)
    for k in range(0, 24, 3):
        wrong = make_pose(exp_so3(rng.normal(0.0, TURN_RAD, 3)), rng.normal(0.0, SHIFT_M, 3))
        covariance[k], frames[k] = PRIOR, (exact[k][0], exact[k][1] @ wrong)
    left = fuse(frames, FINE_RIG, CONFIG.model_copy(update={"align": False}), covariance_G=covariance)
    found = fuse(frames, FINE_RIG, CONFIG, covariance_G=covariance)
    best = fuse(exact, FINE_RIG, CONFIG)
    error = [distance_to_surface(body, np.asarray(s.mesh.vertices)).mean() for s in (left, found, best)]
    assert error[1] - error[2] < 0.45 * (error[0] - error[2])
    assert left.aligned is None and best.aligned is None and found.aligned is not None
    assert found.aligned.doubtful == 8
    np.testing.assert_array_equal(found.aligned.frames, np.arange(0, 24, 3))
    poses = found.aligned.put_into(np.stack([X for _, X in frames]))
    for k, (_, X_RG) in enumerate(exact):
        assert np.linalg.norm(off(poses[k], X_RG)[:3]) < (1e-3 if k % 3 == 0 else 1e-12)
    # where no pose is in doubt nothing changes
    frames = exact[:8]
    covariance = np.tile(0.003 * PRIOR, (8, 1, 1))
    off_, on = (
        fuse(frames, FINE_RIG, CONFIG.model_copy(update={"align": align}), covariance_G=covariance)
        for align in (False, True)
    )
    assert on.aligned is None
    np.testing.assert_array_equal(on.mesh.vertices, off_.mesh.vertices)
    np.testing.assert_array_equal(on.sigma_m, off_.sigma_m)
    # where every pose is in doubt there is nothing to align to
    found = fuse(frames, FINE_RIG, CONFIG, covariance_G=np.tile(PRIOR, (8, 1, 1)))
    assert found.aligned is not None and found.aligned.doubtful == 8
    assert len(found.aligned.frames) == 0 and found.aligned.X_RG.shape == (0, 4, 4)
