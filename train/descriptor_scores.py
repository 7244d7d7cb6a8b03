"""How often a descriptor finds the right point, on bodies that were not trained on, against RootSIFT.

Two frames of a held-out scene; for each key point of the first that is found again in the second: is the most
similar of all the second's key points the right one? Angles are between the directions to the cameras.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from frontend.patches import Patches, cut_patches, tangent_affines
from polhode.lie import Array
from polhode.records import Bools, Ints
from train.patch_batches import FramePair, frame_pairs, leaning, rig_of
from train.points import ScenePoints

ANGLES_DEG = {"30": (20.0, 40.0), "60": (50.0, 70.0)}
"""Angle between the views of the points of each score."""
PAIRS_A_SCENE = 4
"""Frame pairs of each scene and angle."""
RIGHT_PX = 3.0
"""A point this close to the true place is the right one [px]."""
HALF_PX = 16.0
"""Half the side of the patches at the scene's middle depth [px]."""
NORMAL_NOISE_DEG = 5.0
"""Error of the normals that the patches are cut with [deg]."""
Describe = Callable[[Patches], tuple[Array, Array]]
"""Patches (n, 1, s, s) -> descriptors (n, d) and reliability (n,)"""


@dataclass(frozen=True)
class Trial:
    """One frame pair of the validation, its patches cut."""

    angle: str
    sift_a: Array
    sift_b: Array
    patches_a: Patches
    patches_b: Patches
    rows: Ints
    """(q,) points of a that are asked for"""
    true_px: Array
    """(q, 2) where they are in b"""
    uv_b_px: Array
    """(n_b, 2)"""


def make_trials(scenes: Mapping[int, ScenePoints], seed: int) -> list[Trial]:
    """The frame pairs, the same whenever the scenes and the seed are."""
    rng = np.random.default_rng([seed, 0x7E57])
    trials = []
    for number, points in scenes.items():
        pairs = frame_pairs({number: points}, np.pi)
        for name, (least, most) in ANGLES_DEG.items():
            inside = [pair for pair in pairs if least < _angle_deg(points, pair) < most]
            for k in rng.permutation(len(inside))[:PAIRS_A_SCENE]:
                trials.append(_trial(points, inside[k], name, rng))
    return trials


def _angle_deg(points: ScenePoints, pair: FramePair) -> float:
    return float(np.rad2deg(np.median(points.angle_rad[pair.found])))


def _trial(points: ScenePoints, pair: FramePair, angle: str, rng: np.random.Generator) -> Trial:
    known = np.isfinite(points.p_K).all(axis=1)
    a = np.flatnonzero((points.frame == pair.a) & known)
    b = np.flatnonzero((points.frame == pair.b) & known)
    half_m = HALF_PX * float(np.median(points.p_K[a, 2])) / float(points.focal_px)
    asked = points.point[pair.found]
    return Trial(
        angle,
        points.sift[a].astype(np.float32),
        points.sift[b].astype(np.float32),
        _cut(points, a, half_m, rng),
        _cut(points, b, half_m, rng),
        np.searchsorted(a, asked),
        points.uv_other_px[pair.found],
        points.uv_px[b],
    )


def _cut(points: ScenePoints, index: Ints, half_m: float, rng: np.random.Generator) -> Patches:
    normal = leaning(points.normal_K[index], np.deg2rad(NORMAL_NOISE_DEG), rng)
    affine = tangent_affines(points.p_K[index], normal, rig_of(points), np.full(len(index), half_m))
    return cut_patches(points.grey[points.frame[index[0]]], points.uv_px[index], affine)


def score(trials: list[Trial], describe: Describe) -> dict[str, float]:
    """Rank-1 shares at both angles, RootSIFT's, and how well reliability tells right from wrong (AUC)."""
    right: dict[str, list[Array]] = {name: [] for name in ANGLES_DEG}
    right_sift: dict[str, list[Array]] = {name: [] for name in ANGLES_DEG}
    trust, hit = [], []
    for trial in trials:
        a, trust_a = describe(trial.patches_a)
        b, _ = describe(trial.patches_b)
        own = _hits(a, b, trial)
        right[trial.angle].append(own)
        right_sift[trial.angle].append(_hits(trial.sift_a, trial.sift_b, trial))
        label = np.zeros(len(a))
        label[trial.rows] = own
        trust.append(trust_a)
        hit.append(label)
    scores = {}
    for name in ANGLES_DEG:
        if right[name]:
            scores[f"rank_1_at_{name}"] = float(np.concatenate(right[name]).mean())
            scores[f"rootsift_at_{name}"] = float(np.concatenate(right_sift[name]).mean())
    if hit:
        scores["reliability_auc"] = area_under_curve(np.concatenate(trust), np.concatenate(hit) > 0)
    return scores


def _hits(a: Array, b: Array, trial: Trial) -> Array:
    best = (a[trial.rows] @ b.T).argmax(axis=1)
    off_px = np.linalg.norm(trial.uv_b_px[best] - trial.true_px, axis=1)
    return np.asarray(off_px < RIGHT_PX, dtype=np.float64)


def area_under_curve(value: Array, positive: Bools) -> float:
    """Probability that a positive's value is above a negative's; 0.5 when one kind is missing."""
    n = int(positive.sum())
    if n in (0, len(positive)):
        return 0.5
    rank = np.empty(len(value))
    rank[np.argsort(value, kind="stable")] = np.arange(1, len(value) + 1)
    return float((rank[positive].sum() - n * (n + 1) / 2) / (n * (len(value) - n)))
