"""On which motion do matches agree? The vote of frontend/matching/matchers.py beside others.

    python -m benchmarks.frontend.votes [--methods METHOD ...] [--short] [--record FILE]

Scenes, pairs and methods are those of benchmarks/frontend/matching.py, whose record knows the light. Pairs of
features that may match propose a motion each, and that with most support among the others is refined first.
The votes differ in what agrees, and in what counts:

    pairs       rotations, distances and places agree; a supporter counts by the supporters in common: this is
                the program's own vote
    single      the same, where each supporter counts by itself
    spectral    the same, by the leading eigenvector of the agreement (Leordeanu and Hebert 2005)
    distances   the distance between the two points is kept, without axes of the surface
    normals     the distance is kept, and the angles of both normals with each other and with the line between

Columns: matches and correct ones in a pair of frames, and the share of lit pairs within 2 degrees, at 30 and
60 degrees; time of a match, of one core.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import process_time
from typing import Annotated
from unittest.mock import patch

import numpy as np
from tyro.conf import arg

from benchmarks.command import Record, Short, command
from benchmarks.frontend.matching import (
    GAPS,
    RECORD,
    Lit,
    correct,
    light_case,
    lit_pairs,
    measure_light,
    motion_of,
    settings,
)
from benchmarks.frontend.scenes import UnseenScene, open_scene, render, scene_names
from benchmarks.presentation import print_table
from benchmarks.record import complete
from polhode.config.frontend_settings import Frontend
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching import matchers
from polhode.frontend.matching.methods import match_method
from polhode.lie import Array
from polhode.records import Bools

ANGLE_RAD = np.deg2rad(matchers.AXES_DEG)
"""Largest difference of angles with normals that are kept."""
FAR_GATES = 3.0
"""Points nearer to each other than so many gates keep their distance in any motion."""
ROUNDS = 10
"""Of the power method."""
RIGHT_DEG = 2.0
Agreement = tuple[Bools, Array]
Vote = Callable[[Array, Array, Array, Array, Array, Array], Agreement]
"""Points (m, 3) and axes (m, 3, 3) of the proposals in both frames, weights (m,), gates (m,) [m] to their
agreement (m, m) and support (m,)."""


def single(p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array) -> Agreement:
    """The weight of the supporters."""
    agrees, _ = PAIRS(p_A, p_B, R_AS, R_BS, weight, gate_m)
    return agrees, agrees @ weight


def spectral(p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array) -> Agreement:
    """The leading eigenvector of the weighted agreement, by the power method."""
    agrees, _ = PAIRS(p_A, p_B, R_AS, R_BS, weight, gate_m)
    root = np.sqrt(weight)
    weighted, vector = agrees * root[:, None] * root, root
    for _ in range(ROUNDS):
        vector = weighted @ vector
        vector = vector / np.linalg.norm(vector)
    return agrees, vector


def distances(p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array) -> Agreement:
    """A rigid body keeps the distances of its points."""
    return _by_pairs(_keeps_distance(p_A, p_B, gate_m), weight)


def normals(p_A: Array, p_B: Array, R_AS: Array, R_BS: Array, weight: Array, gate_m: Array) -> Agreement:
    """It also keeps the angles of its normals, with each other and with the lines between its points."""
    agrees = _keeps_distance(p_A, p_B, gate_m)
    (between_A, along_A), (between_B, along_B) = (
        _angles_of_normals(p, R[:, :, 2]) for p, R in ((p_A, R_AS), (p_B, R_BS))
    )
    along = np.abs(along_A - along_B) < ANGLE_RAD
    agrees &= (np.abs(between_A - between_B) < ANGLE_RAD) & along & along.T
    np.fill_diagonal(agrees, True)
    return _by_pairs(agrees, weight)


def _keeps_distance(p_A: Array, p_B: Array, gate_m: Array) -> Bools:
    """Whether proposals (m, m) keep their points' distance; each agrees with itself."""
    long_A, long_B = (np.linalg.norm(p[:, None] - p, axis=2) for p in (p_A, p_B))
    gate = gate_m[:, None] + gate_m
    agrees = (np.abs(long_A - long_B) < gate) & (long_A > FAR_GATES * gate)
    np.fill_diagonal(agrees, True)
    return np.asarray(agrees)


def _angles_of_normals(p: Array, normal: Array) -> tuple[Array, Array]:
    """Angles (m, m) between normals (m, 3), and of the lines to the other points (m, 3) with the normals."""
    line = p[:, None] - p
    line /= np.maximum(np.linalg.norm(line, axis=2, keepdims=True), 1e-12)
    cosines = normal @ normal.T, np.einsum("nki,ni->nk", line, normal)
    between, along = (np.arccos(np.clip(cosine, -1.0, 1.0)) for cosine in cosines)
    return between, along


def _by_pairs(agrees: Bools, weight: Array) -> Agreement:
    pull = agrees * weight
    return agrees, np.einsum("nk,nk->n", pull @ agrees.astype(np.float64), pull)


PAIRS: Vote = matchers._proposal_support
VOTES: Mapping[str, Vote] = {
    "pairs": PAIRS,
    "single": single,
    "spectral": spectral,
    "distances": distances,
    "normals": normals,
}
METHODS = ("rootsift-2x+polhode", "polhode", "surface")
COLUMNS = ("features", "vote", "matches", "correct", "lit pairs within 2 deg [%]", "ms / match")


@dataclass(frozen=True)
class Frames:
    """The features of all frames of a scene."""

    name: str
    scene: UnseenScene
    features: Sequence[StereoFeatures]
    p_G: Sequence[Array]
    """Of each frame, what its features show (n, 3) [m]"""


@dataclass(frozen=True)
class Judged:
    """A pair of frames."""

    gap: int
    matches: int
    correct: int
    is_lit: bool
    is_right: bool
    seconds: float


def main(
    methods: Annotated[tuple[str, ...], arg(help="Features, as in benchmarks.frontend.matching.")] = METHODS,
    short: Short = False,
    record: Record = RECORD,
) -> None:
    """Print one row for each vote of each method."""
    names = scene_names(short)
    for name in names:
        render(name)
    lit = lit_pairs(complete(record, [light_case(name) for name in names], measure_light, 1))
    rows = []
    for method in methods:
        frames = [frames_of(name, method) for name in names]
        for vote, support in VOTES.items():
            with patch.object(matchers, "_proposal_support", support):
                judged = [pair for each in frames for pair in judge(each, settings(method), lit)]
            rows.append([method, vote, *_cells(judged)])
    print_table(COLUMNS, rows)


def frames_of(name: str, method: str) -> Frames:
    """All frames of a scene with the features of a method."""
    scene = open_scene(name)
    config = with_patch_size(settings(method), scene.sequence, scene.rectifier)
    features = [extract_pair(scene.pair(k), scene.rig, config) for k in range(len(scene))]
    return Frames(name, scene, features, [scene.body_points(k, f.uvd_px)[0] for k, f in enumerate(features)])


def judge(frames: Frames, config: Frontend, lit: Lit) -> Iterator[Judged]:
    """Each pair of frames."""
    for gap in GAPS:
        for i in range(len(frames.features) - gap):
            j = i + gap
            a, b = frames.features[i], frames.features[j]
            begin = process_time()
            found = match_method(config)(a, b)
            seconds = process_time() - begin
            error_deg, _ = motion_of(frames.scene, found, a, b, i, j, config)
            yield Judged(
                gap,
                len(found.features),
                int(correct(found, frames.p_G[i], frames.p_G[j]).sum()),
                (i, j) in lit[frames.name],
                error_deg is not None and error_deg < RIGHT_DEG,
                seconds,
            )


def _cells(judged: Sequence[Judged]) -> list[str]:
    by_gap = [[pair for pair in judged if pair.gap == gap] for gap in GAPS]

    def means(of: Callable[[Judged], float], only_lit: bool = False) -> Iterator[float]:
        return (float(np.mean([of(p) for p in pairs if p.is_lit or not only_lit])) for pairs in by_gap)

    shown = partial(", ".join)
    return [
        shown(f"{value:.0f}" for value in means(lambda pair: pair.matches)),
        shown(f"{value:.1f}" for value in means(lambda pair: pair.correct)),
        shown(f"{100 * value:.0f}" for value in means(lambda pair: pair.is_right, only_lit=True)),
        f"{1e3 * np.median([pair.seconds for pair in judged]):.0f}",
    ]


if __name__ == "__main__":
    command(main)
