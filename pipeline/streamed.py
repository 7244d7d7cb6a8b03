"""What a stream has found already, for the batch that follows: features, links, the states of each pair."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.pairs import PairMatch
from polhode.frontend.rectification import Rectifier
from polhode.pipeline.depth_maps import DepthStore
from polhode.records import Ints, OnlineEstimate


@dataclass(frozen=True)
class Streamed:
    """Of the F pairs of a stream, in their order."""

    timestamps_ns: Ints
    """(F,)"""
    features: Sequence[StereoFeatures]
    tried: Mapping[tuple[int, int], PairMatch | None]
    """Frames i < j that were matched; None: they do not fit"""
    surroundings: bool
    """Whether dim surroundings were left out of the masks"""
    online: OnlineEstimate
    """One row for each pair"""
    warnings: tuple[str, ...]
    """What became of late, missing, repeated and dropped pairs, one line each"""
    depth: DepthStore | None = None
    """Depth maps of some of the pairs"""

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
