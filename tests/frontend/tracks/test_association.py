"""Blind matching, tracks and guided association on a tumbling cloud of points with known truth."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from polhode.config.frontend_settings import Frontend, GuidedMatching, Tracks
from polhode.frontend.matching.matchers import DualSoftmax
from polhode.frontend.matching.pairs import PairMatch, match_pairs, pairs_to_match, relative_poses
from polhode.frontend.matching.ransac import NOISE_PX, fit_noisy, ransac_rigid
from polhode.frontend.tracks.guided_matching import consistent_matches, match_improbability, reconnect
from polhode.frontend.tracks.tracks import (
    Association,
    LandmarkMap,
    add_observations,
    descriptor_distance,
    join_matches,
    to_tracks,
    viewing_direction,
)
from polhode.geometry.lie import Array, exp_so3, hat, inverse_pose, log_so3, make_pose, transform_points
from polhode.records.estimate import InitialMotion
from tests.frontend.feature_world import RIG, World, make_world, purity


@pytest.fixture(scope="module")
def world() -> World:
    return make_world()


def test_ransac_finds_the_motion_among_half_outliers() -> None:
    rng = np.random.default_rng(2)
    X_ij = make_pose(exp_so3([0.1, 0.5, 0.0]), [0.01, 0.0, 0.02])
    p_Rj = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.7], (60, 3))
    uvd_i = RIG.project(transform_points(X_ij, p_Rj)) + rng.normal(size=(60, 3)) * [0.3, 0.3, 0.1]
    uvd_i[:30] += rng.uniform(-60, 60, (30, 3)) * [1.0, 1.0, 0.3]
    fit = ransac_rigid(uvd_i, RIG.triangulate(uvd_i), p_Rj, RIG, np.random.default_rng(3))
    assert fit.inlier[30:].mean() > 0.9
    assert fit.inlier[:30].sum() <= 1
    assert np.rad2deg(np.linalg.norm(log_so3(fit.X_RiRj[:3, :3].T @ X_ij[:3, :3]))) < 0.5


def test_a_wild_point_does_not_bend_the_fit() -> None:
    rng = np.random.default_rng(5)
    p = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.7], (30, 3))
    wild = p.copy()
    wild[0] += [0.0, 0.1, 0.0]
    np.testing.assert_allclose(fit_noisy(np.eye(4), wild, p, RIG), np.eye(4), atol=1e-3)


def test_the_error_of_a_motion_is_as_small_as_the_noise_of_both_frames_allows() -> None:
    """Depth is the weak direction of each frame, and the frames are 45 degrees apart: errors (6,) have the
    covariance of least squares with the right weights."""
    rng = np.random.default_rng(8)
    R = exp_so3([0.1, np.deg2rad(45.0), -0.2])
    middle = np.array([0.0, 0.0, 0.7])
    X_AB, squares = make_pose(R, middle - R @ middle), []
    for _ in range(120):
        p_B = rng.normal(middle, 0.1, (60, 3))
        p_A = transform_points(X_AB, p_B)
        seen = [RIG.triangulate(RIG.project(p) + NOISE_PX * rng.normal(size=p.shape)) for p in (p_A, p_B)]
        A, B = (NOISE_PX * RIG.triangulation_jacobian(p) for p in (p_A, p_B))
        W = np.linalg.inv(A @ np.swapaxes(A, 1, 2) + R @ B @ np.swapaxes(B, 1, 2) @ R.T)
        by_motion = np.concatenate([-hat(p_A), np.tile(np.eye(3), (60, 1, 1))], axis=2)
        information = np.sum(np.swapaxes(by_motion, 1, 2) @ W @ by_motion, axis=0)
        D = fit_noisy(X_AB, seen[0], seen[1], RIG) @ inverse_pose(X_AB)
        error = np.concatenate([log_so3(D[:3, :3]), D[:3, 3]])
        squares.append(error @ information @ error)
    # a mean of 720 squares of variance 2
    assert np.mean(squares) / 6.0 == pytest.approx(1.0, abs=0.13)


def test_probabilities_of_the_allowed_pairs_are_those_of_the_dual_softmax() -> None:
    torch.manual_seed(3)
    a, b = (torch.nn.functional.normalize(torch.randn(k, 8), dim=1) for k in (4, 5))
    feature, landmark = (index.ravel() for index in np.indices((4, 5)))
    distance = torch.cdist(a, b).numpy().astype(np.float64)[feature, landmark]
    expected = 1.0 - DualSoftmax()(a, b).detach().exp().numpy()[feature, landmark]
    np.testing.assert_allclose(match_improbability(distance, feature, landmark), expected, atol=1e-4)
    # the rivals that the prediction rules out do not count
    alone = match_improbability(distance[:1], feature[:1], landmark[:1])
    assert alone[0] <= expected[0] + 1e-6


def test_a_surface_that_lies_otherwise_is_another_one(world: World) -> None:
    axes = np.tile(np.eye(3), (len(world.frames[0]), 1, 1))
    features = replace(world.frames[0], R_RS=axes)
    model, every = LandmarkMap.empty(len(features)), np.arange(len(features))
    add_observations(model, features, every, world.X_RG[0], RIG)
    direction = viewing_direction(features.p_R, world.X_RG[0])
    for turn_deg, same in ((0.0, True), (30.0, True), (70.0, False)):
        turned = replace(features, R_RS=axes @ exp_so3([0.0, 0.0, np.deg2rad(turn_deg)]))
        config, X_RG = GuidedMatching(), world.X_RG[0]
        distance = descriptor_distance(model, every, turned, direction, every, every, config, X_RG)
        assert np.isfinite(distance).all() == same and np.isinf(distance).all() != same


def match_everything(world: World, workers: int) -> list[PairMatch]:
    partners = pairs_to_match(world.frames, Frontend().pairs, 0)
    return match_pairs(world.frames, partners, RIG, Frontend(), 0, workers, lambda: None)


@pytest.fixture(scope="module")
def matches(world: World) -> list[PairMatch]:
    return match_everything(world, 1)


def test_blind_links_are_right_and_do_not_depend_on_the_workers(
    world: World, matches: list[PairMatch]
) -> None:
    runs = [matches, match_everything(world, 2)]
    for match in matches:
        X_true = world.X_RG[match.i] @ inverse_pose(world.X_RG[match.j])
        assert np.rad2deg(np.linalg.norm(log_so3(match.X_RiRj[:3, :3].T @ X_true[:3, :3]))) < 3.0
    assert {(m.i, m.j) for m in matches} >= {(k, k + 1) for k in range(23)} | {(k, k + 12) for k in range(12)}
    first, second = (relative_poses(run) for run in runs)
    np.testing.assert_array_equal(first.X_RiRj, second.X_RiRj)
    np.testing.assert_array_equal(first.inliers, second.inliers)


def test_a_landmark_seen_again_a_revolution_later_is_the_same_landmark(
    world: World, matches: list[PairMatch]
) -> None:
    association = join_matches(world.frames, matches)
    assert purity(list(association.landmark), world.shown) > 0.99
    returned = [np.intersect1d(association.landmark[k], association.landmark[k + 12]) for k in range(12)]
    assert min(np.sum(common >= 0) for common in returned) > 30
    for labels in association.landmark:
        used = labels[labels >= 0]
        assert len(np.unique(used)) == len(used)


def test_matches_that_the_motion_contradicts_are_dropped(world: World, matches: list[PairMatch]) -> None:
    shuffled = np.random.default_rng(1).permutation(matches[0].features[:, 1])
    wrong = replace(matches[0], features=np.column_stack([matches[0].features[:, 0], shuffled]))
    motion = InitialMotion(world.X_RG, np.ones(24, dtype=bool))
    kept = consistent_matches([matches[0], wrong], world.frames, motion, RIG, 5.0)
    assert len(kept[0].features) > 0.95 * len(matches[0].features)
    assert sum(len(m.features) for m in kept[1:]) < 0.2 * len(wrong.features)
    lost = InitialMotion(world.X_RG, np.arange(24) != matches[0].i)
    assert consistent_matches([matches[0]], world.frames, lost, RIG, 5.0) == []


def lost_frames(
    world: World, matches: list[PairMatch], turned: dict[int, Array]
) -> tuple[Association, InitialMotion]:
    """The blind association without the named frames, and a motion that predicts them turned."""
    connected = np.ones(24, dtype=bool)
    connected[list(turned)] = False
    X_RG = world.X_RG.copy()
    for k, rotation in turned.items():
        X_RG[k, :3, :3] = X_RG[k, :3, :3] @ rotation
    motion = InitialMotion(X_RG, connected)
    return join_matches(world.frames, consistent_matches(matches, world.frames, motion, RIG, 5.0)), motion


def test_lost_frames_are_found_near_their_predicted_pose(world: World, matches: list[PairMatch]) -> None:
    rng = np.random.default_rng(5)
    turned = {k: exp_so3(rng.normal(size=3) * np.deg2rad(2.0)) for k in (7, 13)}
    association, motion = lost_frames(world, matches, turned)
    assert np.all(association.landmark[7] == -1)
    found = reconnect(world.frames, association, motion, RIG, GuidedMatching(), 0)
    assert found.motion.connected.all()
    error = log_so3(np.swapaxes(found.motion.X_RG[:, :3, :3], 1, 2) @ world.X_RG[:, :3, :3])
    assert np.rad2deg(np.linalg.norm(error, axis=1)).max() < 0.5
    assert purity(list(found.association.landmark), world.shown) > 0.99
    counts = [np.sum(labels >= 0) for labels in found.association.landmark]
    assert min(counts[7], counts[13]) > 0.7 * np.median(counts)


def test_a_wrong_prediction_is_not_locked_in(world: World, matches: list[PairMatch]) -> None:
    association, motion = lost_frames(world, matches, {9: exp_so3([0.0, 0.0, np.pi / 2])})
    found = reconnect(world.frames, association, motion, RIG, GuidedMatching(), 0)
    assert not found.motion.connected[9]
    assert np.all(found.association.landmark[9] == -1)


def test_the_longest_tracks_are_kept_until_every_frame_has_enough(
    world: World, matches: list[PairMatch]
) -> None:
    association = join_matches(world.frames, matches)
    stamps = (np.arange(24) * 500_000_000).astype(np.int64)
    still = np.tile(np.eye(4), (24, 1, 1))
    few, everything = (
        to_tracks(world.frames, association, RIG, stamps, still, Tracks(enough_per_frame=n))
        for n in (20, 10**6)
    )
    assert np.bincount(few.frame, minlength=24).min() >= 20
    assert len(few.frame) < 0.7 * len(everything.frame)
    assert np.bincount(few.landmark).mean() > np.bincount(everything.landmark).mean()
    views = np.bincount(everything.landmark)
    assert views.min() >= 3
    assert everything.n_landmarks == len(views)
    assert len(everything.uvd_px) == len(everything.frame) == len(everything.sigma_px)
