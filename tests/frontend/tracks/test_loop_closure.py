"""Landmarks that are one are joined, those that are two stay two."""

from dataclasses import replace

import numpy as np
import pytest

from polhode.config.frontend_settings import GuidedMatching
from polhode.frontend.tracks.loop_closure import merge_duplicates
from polhode.frontend.tracks.tracks import Association
from polhode.geometry.lie import exp_so3
from polhode.records.estimate import InitialMotion
from tests.frontend.feature_world import RIG, World, make_world, purity

CONFIG = GuidedMatching(max_distance=0.8)
"""Descriptors of this world are noisier than those of images."""


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(n_frames=24, turn_deg=30.0)


def split_by_revolution(world: World) -> Association:
    """The truth, but what the second revolution saw has other names."""
    points = int(max(shown.max() for shown in world.shown)) + 1
    return Association(
        tuple(
            np.where(shown >= 0, shown + points * (k >= 12), -1).astype(np.int64)
            for k, shown in enumerate(world.shown)
        )
    )


def known_motion(world: World) -> InitialMotion:
    return InitialMotion(world.X_RG, np.ones(len(world.frames), dtype=bool))


def test_a_landmark_of_two_names_becomes_one(world: World) -> None:
    apart = split_by_revolution(world)
    merged = merge_duplicates(world.frames, apart, known_motion(world), RIG, CONFIG)
    names = [
        (merged.landmark[a][np.isin(world.shown[a], [point])], merged.landmark[b][world.shown[b] == point])
        for a, b in ((2, 14), (5, 17))
        for point in np.intersect1d(world.shown[a], world.shown[b])
        if point >= 0
    ]
    assert np.mean([first[0] == second[0] for first, second in names]) > 0.9
    assert purity(list(merged.landmark), world.shown) > 0.995
    # no frame shows one landmark twice
    for labels in merged.landmark:
        used = labels[labels >= 0]
        assert len(np.unique(used)) == len(used)


def test_what_looks_different_or_is_elsewhere_stays_apart(world: World) -> None:
    shuffled, apart = np.random.default_rng(4), split_by_revolution(world)
    frames = [
        replace(frame, descriptors=shuffled.permutation(frame.descriptors)) if k >= 12 else frame
        for k, frame in enumerate(world.frames)
    ]
    merged = merge_duplicates(frames, apart, known_motion(world), RIG, CONFIG)
    assert apart.n_landmarks - merged.n_landmarks < 0.02 * apart.n_landmarks
    # half of the sequence is turned by 8 degrees against the truth
    wrong = world.X_RG.copy()
    wrong[12:, :3, :3] = wrong[12:, :3, :3] @ exp_so3(np.deg2rad([0.0, 8.0, 3.0]))
    motion = InitialMotion(wrong, np.ones(24, dtype=bool))
    merged = merge_duplicates(world.frames, apart, motion, RIG, CONFIG)
    assert apart.n_landmarks - merged.n_landmarks < 0.05 * apart.n_landmarks
    # frames without a pose have no say
    nothing = InitialMotion(world.X_RG, np.zeros(24, dtype=bool))
    assert merge_duplicates(world.frames, apart, nothing, RIG, CONFIG) is apart
