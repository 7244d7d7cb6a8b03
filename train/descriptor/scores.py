"""Scores of a descriptor on bodies outside the training set: the share of correct nearest neighbours.

Two frames of a scene are compared. For each key point of the first frame that is redetected in the second,
the most similar of all key points in the second frame is correct or not. Angles are between the viewing
directions. RootSIFT is scored on the same key points.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import kornia.feature
import numpy as np
import torch
from scipy.stats import rankdata

from polhode.files.images import Grey
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.patches import (
    Patches,
    cut_patches,
    root_image,
    rotate_affines,
    tangent_affines,
)
from polhode.frontend.networks.descriptor import DescriptorNet
from polhode.geometry.lie import Array, Bools, Ints
from polhode.train.descriptor.batches import (
    HALF_PX,
    FramePair,
    camera_rotation,
    distractor_points,
    frame_pairs,
    patch_rotation,
    perturbed_normals,
    points_at,
    same_appearance,
    scene_rig,
)
from polhode.train.descriptor.surface_points import ScenePoints

ANGLES_DEG = {"30": (20.0, 40.0), "60": (50.0, 70.0)}
"""Range of the angle between the views for each score."""
PAIRS_PER_SCENE = 4
"""Frame pairs for each scene and angle."""
_NETWORK_BATCH = 256
Describe = Callable[[Patches], tuple[Descriptors, Array, Array]]
"""Patches (n, 1, s, s) -> descriptors (n, d), reliability (n,), directions (n, 2)"""


@dataclass(frozen=True)
class ValidationPair:
    """A frame pair of the validation, with its patches."""

    angle: str
    sift: tuple[Descriptors, Descriptors]
    """RootSIFT of the images"""
    surface: tuple[Descriptors, Descriptors]
    """RootSIFT of the patches in the tangent plane, rotated to their dominant gradients"""
    patches: tuple[Patches, Patches]
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

    def hits(self, of: tuple[Descriptors, Descriptors], common: bool = False) -> Array:
        """(q,) 1 where the most similar of the key points of b is correct, or of those ``common`` to both."""
        among = self.partner if common else np.arange(len(self.uv_b_px))
        best = among[(of[0][self.rows] @ of[1][among].T).argmax(axis=1)]
        off_px = np.linalg.norm(self.uv_b_px[best] - self.true_px, axis=1)
        # largest distance of a correct match from the true position [px]
        return np.asarray(off_px < 3.0, dtype=np.float64)


def validation_pairs(scenes: Mapping[int, ScenePoints], seed: int) -> list[ValidationPair]:
    """The frame pairs, which depend only on the scenes and the seed."""
    rng = np.random.default_rng([seed, 0x7E57])
    trials = []
    for points in scenes.values():
        same = same_appearance(points)
        pairs, distractor = frame_pairs(points, same, np.pi), distractor_points(points, same)
        angles = [np.rad2deg(np.median(points.angle_rad[pair.found])) for pair in pairs]
        for name, (least, most) in ANGLES_DEG.items():
            inside = [pair for pair, angle in zip(pairs, angles, strict=True) if least < angle < most]
            for k in rng.permutation(len(inside))[:PAIRS_PER_SCENE]:
                trials.append(_trial(points, inside[k], name, distractor, rng))
    return trials


def _trial(
    points: ScenePoints, pair: FramePair, angle: str, distractor: Bools, rng: np.random.Generator
) -> ValidationPair:
    """Patches are cut with the errors of a run, and rotated at random."""
    known, rig, histogram = np.isfinite(points.p_K).all(axis=1), scene_rig(points), HistogramDescriptor()
    index = tuple(np.flatnonzero((points.frame == frame) & known) for frame in (pair.a, pair.b))
    half_m = HALF_PX * float(np.median(points.p_K[index[0], 2])) / rig.focal_px
    own, partner = points.point[pair.found], points.again[pair.found]
    affines, patches, surface = [], [], []
    for frame, here in zip((pair.a, pair.b), index, strict=True):
        at = points_at(points, here)
        # error of the normals with which patches are cut [deg]
        normal = perturbed_normals(at.normal_K, np.deg2rad(5.0), rng)
        affine = tangent_affines(at.p_K, normal, rig, np.full(len(here), half_m))
        affines.append(rotate_affines(affine, rng.uniform(0.0, 2.0 * np.pi, len(here))))
        patches.append(cut_patches(points.grey[frame], at.uv_px, affines[-1]))
        surface.append(histogram(points.grey[frame], at.uv_px, affines[-1]))
    row, column = np.searchsorted(index[0], own), np.searchsorted(index[1], partner)
    R_ba = camera_rotation(points, pair.a, pair.b)
    rotation_rad = patch_rotation(
        affines[0][row], affines[1][column], points_at(points, own), points.p_K[partner], R_ba, rig
    )
    return ValidationPair(
        angle=angle,
        sift=(points.sift[index[0]].astype(np.float32), points.sift[index[1]].astype(np.float32)),
        surface=(surface[0], surface[1]),
        patches=(patches[0], patches[1]),
        rows=row,
        true_px=points.uv_other_px[pair.found],
        uv_b_px=points.uv_px[index[1]],
        partner=column,
        rotation_rad=rotation_rad,
        distractor=np.flatnonzero(distractor[index[0]]),
    )


def score(trials: list[ValidationPair], describe: Describe) -> dict[str, float]:
    """Shares of correct results at each angle.

    ``rank_1``: the most similar of all key points is correct; ``common``: the same among the key points that
    both frames have; ``rootsift`` and ``rootsift_common``: both for RootSIFT; ``surface_rootsift``: for
    RootSIFT on patches of the tangent plane; ``straight``: the direction is correct. ``reliability_auc``: the
    probability that the reliability of a correctly matched point is above that of another point or distractor
    of the same image.
    """
    shares: dict[str, list[Array]] = {}
    auc = []
    for trial in trials:
        (a, reliability_a, direction_a), (b, _, direction_b) = map(describe, trial.patches)
        angle_a, angle_b = (np.arctan2(each[:, 1], each[:, 0]) for each in (direction_a, direction_b))
        off_rad = angle_b[trial.partner] - angle_a[trial.rows] - trial.rotation_rad
        straight = np.cos(off_rad) > np.cos(np.deg2rad(20.0))  # largest error of a correct direction [deg]
        own = trial.hits((a, b))
        for name, values in {
            "rank_1": own,
            "rootsift": trial.hits(trial.sift),
            "common": trial.hits((a, b), common=True),
            "rootsift_common": trial.hits(trial.sift, common=True),
            "surface_rootsift": trial.hits(trial.surface),
            "straight": straight.astype(np.float64),
        }.items():
            shares.setdefault(f"{name}_at_{trial.angle}", []).append(values)
        judged = np.concatenate([trial.rows, trial.distractor])
        hit = np.concatenate([own, np.zeros(len(trial.distractor))]) > 0
        auc.append(area_under_curve(reliability_a[judged], hit))
    scores = {name: float(np.concatenate(values).mean()) for name, values in sorted(shares.items())}
    return scores | ({"reliability_auc": float(np.mean(auc))} if auc else {})


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


class HistogramDescriptor:
    """RootSIFT of patches, rotated to their dominant gradients, on square roots of the grey values."""

    def __init__(self) -> None:
        self._sift = kornia.feature.SIFTDescriptor(32, rootsift=True)

    def __call__(self, image: Grey, uv_px: Array, affine_px: Array) -> Descriptors:
        """Descriptors (n, 128) at points (n, 2) by the maps (n, 2, 2) of their upright patches."""
        root = root_image(image)
        angle = dominant_angles(cut_patches(root, uv_px, affine_px))
        patches = cut_patches(root, uv_px, rotate_affines(affine_px, angle)) / np.float32(255.0)
        with torch.inference_mode():
            parts = [self._sift(some).numpy() for some in torch.from_numpy(patches).split(_NETWORK_BATCH)]
        return np.concatenate(parts).astype(np.float32)


def dominant_angles(patches: Patches) -> Array:
    """Direction (n,) [rad] of the strongest gradients in the middle of upright patches (n, 1, s, s).

    The peak of the histogram of gradient directions, as in SIFT (Lowe 2004), weighted by a Gaussian.
    """
    grey = patches[:, 0].astype(np.float32)
    n, size = len(grey), patches.shape[-1]
    if n == 0:
        return np.zeros(0)
    gy, gx = np.zeros_like(grey), np.zeros_like(grey)
    gx[:, :, 1:-1] = grey[:, :, 2:] - grey[:, :, :-2]
    gy[:, 1:-1, :] = grey[:, 2:, :] - grey[:, :-2, :]
    side = (2.0 * np.arange(size) + 1.0) / size - 1.0
    window = np.exp(-(side[:, None] ** 2 + side[None, :] ** 2) / (2.0 * 0.45**2))
    magnitude = np.hypot(gx, gy) * window
    bins = 36
    position = np.arctan2(gy, gx) * (bins / (2.0 * np.pi))
    low = np.floor(position)
    share = position - low
    row = np.arange(n)[:, None, None] * bins
    histogram = np.zeros(n * bins)
    for offset, weight in ((0, 1.0 - share), (1, share)):
        index = row + (low.astype(np.int64) + offset) % bins
        histogram += np.bincount(index.ravel(), (magnitude * weight).ravel(), n * bins)
    return _peak(histogram.reshape(n, bins)) * (2.0 * np.pi / bins)


def _peak(histogram: Array) -> Array:
    """Position (n,) of the highest bin of circular histograms (n, bins), interpolated by a parabola."""
    smooth = histogram
    for _ in range(2):
        smooth = 0.25 * np.roll(smooth, 1, axis=1) + 0.5 * smooth + 0.25 * np.roll(smooth, -1, axis=1)
    rows, best = np.arange(len(smooth)), smooth.argmax(axis=1)
    before, here, after = (smooth[rows, (best + k) % smooth.shape[1]] for k in (-1, 0, 1))
    curvature = np.maximum(2.0 * here - before - after, 1e-9)
    return np.asarray(best + 0.5 * (after - before) / curvature)
