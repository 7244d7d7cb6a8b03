"""How often the most similar descriptor is right where light, pose or both differ, and what foresees it.

    python -m polhode.train.light.predictability configs/train/light.yaml [--weights FILE]

renders the bodies of ``polhode.train.light.lit_points`` that are missing and prints a table by family.

A point is sometimes found and sometimes not, depending on the other image. Suppose its own probability were
known exactly: how well would that tell points that are found from those that are not? The probabilities of
the points of an image are taken to have a beta distribution. Its two moments follow from the counts, without
the bias of their binomial noise: for a point that k of n images find, k (k - 1) / (n (n - 1)) has the square
of the probability as its expectation. The area under the ROC curve that follows is a limit for every
judgement of single points before matching, however good.
"""

import argparse
import os
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from polhode.config.loader import load_config
from polhode.config.train_settings import LightStudy
from polhode.frontend.features.patch_descriptors import descriptor_network
from polhode.frontend.networks.descriptor import DIMENSIONS, DescriptorNet
from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import Silent
from polhode.train.corpus import required_train
from polhode.train.descriptor.scores import MAX_ERROR_PX, area_under_curve, describe_patches, noisy_patches
from polhode.train.descriptor.surface_points import ScenePoints
from polhode.train.light.lit_points import pose_of, prepare_lit_points, sun_of

MAX_ANGLE_DEG = 70.0
"""Largest angle between the two views of a sighting that counts [deg]."""
LIT_DN = 12
"""Grey value from which on a pixel is lit."""
MIN_OF_EACH = 5
"""Points that are found, and that are not, of which a pair of images has at least so many."""
MIN_IMAGES, MIN_POINTS = 3, 30
"""Other images that show a point, and such points in an image, for the limit."""
PATCH_HALF_PX = 12.0
"""Half the side of the patches at the median depth of the body [px]."""
COLUMNS = (
    "family",
    "bodies",
    "light alone [%]",
    "pose alone [%]",
    "both [%]",
    "AUC reliability",
    "AUC similarity",
    "AUC limit",
)


@dataclass(frozen=True)
class Sightings:
    """Points of one image whose place another image shows in the light; m of them, of N points."""

    point: Ints
    """(m,)"""
    other: Ints
    """(m,) the other image"""
    found: Bools
    """(m,) whether the most similar descriptor there is the right one"""
    similarity: Array
    """(m,) of that descriptor"""


@dataclass(frozen=True)
class Predictability:
    """Results of one body, or means over bodies; NaN: it has no such pairs."""

    light: float
    """Share of the sightings under another Sun whose match is right"""
    pose: float
    """The same from another pose under the same Sun"""
    both: float
    """The same where both differ"""
    auc_reliability: float
    """Area within an image by the reliability that the descriptor gives to its patch"""
    auc_similarity: float
    """The same by the similarity of the match"""
    auc_limit: float
    """The same if the probability of each point were known"""


def predictability(points: ScenePoints, study: LightStudy, network: DescriptorNet) -> Predictability:
    """Of one body."""
    seen, reliability = match_sightings(points, network)
    first = points.frame[seen.point]
    numbers = (pose_of(points, study), sun_of(points, study))
    same_pose, same_sun = (np.asarray(each[first] == each[seen.other]) for each in numbers)

    def share(kind: Bools) -> float:
        return float(seen.found[kind].mean()) if kind.any() else np.nan

    pair = first * len(points.grey) + seen.other
    return Predictability(
        share(same_pose),
        share(~same_pose & same_sun),
        share(~same_pose & ~same_sun),
        area_within_pairs(pair, reliability[seen.point], seen.found),
        area_within_pairs(pair, seen.similarity, seen.found),
        limit_within_images(points.frame, seen),
    )


def match_sightings(points: ScenePoints, network: DescriptorNet) -> tuple[Sightings, Array]:
    """The sightings of a body that count, with their matches, and the reliability of all points (N,)."""
    rng = np.random.default_rng(0)
    count = len(points.frame)
    descriptors, reliability = np.zeros((count, DIMENSIONS), np.float32), np.full(count, -np.inf)
    known = np.asarray(np.isfinite(points.p_K).all(axis=1))
    for frame in range(len(points.grey)):
        here = np.flatnonzero(known & (points.frame == frame))
        if len(here) == 0:
            continue
        half_m = PATCH_HALF_PX * float(np.median(points.p_K[here, 2])) / float(points.focal_px)
        described, trust, _ = describe_patches(network, noisy_patches(points, here, half_m, rng)[0])
        descriptors[here], reliability[here] = described, trust
    use = np.flatnonzero(known[points.point] & (points.angle_rad < np.deg2rad(MAX_ANGLE_DEG)) & _lit(points))
    found, similarity = np.zeros(len(use), dtype=bool), np.zeros(len(use))
    for other in np.unique(points.other[use]):
        candidates = np.flatnonzero(known & (points.frame == other))
        here = np.flatnonzero(points.other[use] == other)
        if len(candidates) == 0:
            continue
        product = descriptors[points.point[use[here]]] @ descriptors[candidates].T
        best = product.argmax(axis=1)
        off_px = points.uv_px[candidates[best]] - points.uv_other_px[use[here]]
        found[here] = np.linalg.norm(off_px, axis=1) < MAX_ERROR_PX
        similarity[here] = product[np.arange(len(here)), best]
    return Sightings(points.point[use], points.other[use], found, similarity), reliability


def _lit(points: ScenePoints) -> Bools:
    """Whether the other image shows each sighting (M,) in the light."""
    height, width = points.grey.shape[1:]
    pixel = np.round(points.uv_other_px).astype(int)
    row, column = np.clip(pixel[:, 1], 0, height - 1), np.clip(pixel[:, 0], 0, width - 1)
    return np.asarray(points.grey[points.other, row, column] >= LIT_DN)


def area_within_pairs(pair: Ints, value: Array, found: Bools) -> float:
    """Mean over pairs of images of the area under the ROC curve of a value (m,); NaN without any.

    pair (m,): number of the pair of each sighting.
    """
    areas = []
    for each in np.unique(pair):
        here = np.flatnonzero(pair == each)
        if MIN_OF_EACH <= found[here].sum() <= len(here) - MIN_OF_EACH:
            areas.append(area_under_curve(value[here], found[here]))
    return float(np.mean(areas)) if areas else np.nan


def limit_within_images(frame: Ints, seen: Sightings) -> float:
    """Mean over the images of ``limit``; NaN if none has enough points. frame (N,): image of each point."""
    shown = np.bincount(seen.point, minlength=len(frame))
    found = np.bincount(seen.point[seen.found], minlength=len(frame))
    areas = np.array([limit(found[frame == k], shown[frame == k]) for k in np.unique(frame)])
    known = areas[np.isfinite(areas)]
    return float(known.mean()) if len(known) else np.nan


def limit(found: Ints, shown: Ints) -> float:
    """Area under the ROC curve if the probability of each point (n,) to be found were known.

    found (n,) of shown (n,) images; NaN where there are too few, or all are alike.
    """
    enough = shown >= MIN_IMAGES
    k, n = found[enough].astype(np.float64), shown[enough].astype(np.float64)
    if len(n) < MIN_POINTS or k.sum() == 0:
        return np.nan
    mean = float(k.sum() / n.sum())
    variance = float(np.mean(k * (k - 1.0) / (n * (n - 1.0)))) - mean**2
    size = mean * (1.0 - mean) / variance - 1.0 if variance > 0.0 else -1.0
    if size <= 0.0:
        return np.nan
    a, b = mean * size, (1.0 - mean) * size
    # Among those that are found the density is multiplied by p, among the others by 1 - p.
    middle = (np.arange(2000) + 0.5) / 2000
    quantile = beta.ppf(middle, a + 1.0, b)
    return float(np.mean(beta.cdf(quantile, a, b + 1.0)))


def table(by_family: Mapping[str, Sequence[Predictability]]) -> str:
    """Markdown table: a row for each family, and one of means over all bodies."""
    rows = {**by_family, "all": [each for bodies in by_family.values() for each in bodies]}
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---|" * len(COLUMNS)]
    for family, bodies in rows.items():
        mean = _means(bodies)
        cells = [*(f"{100 * value:.0f}" for value in mean[:3]), *(f"{value:.2f}" for value in mean[3:])]
        lines.append(f"| {' | '.join([family, str(len(bodies)), *cells])} |")
    return "\n".join(lines)


def _means(bodies: Sequence[Predictability]) -> NDArray[np.float64]:
    """Means of the known values of each field."""
    values = np.array([astuple(each) for each in bodies], dtype=np.float64)
    known = np.isfinite(values)
    total = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.where(known.any(axis=0), total, np.nan)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how matches suffer from other light, and what foresees it."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.train.light.predictability", description=main.__doc__
    )
    parser.add_argument("config", type=Path)
    parser.add_argument("--weights", type=Path, help="weights of the descriptor; default: the shipped ones")
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    options = parser.parse_args(arguments)
    try:
        train = required_train(load_config(options.config).train, options.config)
        network = descriptor_network(options.weights)
        bodies = prepare_lit_points(train.corpus, train.light, Silent(), options.workers)
    except (InputError, RunFailure) as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    by_family: dict[str, list[Predictability]] = {}
    for index, points in bodies.items():
        family = train.corpus.families[index % len(train.corpus.families)]
        by_family.setdefault(family, []).append(predictability(points, train.light, network))
    print(table(by_family))


if __name__ == "__main__":
    main()
