"""Parts of a sequence that no landmark connects are reported; a whole one and a weak last frame are not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polhode.pipeline.data_checks.pose_checks import connection_check
from polhode.pipeline.run_directory.verdict import reasons_of
from polhode.records import StereoTracks
from polhode.simulation.monte_carlo import SyntheticScene, SyntheticSequence, generate

FRAMES, PLACE = 20, 9
MIN_LANDMARKS = 6


@pytest.fixture(scope="module")
def sequence() -> SyntheticSequence:
    return generate(SyntheticScene(frames=FRAMES, landmarks=60, detection=0.9), 0)


class Agreeing:
    """The part of an estimate that the check reads: all observations agree."""

    def __init__(self, tracks: StereoTracks) -> None:
        self.inlier_weight = np.ones(len(tracks.frame))


def parted(tracks: StereoTracks, place: int, kept: int) -> StereoTracks:
    """After frame ``place`` other landmarks are seen, but for ``kept`` of them."""
    before, after = (
        np.unique(tracks.landmark[side]) for side in (tracks.frame <= place, tracks.frame > place)
    )
    common = np.intersect1d(before, after)[kept:]
    other = (tracks.frame > place) & np.isin(tracks.landmark, common)
    landmark = np.where(other, tracks.landmark + tracks.n_landmarks, tracks.landmark)
    return replace(tracks, landmark=np.unique(landmark, return_inverse=True)[1].astype(np.int64))


def reported(tracks: StereoTracks) -> list[str]:
    estimate: Any = Agreeing(tracks)
    return reasons_of([connection_check(tracks, estimate)])


@pytest.mark.parametrize("kept", [0, MIN_LANDMARKS - 1])
def test_parts_that_share_few_landmarks_are_reported(sequence: SyntheticSequence, kept: int) -> None:
    tracks = parted(sequence.tracks, PLACE, kept)
    (words,) = reported(tracks)
    start, end = (sequence.tracks.time_s[k] for k in (PLACE, PLACE + 1))
    assert f"before {start:g} s and after {end:g} s share {kept or 'no'} landmarks" in words


@pytest.mark.parametrize(("place", "kept"), [(PLACE, MIN_LANDMARKS), (FRAMES - 2, 0), (0, 0)])
def test_a_connected_sequence_is_not(sequence: SyntheticSequence, place: int, kept: int) -> None:
    assert reported(sequence.tracks) == []
    assert reported(parted(sequence.tracks, place, kept)) == []


def test_a_few_frames_have_no_parts(sequence: SyntheticSequence) -> None:
    few = sequence.tracks.frame < 4
    tracks = replace(
        sequence.tracks,
        frame=sequence.tracks.frame[few],
        landmark=np.unique(sequence.tracks.landmark[few], return_inverse=True)[1].astype(np.int64),
        uvd_px=sequence.tracks.uvd_px[few],
        sigma_px=sequence.tracks.sigma_px[few],
    )
    assert reported(tracks) == []
