"""Landmarks of a stream are given once, by the matches with earlier frames."""

import numpy as np

from polhode.frontend.matching.pairs import PairMatch
from polhode.frontend.tracks.causal_tracks import CausalTracks


def match(i: int, j: int, *pairs: tuple[int, int]) -> PairMatch:
    return PairMatch(i, j, np.eye(4), np.array(pairs, dtype=np.int64))


def test_a_matched_feature_is_of_the_landmark_of_its_match() -> None:
    tracks = CausalTracks()
    assert tracks.add(3, []).tolist() == [0, 1, 2]
    assert tracks.add(3, [match(0, 1, (2, 0), (0, 2))]).tolist() == [2, 3, 0]
    assert tracks.add(2, [match(1, 2, (1, 1))]).tolist() == [4, 3]


def test_most_matches_decide_and_each_landmark_is_seen_once() -> None:
    tracks = CausalTracks()
    tracks.add(2, [])
    tracks.add(2, [match(0, 1, (0, 0))])  # 0, 2
    tracks.add(1, [match(0, 2, (0, 0))])  # 0
    # feature 0: twice landmark 0, once landmark 1; feature 1: once landmark 0, which is taken
    labels = tracks.add(
        2, [match(0, 3, (1, 0)), match(1, 3, (0, 0)), match(2, 3, (0, 1)), match(0, 3, (0, 0))]
    )
    assert labels[0] == 0 and labels[1] not in (0, 1, 2)
    assert len(set(labels.tolist())) == 2


def test_of_equal_votes_the_older_landmark_counts() -> None:
    tracks = CausalTracks()
    tracks.add(1, [])
    tracks.add(1, [])
    assert tracks.add(1, [match(0, 2, (0, 0)), match(1, 2, (0, 0))]).tolist() == [0]
