"""Two methods side by side: nothing of one is ever taken for the other, and both keep what they know."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.config.frontend_settings import Features, Frontend, GuidedMatching, PairMatching
from polhode.frontend.matching.nearest import MutualNearest
from polhode.frontend.matching.pairs import (
    MAX_NEIGHBOUR_STEPS,
    MAX_VIEW_ANGLE_DEG,
    combine_features,
    frame_vectors,
    is_from_second,
    match_pairs,
    offset_matches,
    pairs_in_view,
)
from polhode.frontend.tracks.guided_matching import reconnect
from polhode.frontend.tracks.tracks import join_matches
from polhode.geometry.lie import Array, Ints, exp_so3, inverse_pose, make_pose
from polhode.records.estimate import InitialMotion
from tests.frontend.feature_world import RIG, World, first_features, make_world

PARTNERS: list[Ints] = [np.arange(i + 1, 12, dtype=np.int64) for i in range(12)]


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(n_frames=12, turn_deg=15.0)


def test_what_each_method_knows_stays_with_its_features(world: World) -> None:
    first, second = world.frames[0], world.frames[1]
    second, n = replace(second, R_RS=np.tile(np.eye(3), (len(second), 1, 1))), len(first)
    (both,) = combine_features([first], [second])
    for name in ("uvd_px", "sigma_px", "p_R"):
        expected = np.concatenate([getattr(first, name), getattr(second, name)])
        np.testing.assert_array_equal(getattr(both, name), expected)
    assert not both.on_surface[:n].any() and both.on_surface[n:].all()
    np.testing.assert_allclose(np.linalg.norm(both.descriptors, axis=1), 1.0, atol=1e-5)
    assert np.all(both.descriptors[:n] @ both.descriptors[n:].T == 0.0)
    (unknown,) = combine_features([first], world.frames[1:2])
    assert not unknown.on_surface.any()
    # the same features twice: without blocks of their own the nearest neighbour were the twin
    a, b = combine_features(world.frames[:2], world.frames[:2])
    pairs = MutualNearest(Frontend())(a, b).features
    of_first = pairs < np.array([len(world.frames[0]), len(world.frames[1])])
    assert len(pairs) > 20 and np.array_equal(of_first[:, 0], of_first[:, 1])


def test_matches_of_both_make_tracks_of_their_own(world: World) -> None:
    matches = match_pairs(world.frames, PARTNERS, RIG, Frontend(), 0, 1, lambda: None)
    both = combine_features(world.frames, world.frames)
    joined = join_matches(both, [*matches, *offset_matches(matches, world.frames)])
    alone = join_matches(world.frames, matches)
    for label, single, frame in zip(joined.landmark, alone.landmark, world.frames, strict=True):
        n = len(frame)
        np.testing.assert_array_equal(label[:n] >= 0, single >= 0)
        np.testing.assert_array_equal(label[n:] >= 0, single >= 0)
        assert not np.intersect1d(label[:n][single >= 0], label[n:][single >= 0]).size
    assert joined.n_landmarks == 2 * alone.n_landmarks


def test_a_lost_frame_is_found_by_the_landmarks_of_both(world: World) -> None:
    """Half of each frame's features know no surface, half do, with axes that turn with the body; of one frame
    the second method sees nothing."""
    X_RG = world.X_RG
    second = [
        replace(frame, R_RS=np.tile(X[:3, :3], (len(frame), 1, 1)))
        for frame, X in zip(world.frames, X_RG, strict=True)
    ]
    second[3] = first_features(second[3], 0, width=64)
    frames = combine_features(world.frames, second)
    matches = match_pairs(world.frames, PARTNERS, RIG, Frontend(), 0, 1, lambda: None)
    others = [m for m in offset_matches(matches, world.frames) if 3 not in (m.i, m.j)]
    assert all(is_from_second(m, world.frames) for m in others)
    assert not any(is_from_second(m, world.frames) for m in matches)
    association = join_matches(frames, [m for m in [*matches, *others] if 5 not in (m.i, m.j)])
    found = reconnect(frames, association, InitialMotion(X_RG, np.arange(12) != 5), RIG, GuidedMatching(), 0)
    assert found.motion.connected.all()
    n = len(world.frames[5])
    shown = found.association.landmark[5] >= 0
    assert shown[:n].sum() >= 10 and shown[n:].sum() >= 10


def test_frames_that_a_method_sees_nothing_of_are_as_wide_as_the_others(world: World) -> None:
    some = world.frames
    wide, narrow = (first_features(some[0], 0, width) for width in (64, 7))
    both = combine_features([some[0], wide, some[2]], [narrow, some[1], narrow])
    assert {frame.descriptors.shape[1] for frame in both} == {2 * some[0].descriptors.shape[1]}
    assert [len(frame) for frame in both] == [len(some[k]) for k in range(3)]
    assert frame_vectors(both, 0).shape[0] == 3
    nothing = combine_features([wide], [narrow])
    assert len(nothing[0]) == 0 and nothing[0].on_surface.shape == (0,)


def _turning(n: int, step_deg: float) -> Array:
    angles = np.deg2rad(step_deg) * np.arange(n)
    return make_pose(exp_so3(angles[:, None] * np.array([0.0, 1.0, 0.0])), np.tile([0.0, 0.0, 1.0], (n, 1)))


def test_frames_of_the_same_side_are_tried_and_neighbours_always() -> None:
    for i, later in enumerate(pairs_in_view(_turning(36, 20.0), PairMatching())):
        steps = np.arange(i + 1, 36) - i
        angle = np.abs(steps * 20.0 + 180.0) % 360.0 - 180.0
        expected = (np.abs(angle) < MAX_VIEW_ANGLE_DEG) | (steps <= MAX_NEIGHBOUR_STEPS)
        assert later.tolist() == (i + 1 + np.flatnonzero(expected)).tolist()
    # of a long sequence few pairs are tried and loops are closed
    config = PairMatching(exhaustive_frames=30, neighbours=2, retrieved=6)
    partners = pairs_in_view(_turning(180, 15.0), config)
    assert sum(map(len, partners)) < 180 * 10
    towards = np.concatenate([later - i for i, later in enumerate(partners)])
    far = towards[towards > 2]
    assert len(far) > 180 and np.all(np.minimum(far % 24, 24 - far % 24) <= 4)
    # two frames that look at the same side from twice the distance see the same
    near, distant = (make_pose(np.eye(3), np.array([0.0, 0.0, z])) for z in (1.0, 2.0))
    behind = make_pose(exp_so3(np.array([0.0, np.pi, 0.0])), np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(inverse_pose(behind)[:3, 3], [0.0, 0.0, 1.0], atol=1e-12)
    for last, seen in ((distant, 1), (behind, 0)):
        partners = pairs_in_view(np.stack([near, *[behind] * MAX_NEIGHBOUR_STEPS, last]), PairMatching())
        assert partners[0].tolist() == list(range(1, MAX_NEIGHBOUR_STEPS + 1 + seen))


def test_the_second_method_comes_with_its_own_matcher() -> None:
    second = Frontend().second_method
    assert second is not None and second.features.method == second.matcher == "polhode"
    assert second.second_method is None
    for features in (Features(method="polhode"), Features(second=None)):
        assert Frontend(features=features).second_method is None
    other = Frontend(features=Features(method="polhode", second="rootsift")).second_method
    assert other is not None and other.matcher == "nearest"
