"""How often a descriptor finds the right point, on bodies that were not trained on, against RootSIFT.

Two frames of a held-out scene; for each key point of the first that is found again in the second: is the most
similar of all the second's key points the right one? Angles are between the directions to the cameras.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patches import Patches, cut_patches, tangent_affines, turned
from polhode.frontend.features.surface_descriptor import HistogramDescriptor
from polhode.lie import Array
from polhode.records import Bools, Ints
from polhode.train.alikeness import alike, rig_of, turn_of
from polhode.train.patch_batches import FramePair, frame_pairs, leaning, stray_points
from polhode.train.points import ScenePoints
from polhode.train.surface_turn import turn_between

ANGLES_DEG = {"30": (20.0, 40.0), "60": (50.0, 70.0)}
"""Angle between the views of the points of each score."""
PAIRS_A_SCENE = 4
"""Frame pairs of each scene and angle."""
RIGHT_PX = 3.0
"""A point this close to the true place is the right one [px]."""
HALF_PX = 12.0
"""Half the side of the patches at the scene's middle depth [px]."""
NORMAL_NOISE_DEG = 5.0
"""Error of the normals that the patches are cut with [deg]."""
STRAIGHT_DEG = 20.0
"""A patch whose direction is off by less is turned rightly [deg]."""
Describe = Callable[[Patches], tuple[Descriptors, Array, Array]]
"""Patches (n, 1, s, s) -> descriptors (n, d), reliability (n,), directions (n, 2)"""


@dataclass(frozen=True)
class Trial:
    """One frame pair of the validation, its patches cut."""

    angle: str
    sift_a: Descriptors
    """RootSIFT of the image"""
    sift_b: Descriptors
    surface_a: Descriptors
    """RootSIFT of the patches in the tangent plane, turned to their strongest gradients"""
    surface_b: Descriptors
    patches_a: Patches
    patches_b: Patches
    rows: Ints
    """(q,) points of a that are asked for"""
    true_px: Array
    """(q, 2) where they are in b"""
    uv_b_px: Array
    """(n_b, 2)"""
    partner: Ints
    """(q,) the key point of b that each is"""
    turn_rad: Array
    """(q,) angle in the partner's patch of what lies along x in the own one"""
    stray: Ints
    """(s,) points of a that are no surface feature"""


def make_trials(scenes: Mapping[int, ScenePoints], seed: int) -> list[Trial]:
    """The frame pairs, the same whenever the scenes and the seed are."""
    rng = np.random.default_rng([seed, 0x7E57])
    trials = []
    for number, points in scenes.items():
        same = alike(points)
        pairs, stray = frame_pairs(points, same, number, np.pi), stray_points(points, same)
        for name, (least, most) in ANGLES_DEG.items():
            inside = [pair for pair in pairs if least < _angle_deg(points, pair) < most]
            for k in rng.permutation(len(inside))[:PAIRS_A_SCENE]:
                trials.append(_trial(points, inside[k], name, stray, rng))
    return trials


def _angle_deg(points: ScenePoints, pair: FramePair) -> float:
    return float(np.rad2deg(np.median(points.angle_rad[pair.found])))


def _trial(points: ScenePoints, pair: FramePair, angle: str, stray: Bools, rng: np.random.Generator) -> Trial:
    known = np.isfinite(points.p_K).all(axis=1)
    a = np.flatnonzero((points.frame == pair.a) & known)
    b = np.flatnonzero((points.frame == pair.b) & known)
    half_m = HALF_PX * float(np.median(points.p_K[a, 2])) / float(points.focal_px)
    asked, partner = points.point[pair.found], points.again[pair.found]
    histogram = HistogramDescriptor()
    patches_a, affine_a = _cut(points, a, half_m, rng)
    patches_b, affine_b = _cut(points, b, half_m, rng)
    row, column = np.searchsorted(a, asked), np.searchsorted(b, partner)
    R_ba = np.broadcast_to(turn_of(points, pair.a, pair.b), (len(asked), 3, 3))
    return Trial(
        angle,
        points.sift[a].astype(np.float32),
        points.sift[b].astype(np.float32),
        histogram(points.grey[pair.a], points.uv_px[a], affine_a).descriptors,
        histogram(points.grey[pair.b], points.uv_px[b], affine_b).descriptors,
        patches_a,
        patches_b,
        row,
        points.uv_other_px[pair.found],
        points.uv_px[b],
        column,
        turn_between(
            affine_a[row],
            affine_b[column],
            points.p_K[asked],
            points.normal_K[asked],
            R_ba,
            points.p_K[partner],
            rig_of(points),
        ),
        np.flatnonzero(stray[a]),
    )


def _cut(points: ScenePoints, index: Ints, half_m: float, rng: np.random.Generator) -> tuple[Patches, Array]:
    """Patches at key points of one frame, and their maps."""
    normal = leaning(points.normal_K[index], np.deg2rad(NORMAL_NOISE_DEG), rng)
    affine = tangent_affines(points.p_K[index], normal, rig_of(points), np.full(len(index), half_m))
    affine = turned(affine, rng.uniform(0.0, 2.0 * np.pi, len(index)))
    return cut_patches(points.grey[points.frame[index[0]]], points.uv_px[index], affine), affine


def score(trials: list[Trial], describe: Describe) -> dict[str, float]:
    """Shares at both angles. ``rank_1``: the most similar of all key points is the right one; ``common``: of
    the key points that both frames have; ``rootsift`` and ``rootsift_common``: the same of RootSIFT;
    ``surface_rootsift``: of RootSIFT on patches of the tangent plane; ``straight``: the direction is right.
    ``reliability_auc``: how well reliability tells, in one image, what was found from what was not and from
    strays: the probability that it is higher.
    """
    shares: dict[str, list[Array]] = {}
    apart = []
    for trial in trials:
        a, trust_a, direction_a = describe(trial.patches_a)
        b, _, direction_b = describe(trial.patches_b)
        own = _hits(a, b, trial)
        off_rad = _angle(direction_b[trial.partner]) - _angle(direction_a[trial.rows]) - trial.turn_rad
        straight = np.cos(off_rad) > np.cos(np.deg2rad(STRAIGHT_DEG))
        for name, values in {
            "rank_1": own,
            "rootsift": _hits(trial.sift_a, trial.sift_b, trial),
            "common": _hits_in_common(a, b, trial),
            "rootsift_common": _hits_in_common(trial.sift_a, trial.sift_b, trial),
            "surface_rootsift": _hits(trial.surface_a, trial.surface_b, trial),
            "straight": straight.astype(np.float64),
        }.items():
            shares.setdefault(f"{name}_at_{trial.angle}", []).append(values)
        judged = np.concatenate([trial.rows, trial.stray])
        hit = np.concatenate([own, np.zeros(len(trial.stray))]) > 0
        apart.append(area_under_curve(trust_a[judged], hit))
    scores = {name: float(np.concatenate(values).mean()) for name, values in sorted(shares.items())}
    if apart:
        scores["reliability_auc"] = float(np.mean(apart))
    return scores


def _angle(direction: Array) -> Array:
    return np.asarray(np.arctan2(direction[:, 1], direction[:, 0]))


def _hits(a: Descriptors, b: Descriptors, trial: Trial) -> Array:
    """(q,) 1 where the most similar of all of b's key points is at the true place."""
    return _right(trial.uv_b_px[(a[trial.rows] @ b.T).argmax(axis=1)], trial)


def _hits_in_common(a: Descriptors, b: Descriptors, trial: Trial) -> Array:
    """(q,) the same among the key points of b that are some of a's."""
    best = (a[trial.rows] @ b[trial.partner].T).argmax(axis=1)
    return _right(trial.uv_b_px[trial.partner[best]], trial)


def _right(found_px: Array, trial: Trial) -> Array:
    off_px = np.linalg.norm(found_px - trial.true_px, axis=1)
    return np.asarray(off_px < RIGHT_PX, dtype=np.float64)


def area_under_curve(value: Array, positive: Bools) -> float:
    """Probability that a positive's value is above a negative's; 0.5 when one kind is missing."""
    n = int(positive.sum())
    if n in (0, len(positive)):
        return 0.5
    rank = np.empty(len(value))
    rank[np.argsort(value, kind="stable")] = np.arange(1, len(value) + 1)
    return float((rank[positive].sum() - n * (n + 1) / 2) / (n * (len(value) - n)))
