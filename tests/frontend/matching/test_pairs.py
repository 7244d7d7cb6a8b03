"""Frames of a long sequence find the frames that show the same side, and the cost stays linear."""

import numpy as np
import pytest

from polhode.config.frontend_settings import Frontend, PairMatching
from polhode.frontend.matching.pairs import (
    frame_vectors,
    match_pairs,
    most_similar,
    pairs_to_match,
    relative_poses,
)
from tests.frontend.feature_world import RIG, World, first_features, make_world

REVOLUTION = 24
LONG = PairMatching(exhaustive_frames=30, neighbours=2, retrieved=6)


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(n_frames=96, turn_deg=360.0 / REVOLUTION)


def test_a_short_sequence_is_matched_all_against_all(world: World) -> None:
    partners = pairs_to_match(world.frames[:20], LONG, 0)
    assert [p.tolist() for p in partners] == [list(range(i + 1, 20)) for i in range(20)]


def test_what_looks_alike_is_the_same_side_in_other_revolutions(world: World) -> None:
    alike = most_similar(frame_vectors(world.frames, 0), 2, 4)
    turns = np.array([(j - i) % REVOLUTION for i, found in enumerate(alike) for j in found])
    away = np.minimum(turns, REVOLUTION - turns)
    # by chance 5 of 24 sides are as near
    assert np.mean(away <= 2) > 0.9


def test_a_long_sequence_tries_few_pairs_and_closes_its_loops(world: World) -> None:
    partners = pairs_to_match(world.frames, LONG, 0)
    assert sum(map(len, partners)) < 0.15 * 96 * 95 / 2
    assert all(np.all(later > i) for i, later in enumerate(partners))
    links = relative_poses(match_pairs(world.frames, partners, RIG, Frontend(), 0, 1, lambda: None))
    assert np.sum(links.j - links.i >= REVOLUTION - 2) > 60


def test_frames_without_features_are_no_obstacle(world: World) -> None:
    frames = [*world.frames[:3], first_features(world.frames[3], 0), *world.frames[4:40]]
    vectors = frame_vectors(frames, 0)
    assert not vectors[3].any() and np.isfinite(vectors).all()
    assert len(pairs_to_match(frames, LONG, 0)) == 40
