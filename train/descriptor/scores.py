"""Scores of a descriptor on bodies outside the training set: the share of correct nearest neighbours.

Two frames of a scene are compared. For each key point of the first frame that is redetected in the second,
the most similar of all key points in the second frame is correct or not. Angles are between the viewing
directions. RootSIFT is scored on the same key points.

    python -m polhode.train.descriptor.scores SEQ... [--weights FILE]

scores weights on sequences of ``polhode simulate`` with a rectified rig, and prints a table.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.stats import rankdata

from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patch_descriptors import HistogramDescriptor, descriptor_network
from polhode.frontend.features.patches import Patches, cut_patches, rotate_affines, tangent_affines
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.sequence import SCENE_FILE
from polhode.train.descriptor.batches import (
    FramePair,
    camera_rotation,
    distractor_points,
    frame_pairs,
    patch_rotation,
    perturbed_normals,
    same_appearance,
    scene_rig,
)
from polhode.train.descriptor.surface_points import ScenePoints, find_points

ANGLES_DEG = {"30": (20.0, 40.0), "60": (50.0, 70.0)}
"""Range of the angle between the views for each score."""
LIGHT_ALONE = {"light": (-1.0, 1.0)}
"""The same for images of one pose under two Suns."""
PAIRS_PER_SCENE = 4
"""Frame pairs for each scene and angle."""
MAX_ERROR_PX = 3.0
"""Largest distance of a correct match from the true position [px]."""
HALF_PX = 12.0
"""Half the side of the patches at the scene's median depth [px]."""
NORMAL_NOISE_DEG = 5.0
"""Error of the normals with which patches are cut [deg]."""
MAX_DIRECTION_ERROR_DEG = 20.0
"""Largest error of a correct direction [deg]."""
METHODS = {"rootsift": "RootSIFT", "surface_rootsift": "on patches", "rank_1": "network"}
"""Scores in the table, and their titles."""
_SEED = 1
_NETWORK_BATCH = 256
Describe = Callable[[Patches], tuple[Descriptors, Array, Array]]
"""Patches (n, 1, s, s) -> descriptors (n, d), reliability (n,), directions (n, 2)"""


@dataclass(frozen=True)
class ValidationPair:
    """A frame pair of the validation, with its patches."""

    angle: str
    sift_a: Descriptors
    """RootSIFT of the image"""
    sift_b: Descriptors
    surface_a: Descriptors
    """RootSIFT of the patches in the tangent plane, rotated to their dominant gradients"""
    surface_b: Descriptors
    patches_a: Patches
    patches_b: Patches
    rows: Ints
    """(q,) points of a that are redetected in b"""
    true_px: Array
    """(q, 2) their true positions in b"""
    uv_b_px: Array
    """(n_b, 2)"""
    partner: Ints
    """(q,) the corresponding key points of b"""
    rotation_rad: Array
    """(q,) angle in the partner's patch of the direction that is x in the own patch"""
    distractor: Ints
    """(s,) points of a that are not surface features"""


def validation_pairs(scenes: Mapping[int, ScenePoints], seed: int) -> list[ValidationPair]:
    """The frame pairs, which depend only on the scenes and the seed."""
    rng = np.random.default_rng([seed, 0x7E57])
    trials = []
    for number, points in scenes.items():
        same = same_appearance(points)
        pairs, distractor = frame_pairs(points, same, number, np.pi), distractor_points(points, same)
        angles = [np.rad2deg(np.median(points.angle_rad[pair.found])) for pair in pairs]
        for name, (least, most) in (ANGLES_DEG | LIGHT_ALONE).items():
            inside = [pair for pair, angle in zip(pairs, angles, strict=True) if least < angle < most]
            for k in rng.permutation(len(inside))[:PAIRS_PER_SCENE]:
                trials.append(_trial(points, inside[k], name, distractor, rng))
    return trials


def _trial(
    points: ScenePoints, pair: FramePair, angle: str, distractor: Bools, rng: np.random.Generator
) -> ValidationPair:
    known = np.isfinite(points.p_K).all(axis=1)
    a = np.flatnonzero((points.frame == pair.a) & known)
    b = np.flatnonzero((points.frame == pair.b) & known)
    half_m = HALF_PX * float(np.median(points.p_K[a, 2])) / float(points.focal_px)
    own, partner = points.point[pair.found], points.again[pair.found]
    histogram = HistogramDescriptor()
    patches_a, affine_a = noisy_patches(points, a, half_m, rng)
    patches_b, affine_b = noisy_patches(points, b, half_m, rng)
    row, column = np.searchsorted(a, own), np.searchsorted(b, partner)
    R_ba = camera_rotation(points, pair.a, pair.b)
    return ValidationPair(
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
        patch_rotation(
            affine_a[row],
            affine_b[column],
            points.p_K[own],
            points.normal_K[own],
            R_ba,
            points.p_K[partner],
            scene_rig(points),
        ),
        np.flatnonzero(distractor[a]),
    )


def noisy_patches(
    points: ScenePoints, index: Ints, half_m: float, rng: np.random.Generator
) -> tuple[Patches, Array]:
    """Patches at key points of one frame, with the errors of a run, and their maps."""
    normal = perturbed_normals(points.normal_K[index], np.deg2rad(NORMAL_NOISE_DEG), rng)
    affine = tangent_affines(points.p_K[index], normal, scene_rig(points), np.full(len(index), half_m))
    affine = rotate_affines(affine, rng.uniform(0.0, 2.0 * np.pi, len(index)))
    return cut_patches(points.grey[points.frame[index[0]]], points.uv_px[index], affine), affine


def score(trials: list[ValidationPair], describe: Describe) -> dict[str, float]:
    """Shares of correct results at both angles.

    ``rank_1``: the most similar of all key points is correct; ``common``: the same among the key points that
    both frames have; ``rootsift`` and ``rootsift_common``: both for RootSIFT; ``surface_rootsift``: for
    RootSIFT on patches of the tangent plane; ``straight``: the direction is correct. ``reliability_auc``: the
    probability that the reliability of a correctly matched point is above that of another point or distractor
    of the same image.
    """
    shares: dict[str, list[Array]] = {}
    auc = []
    for trial in trials:
        a, reliability_a, direction_a = describe(trial.patches_a)
        b, _, direction_b = describe(trial.patches_b)
        own = _hits(a, b, trial)
        off_rad = _angle(direction_b[trial.partner]) - _angle(direction_a[trial.rows]) - trial.rotation_rad
        straight = np.cos(off_rad) > np.cos(np.deg2rad(MAX_DIRECTION_ERROR_DEG))
        for name, values in {
            "rank_1": own,
            "rootsift": _hits(trial.sift_a, trial.sift_b, trial),
            "common": _hits_in_common(a, b, trial),
            "rootsift_common": _hits_in_common(trial.sift_a, trial.sift_b, trial),
            "surface_rootsift": _hits(trial.surface_a, trial.surface_b, trial),
            "straight": straight.astype(np.float64),
        }.items():
            shares.setdefault(f"{name}_at_{trial.angle}", []).append(values)
        judged = np.concatenate([trial.rows, trial.distractor])
        hit = np.concatenate([own, np.zeros(len(trial.distractor))]) > 0
        auc.append(area_under_curve(reliability_a[judged], hit))
    scores = {name: float(np.concatenate(values).mean()) for name, values in sorted(shares.items())}
    if auc:
        scores["reliability_auc"] = float(np.mean(auc))
    return scores


def _angle(direction: Array) -> Array:
    return np.asarray(np.arctan2(direction[:, 1], direction[:, 0]))


def _hits(a: Descriptors, b: Descriptors, trial: ValidationPair) -> Array:
    """(q,) 1 where the most similar of all key points of b is correct."""
    return _correct(trial.uv_b_px[(a[trial.rows] @ b.T).argmax(axis=1)], trial)


def _hits_in_common(a: Descriptors, b: Descriptors, trial: ValidationPair) -> Array:
    """(q,) the same among the key points of b that correspond to one of a."""
    best = (a[trial.rows] @ b[trial.partner].T).argmax(axis=1)
    return _correct(trial.uv_b_px[trial.partner[best]], trial)


def _correct(found_px: Array, trial: ValidationPair) -> Array:
    off_px = np.linalg.norm(found_px - trial.true_px, axis=1)
    return np.asarray(off_px < MAX_ERROR_PX, dtype=np.float64)


def area_under_curve(value: Array, positive: Bools) -> float:
    """Probability that a positive's value is above a negative's; 0.5 when one kind is missing."""
    n = int(positive.sum())
    if n in (0, len(positive)):
        return 0.5
    rank = rankdata(value, method="ordinal")
    return float((rank[positive].sum() - n * (n + 1) / 2) / (n * (len(value) - n)))


def describe_patches(network: DescriptorNet, patches: Patches) -> tuple[Descriptors, Array, Array]:
    """Descriptors (n, d), logits of reliability (n,), directions (n, 2) of patches (n, 1, s, s)."""
    device = next(network.parameters()).device
    with torch.no_grad():
        parts = [network(some.to(device)) for some in torch.from_numpy(patches).split(_NETWORK_BATCH)]
    descriptor, reliability, direction = (
        torch.cat(each).float().cpu().numpy() for each in zip(*parts, strict=True)
    )
    return descriptor, reliability, direction


def score_sequence(folder: Path, network: DescriptorNet) -> Mapping[str, float]:
    """Scores on one sequence. Raises InputError: it was not simulated."""
    if not (folder / SCENE_FILE).is_file():
        raise InputError(f"{folder} contains no {SCENE_FILE}: give a sequence of polhode simulate")
    return score(
        validation_pairs({0: find_points(folder)}, _SEED), lambda patches: describe_patches(network, patches)
    )


def table(scores: Mapping[str, Mapping[str, float]]) -> str:
    """Markdown table: a row for each sequence and one of means; columns by angle and method."""
    columns = [f"{method}_at_{angle}" for angle in ANGLES_DEG for method in METHODS]
    head = [f"{angle} deg {title}" for angle in ANGLES_DEG for title in METHODS.values()]
    columns.append("reliability_auc")
    rows = [["sequence", *head, "reliability AUC"], ["---"] * (len(columns) + 1)]
    for name, values in scores.items():
        rows.append([name, *(f"{values[c]:.3f}" if c in values else "" for c in columns)])
    known = [[values[c] for values in scores.values() if c in values] for c in columns]
    rows.append(["mean", *(f"{np.mean(each):.3f}" if each else "" for each in known)])
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Score descriptor weights on simulated sequences."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.train.descriptor.scores", description=main.__doc__
    )
    parser.add_argument("sequences", type=Path, nargs="+", metavar="SEQ")
    parser.add_argument("--weights", type=Path, help="weights file; default: the shipped weights")
    options = parser.parse_args(arguments)
    try:
        network = descriptor_network(options.weights)
        print(table({folder.name: score_sequence(folder, network) for folder in options.sequences}))
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
