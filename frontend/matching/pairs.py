"""Matching of frame pairs without prior motion: relative poses and inlier matches (thesis algorithm 2, lines
9-13).

Not only neighbours are matched: landmarks must be recognised after a revolution, since the inertia depends on
it, and other pairs bridge neighbours that cannot be matched. For long sequences ``retrieval`` proposes the
pairs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.methods import match_method
from polhode.frontend.matching.ransac import ransac_rigid
from polhode.lie import Array
from polhode.processes import in_order
from polhode.records import Ints, RelativePoses

Tick = Callable[[], None]


@dataclass(frozen=True)
class PairMatch:
    """The motion between frames i < j, and the matches that agree with it."""

    i: int
    j: int
    X_RiRj: Array
    """(4, 4)"""
    features: Ints
    """(m, 2) indices into the features of i and of j"""


def match_pairs(
    frames: Sequence[StereoFeatures],
    partners: Sequence[Ints],
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
    workers: int,
    tick: Tick,
) -> list[PairMatch]:
    """Matches that pass the geometric check, sorted by (i, j).

    partners: for each frame i, the frames j > i to match it with. ``tick`` is called once per frame i. The
    random numbers of a pair depend on (seed, i, j) only, so the result does not depend on the number of
    workers.
    """
    matches: list[PairMatch] = []
    for found in in_order(_RowJob(frames, partners, rig, config, seed), range(len(frames)), workers):
        matches.extend(found)
        tick()
    return matches


@dataclass(frozen=True)
class _RowJob:
    """Matches frame i with its partners."""

    frames: Sequence[StereoFeatures]
    partners: Sequence[Ints]
    rig: RectifiedRig
    config: Frontend
    seed: int

    def __call__(self, i: int) -> list[PairMatch]:
        later = self.partners[i].tolist()
        found = (_match_pair(i, j, self.frames, self.rig, self.config, self.seed) for j in later)
        return [match for match in found if match is not None]


def _match_pair(
    i: int,
    j: int,
    frames: Sequence[StereoFeatures],
    rig: RectifiedRig,
    config: Frontend,
    seed: int,
) -> PairMatch | None:
    pairing = config.pairs
    if min(len(frames[i]), len(frames[j])) < pairing.min_inliers:
        return None
    pairs = match_method(config)(frames[i], frames[j]).features
    if len(pairs) < pairing.min_inliers:
        return None
    fit = ransac_rigid(
        frames[i].uvd_px[pairs[:, 0]],
        frames[i].p_R[pairs[:, 0]],
        frames[j].p_R[pairs[:, 1]],
        rig,
        pairing.hypotheses,
        pairing.gate_px,
        np.random.default_rng([seed, i, j]),
    )
    if fit.inlier.sum() < pairing.min_inliers:
        return None
    return PairMatch(i, j, fit.X_RiRj, pairs[fit.inlier])


def relative_poses(matches: Sequence[PairMatch]) -> RelativePoses:
    """The relative poses of the matched pairs, for the back end."""
    return RelativePoses(
        i=np.array([m.i for m in matches], dtype=np.int64),
        j=np.array([m.j for m in matches], dtype=np.int64),
        X_RiRj=np.array([m.X_RiRj for m in matches]).reshape(-1, 4, 4),
        inliers=np.array([len(m.features) for m in matches], dtype=np.int64),
    )
