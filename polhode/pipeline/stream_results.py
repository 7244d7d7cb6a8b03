"""What a stream has found already, for the batch that follows: features, links, the states of each pair."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polhode.files.record_files import digest_of
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.frontend.rectification import Rectifier
from polhode.geometry.lie import Ints
from polhode.records.estimate import OnlineEstimate
from polhode.run_directory.finished_stages import StageStore
from polhode.run_directory.live_states import LiveRow


@dataclass(frozen=True)
class Observations:
    """What one frame of a long stream observes; in single precision, 3e-5 px in the widest images."""

    landmark: NDArray[np.int32]
    """(m,)"""
    uvd_px: NDArray[np.float32]
    """(m, 3)"""
    sigma_px: NDArray[np.float32]
    """(m, 3)"""


def observations_of(features: StereoFeatures, landmark: Ints) -> Observations:
    """The observations that a frame's features (m) with their landmarks (m,) are."""
    return Observations(
        landmark.astype(np.int32), features.uvd_px.astype(np.float32), features.sigma_px.astype(np.float32)
    )


@dataclass(frozen=True)
class Streamed:
    """Of the F pairs of a stream, in their order."""

    timestamps_ns: Ints
    """(F,)"""
    features: Sequence[StereoFeatures]
    """Of all frames; of a long stream those of ``key_frames``"""
    tried: Mapping[tuple[int, int], PairMatch | None]
    """Frames i < j that were matched; None: they do not fit"""
    surroundings: bool
    """Whether dim surroundings were left out of the masks"""
    online: OnlineEstimate
    """One row for each pair"""
    warnings: tuple[str, ...]
    """What became of late, missing, repeated and dropped pairs, one line each"""
    key_frames: Ints
    """(K,) ascending: frames with features; all frames unless the stream is long"""
    observations: Sequence[Observations]
    """Of a long stream, of each frame; empty otherwise"""
    live: tuple[LiveRow, ...]
    """What was said of each pair when it came"""
    depth: StageStore | None = None
    """Depth maps of some of the pairs, by the number of the pair"""

    @property
    def found_from(self) -> int:
        """First frame of those whose poses in ``online`` are in the last frame G."""
        return int(np.argmax(self.online.frame == self.online.frame[-1]))

    @property
    def content_digest(self) -> str:
        """Of what the results of a run depend on."""
        motion = self.online, self.key_frames, self.observations
        return digest_of(self.timestamps_ns, self.features, self.tried, self.surroundings, motion)

    def fits(self, timestamps_ns: Ints, rectifier: Rectifier) -> bool:
        """Whether the features are those that these pairs would give with this rectifier's masks."""
        return (
            np.array_equal(self.timestamps_ns, timestamps_ns)
            and rectifier.found is None
            and rectifier.surroundings == self.surroundings
        )

    def untried(self, partners: Sequence[Ints]) -> list[Ints]:
        """Of the partners j > i of each frame i, those that were not matched yet."""
        return [
            np.array([j for j in row.tolist() if (i, j) not in self.tried], dtype=np.int64)
            for i, row in enumerate(partners)
        ]

    def with_found(self, matches: Sequence[PairMatch]) -> list[PairMatch]:
        """These matches and those of the stream, sorted by (i, j)."""
        known = [match for match in self.tried.values() if match is not None]
        return sorted([*matches, *known], key=lambda match: (match.i, match.j))
