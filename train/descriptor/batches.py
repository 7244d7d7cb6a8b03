"""Batches of patch pairs: the same surface point in two frames, cut as in a run and with the errors of a run.

Points of the same two frames are each other's hard negatives. In addition a batch contains distractors: key
points that are not surface features (edges of cast shadows, silhouettes) or that are not detected in other
frames.

Pairs must show the same mark: with many weak key points a third of those within 1.5 px of the true position
are coincidences, or the light has changed the surface beyond recognition: nothing can be learned from them.
Therefore both patches are cut by the ground truth, rotated to the same orientation, and correlated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from polhode.config.train_settings import DescriptorTraining
from polhode.frontend.features.patches import (
    Patches,
    cut_patches,
    image_jacobian,
    rotate_affines,
    tangent_affines,
    tangent_vectors,
    upright_affines,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.train.descriptor.surface_points import ScenePoints
from polhode.train.task import Batch

HALF_PX = 12.0
"""Half the side of the patches at the median depth of the first frame [px]."""
MIN_CORRELATION = 0.3
"""Correlation of the logarithms above which two patches show the same mark."""
DISTRACTORS = 0.25
"""Number of key points that are no surface feature, over the number of pairs."""
MAX_TURN_DEG = 70.0
"""Largest angle between the two views of a point."""
HALF_RANGE_PX = (10.0, 15.0)
"""Half the side of a patch at the scene's middle depth, least and most; on the surface, both patches of a
pair have the same size."""
SCALE_NOISE = 0.1
"""Standard deviation of the logarithm of a patch's scale."""
MIN_COMMON_POINTS = 12
"""Frame pairs with fewer common points are not used."""


def same_appearance(points: ScenePoints) -> Bools:
    """Whether each sighting (M,) has a key point that looks like the original."""
    known = np.asarray(np.isfinite(points.p_K).all(axis=1))
    redetected = (points.again >= 0) & known[points.point] & known[points.again]
    result = np.zeros(len(points.point), dtype=bool)
    first = points.frame[points.point]
    for a in range(len(points.grey)):
        for b in range(len(points.grey)):
            here = np.flatnonzero(redetected & (first == a) & (points.other == b))
            if len(here):
                result[here] = _correlations(points, a, b, here) > MIN_CORRELATION
    return result


def patch_rotation(
    affine_a: Array, affine_b: Array, p_a: Array, normal_a: Array, R_ba: Array, p_b: Array, rig: RectifiedRig
) -> Array:
    """Angle (n,) [rad] in patch b of the direction that is x in patch a; maps (n, 2, 2) of
    ``features.patches``.

    p_a, normal_a (n, 3) in camera a; p_b (n, 3) in camera b; R_ba (3, 3): axes of camera a in b, seen from
    the body.
    """
    direction_a = tangent_vectors(p_a, normal_a, affine_a[:, :, 0], rig)
    pixels = np.einsum("nij,nj->ni", image_jacobian(p_b, rig), direction_a @ R_ba.T)
    x, y = np.linalg.solve(affine_b, pixels[..., None])[..., 0].T
    return np.asarray(np.arctan2(y, x))


def scene_rig(points: ScenePoints) -> RectifiedRig:
    """The scene's left camera; patches need no baseline."""
    height, width = points.grey.shape[1:]
    u, v = points.centre_px
    return RectifiedRig(float(points.focal_px), float(u), float(v), 1.0, int(width), int(height))


def camera_rotation(points: ScenePoints, a: int, b: int) -> Array:
    """R_ba (3, 3): axes of the camera at frame a in those at frame b, seen from the body."""
    return np.asarray(points.X_KG[b, :3, :3] @ points.X_KG[a, :3, :3].T)


def correlation(a: Patches, b: Patches) -> Array:
    """Normalised correlation (n,) of the logarithms of patches (n, 1, s, s)."""
    flat = [np.log1p(each / 4.0).reshape(len(each), -1) for each in (a, b)]
    x, y = (each - each.mean(axis=1, keepdims=True) for each in flat)
    norm = np.linalg.norm(x, axis=1) * np.linalg.norm(y, axis=1)
    return np.asarray((x * y).sum(axis=1) / np.maximum(norm, 1e-6), dtype=np.float64)


def _correlations(points: ScenePoints, a: int, b: int, sighting: Ints) -> Array:
    """Correlation (n,) of the patches of frame a's points and of their key points in frame b."""
    own, again = points.point[sighting], points.again[sighting]
    half_m = np.full(len(own), HALF_PX * float(np.median(points.p_K[own, 2])) / float(points.focal_px))
    rig, R_ba = scene_rig(points), camera_rotation(points, a, b)
    affine_a, affine_b = (
        tangent_affines(points.p_K[i], points.normal_K[i], rig, half_m) for i in (own, again)
    )
    rotation = patch_rotation(
        affine_a, affine_b, points.p_K[own], points.normal_K[own], R_ba, points.p_K[again], rig
    )
    patches_a = cut_patches(points.grey[a], points.uv_px[own], affine_a)
    patches_b = cut_patches(points.grey[b], points.uv_px[again], rotate_affines(affine_b, rotation))
    return correlation(patches_a, patches_b)


@dataclass(frozen=True)
class FramePair:
    """Two frames of a scene, and the first one's points that are detected again in the second."""

    scene: int
    a: int
    b: int
    found: Ints
    """(n,) sightings"""


@dataclass(frozen=True)
class SurfacePoints:
    """Surface points of one image at which patches are cut."""

    uv_px: Array
    """(n, 2)"""
    p_K: Array
    """(n, 3) [m]"""
    normal_K: Array
    """(n, 3)"""


def frame_pairs(points: ScenePoints, same: Bools, number: int, max_angle_rad: float) -> list[FramePair]:
    """Pairs of a scene's frames with enough common points, seen from directions within ``max_angle_rad``.

    ``same`` (M,): sightings with the same appearance.
    """
    count = int(points.X_KG.shape[0])
    usable = same & (points.angle_rad < max_angle_rad)
    key = np.where(usable, points.frame[points.point] * count + points.other, -1)
    pairs = []
    for each in np.unique(key[key >= 0]):
        found = np.flatnonzero(key == each)
        if len(found) >= MIN_COMMON_POINTS:
            pairs.append(FramePair(number, int(each) // count, int(each) % count, found))
    return pairs


class PatchBatches:
    """Draws the batch of each step."""

    def __init__(self, scenes: Mapping[int, ScenePoints], config: DescriptorTraining, seed: int) -> None:
        self._scenes, self._config, self._seed = scenes, config, seed
        same = {i: same_appearance(points) for i, points in scenes.items()}
        max_angle_rad = np.deg2rad(MAX_TURN_DEG)
        self._frame_pairs = {
            i: frame_pairs(points, same[i], i, max_angle_rad) for i, points in scenes.items()
        }
        self._distractors = {i: distractor_points(points, same[i]) for i, points in scenes.items()}
        self._drawable = [i for i, its in self._frame_pairs.items() if its]

    @property
    def is_empty(self) -> bool:
        """Whether no two frames have enough common points."""
        return not self._drawable

    def batch(self, step: int) -> Batch:
        """``patches`` (2 m + k, 1, s, s): the first patches of m pairs, their second ones, k distractors.

        ``pair`` (m,) and ``distractors`` (k,): the frame pair of each; ``uv_...`` (., 2) [px] and ``p_...``
        (., 3) [m] of a, b and distractor, each in its camera; ``rotation`` (m,): angle in the second patch of
        the direction that is x in the first [rad]; ``X_AB`` (c, 4, 4): the motion of each frame pair.
        """
        rng = np.random.default_rng([self._seed, 0xBA7C, step])
        count = self._config.frame_pairs
        each = self._config.batch // count
        distractor = round(each * DISTRACTORS)
        first, second, distractors, rotations, motions = [], [], [], [], []
        places: dict[str, list[SurfacePoints]] = {"a": [], "b": [], "distractor": []}
        for _ in range(count):
            number = self._drawable[rng.integers(len(self._drawable))]
            its = self._frame_pairs[number]
            pair = its[rng.integers(len(its))]
            points = self._scenes[number]
            half_m = self._half_m(points, pair.a, rng)
            chosen = rng.permutation(pair.found)[:each]
            a, b = _at(points, points.point[chosen]), _at(points, points.again[chosen])
            affine_a, affine_b = (self._affine(points, at, half_m, rng) for at in (a, b))
            R_ba = camera_rotation(points, pair.a, pair.b)
            rotations.append(
                patch_rotation(affine_a, affine_b, a.p_K, a.normal_K, R_ba, b.p_K, scene_rig(points))
            )
            first.append(self._cut(points, pair.a, a, affine_a, rng))
            second.append(self._cut(points, pair.b, b, affine_b, rng))
            here = np.flatnonzero(self._distractors[number] & (points.frame == pair.b))
            off = _at(points, rng.permutation(here)[:distractor])
            distractors.append(self._cut(points, pair.b, off, self._affine(points, off, half_m, rng), rng))
            motions.append(points.X_KG[pair.a] @ inverse_pose(points.X_KG[pair.b]))
            for name, at in (("a", a), ("b", b), ("distractor", off)):
                places[name].append(at)
        patches = np.concatenate([*first, *second, *distractors])
        owner = [np.full(len(cut), k) for k, cut in enumerate(first)]
        owner_distractor = [np.full(len(cut), k) for k, cut in enumerate(distractors)]
        return {
            "patches": torch.from_numpy(patches),
            "pair": torch.from_numpy(np.concatenate(owner)),
            "distractors": torch.from_numpy(np.concatenate(owner_distractor)),
            "rotation": _tensor(rotations),
            "X_AB": _tensor([np.stack(motions)]),
            **{f"uv_{name}": _tensor([at.uv_px for at in those]) for name, those in places.items()},
            **{f"p_{name}": _tensor([at.p_K for at in those]) for name, those in places.items()},
        }

    def _half_m(self, points: ScenePoints, frame: int, rng: np.random.Generator) -> float:
        """Half the side of the patches on the surface, the same for both frames [m]."""
        least, most = HALF_RANGE_PX
        half_px = float(np.exp(rng.uniform(np.log(least), np.log(most))))
        depth_m = float(np.nanmedian(points.p_K[points.frame == frame, 2]))
        return half_px * depth_m / float(points.focal_px)

    def _affine(
        self, points: ScenePoints, at: SurfacePoints, half_m: float, rng: np.random.Generator
    ) -> Array:
        """Maps (n, 2, 2) of patches at the points, with the errors of a run and random rotations."""
        n, config = len(at.uv_px), self._config
        half = half_m * np.exp(rng.normal(0.0, SCALE_NOISE, n))
        normal = perturbed_normals(at.normal_K, np.deg2rad(config.normal_noise_deg), rng)
        affine = tangent_affines(at.p_K, normal, scene_rig(points), half)
        flat = rng.random(n) < config.fronto_parallel
        affine[flat] = upright_affines(half[flat] * float(points.focal_px) / at.p_K[flat, 2])
        return rotate_affines(affine, rng.uniform(0.0, 2.0 * np.pi, n))

    def _cut(
        self, points: ScenePoints, frame: int, at: SurfacePoints, affine_px: Array, rng: np.random.Generator
    ) -> Patches:
        """Patches (n, 1, s, s) near the points."""
        uv = at.uv_px + rng.normal(0.0, self._config.place_noise_px, at.uv_px.shape)
        return cut_patches(points.grey[frame], uv, affine_px)


def _tensor(parts: Sequence[Array]) -> Tensor:
    """The parts concatenated, in single precision."""
    return torch.from_numpy(np.concatenate(parts).astype(np.float32))


def perturbed_normals(normal: Array, sigma_rad: float, rng: np.random.Generator) -> Array:
    """Unit normals (n, 3) with an error of ``sigma_rad`` rms."""
    off = normal + rng.normal(0.0, sigma_rad / np.sqrt(2.0), normal.shape)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


def _at(points: ScenePoints, index: Ints) -> SurfacePoints:
    return SurfacePoints(points.uv_px[index], points.p_K[index], points.normal_K[index])


def distractor_points(points: ScenePoints, same: Bools) -> Bools:
    """Key points (N,) that are not surface features: on edges of shadows, near silhouettes, or never
    redetected.

    ``same`` (M,): sightings with the same appearance. A point that half of the frames redetect is no
    distractor.
    """
    seen = np.bincount(points.point, minlength=len(points.uv_px))
    again = np.bincount(points.point[same], minlength=len(points.uv_px))
    often = again >= 0.5 * np.maximum(seen, 1)
    suspect = points.on_shadow | points.on_rim | (again == 0)
    return np.asarray(np.isfinite(points.p_K).all(axis=1) & suspect & ~often)
