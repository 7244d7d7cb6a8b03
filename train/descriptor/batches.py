"""Batches of patch pairs: the same surface point in two frames, cut as in a run and with the errors of a run.

Points of the same two frames are each other's hard negatives. In addition a batch contains distractors: key
points that are not surface features (edges of cast shadows, silhouettes) or that are not detected in other
frames.

Pairs must show the same mark: with many weak key points a third of those within 1.5 px of the true position
are coincidences, or the light has changed the surface beyond recognition: nothing can be learned from them.
Therefore both patches are cut by the ground truth, rotated to the same orientation, and correlated.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from polhode.config.train_settings import DescriptorTraining
from polhode.files.images import Grey
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
DISTRACTORS = 0.25
"""Number of key points that are no surface feature, over the number of pairs."""
HALF_RANGE_PX = (10.0, 15.0)
"""Half the side of a patch at the scene's middle depth, least and most; on the surface, both patches of a
pair have the same size."""


@dataclass(frozen=True)
class SurfacePoints:
    """Surface points of one image."""

    uv_px: Array
    """(n, 2)"""
    p_K: Array
    """(n, 3) [m]"""
    normal_K: Array
    """(n, 3) unit, towards the camera"""

    def __getitem__(self, index: Ints | Bools) -> "SurfacePoints":
        return SurfacePoints(self.uv_px[index], self.p_K[index], self.normal_K[index])


def points_at(points: ScenePoints, index: Ints) -> SurfacePoints:
    """Some of the key points of a scene."""
    return SurfacePoints(points.uv_px[index], points.p_K[index], points.normal_K[index])


@dataclass(frozen=True)
class PatchErrors:
    """Errors of a run with which patches are cut."""

    normal_deg: float
    """of normals, rms"""
    fronto_parallel: float
    """Share of the patches cut as if the surface faced the camera"""

    def affines(self, at: SurfacePoints, rig: RectifiedRig, half_m: float, rng: np.random.Generator) -> Array:
        """Maps (n, 2, 2) of patches at points, with these errors and random rotations."""
        n = len(at.p_K)
        # standard deviation of the logarithm of a patch's scale
        half = half_m * np.exp(rng.normal(0.0, 0.1, n))
        normal = perturbed_normals(at.normal_K, np.deg2rad(self.normal_deg), rng)
        affine = tangent_affines(at.p_K, normal, rig, half)
        flat = rng.random(n) < self.fronto_parallel
        affine[flat] = upright_affines(half[flat] * rig.focal_px / at.p_K[flat, 2])
        return rotate_affines(affine, rng.uniform(0.0, 2.0 * np.pi, n))


def random_half_m(depth_m: float, focal_px: float, rng: np.random.Generator) -> float:
    """Half the side of the patches on the surface [m], for surface at a depth."""
    low, high = np.log(HALF_RANGE_PX)
    return float(np.exp(rng.uniform(low, high))) * depth_m / focal_px


def perturbed_normals(normal: Array, sigma_rad: float, rng: np.random.Generator) -> Array:
    """Unit normals (n, 3) with an error of ``sigma_rad`` rms."""
    off = normal + rng.normal(0.0, sigma_rad / np.sqrt(2.0), normal.shape)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


def patch_rotation(
    affine_a: Array, affine_b: Array, a: SurfacePoints, p_b: Array, R_ba: Array, rig: RectifiedRig
) -> Array:
    """Angle (n,) [rad] in patch b of the direction that is x in patch a; maps (n, 2, 2) of
    ``features.patches``.

    p_b (n, 3) in camera b; R_ba (3, 3): axes of camera a in b, seen from the body.
    """
    direction_a = tangent_vectors(a.p_K, a.normal_K, affine_a[:, :, 0], rig)
    pixels = np.einsum("nij,nj->ni", image_jacobian(p_b, rig), direction_a @ R_ba.T)
    x, y = np.linalg.solve(affine_b, pixels[..., None])[..., 0].T
    return np.asarray(np.arctan2(y, x))


def same_marks(
    images: tuple[Grey, Grey], a: SurfacePoints, b: SurfacePoints, R_ba: Array, rigs: tuple[RectifiedRig, ...]
) -> Bools:
    """Whether patches (n,) at points of two images, cut by the truth in one orientation, correlate."""
    if len(a.p_K) == 0:
        return np.zeros(0, dtype=bool)
    half_m = np.full(len(a.p_K), HALF_PX * float(np.median(a.p_K[:, 2])) / rigs[0].focal_px)
    affine_a, affine_b = (
        tangent_affines(at.p_K, at.normal_K, rig, half_m) for at, rig in zip((a, b), rigs, strict=True)
    )
    rotation = patch_rotation(affine_a, affine_b, a, b.p_K, R_ba, rigs[0])
    patches_a = cut_patches(images[0], a.uv_px, affine_a)
    patches_b = cut_patches(images[1], b.uv_px, rotate_affines(affine_b, rotation))
    # correlation of the logarithms above which two patches show the same mark
    return correlation(patches_a, patches_b) > 0.3


def correlation(a: Patches, b: Patches) -> Array:
    """Normalised correlation (n,) of the logarithms of patches (n, 1, s, s)."""
    flat = [np.log1p(each / 4.0).reshape(len(each), -1) for each in (a, b)]
    x, y = (each - each.mean(axis=1, keepdims=True) for each in flat)
    norm = np.linalg.norm(x, axis=1) * np.linalg.norm(y, axis=1)
    return np.asarray((x * y).sum(axis=1) / np.maximum(norm, 1e-6), dtype=np.float64)


def same_appearance(points: ScenePoints) -> Bools:
    """Whether each sighting (M,) has a key point that looks like the original."""
    known, rig = np.asarray(np.isfinite(points.p_K).all(axis=1)), scene_rig(points)
    redetected = (points.again >= 0) & known[points.point] & known[points.again]
    result = np.zeros(len(points.point), dtype=bool)
    first = points.frame[points.point]
    for a, image_a in enumerate(points.grey):
        for b, image_b in enumerate(points.grey):
            here = np.flatnonzero(redetected & (first == a) & (points.other == b))
            own, again = (points_at(points, i[here]) for i in (points.point, points.again))
            R_ba = camera_rotation(points, a, b)
            result[here] = same_marks((image_a, image_b), own, again, R_ba, (rig, rig))
    return result


def scene_rig(points: ScenePoints) -> RectifiedRig:
    """The scene's left camera; patches need no baseline."""
    height, width = points.grey.shape[1:]
    u, v = points.centre_px
    return RectifiedRig(float(points.focal_px), float(u), float(v), 1.0, int(width), int(height))


def camera_rotation(points: ScenePoints, a: int, b: int) -> Array:
    """R_ba (3, 3): axes of the camera at frame a in those at frame b, seen from the body."""
    return np.asarray(points.X_KG[b, :3, :3] @ points.X_KG[a, :3, :3].T)


@dataclass(frozen=True)
class FramePair:
    """Two frames of a scene, and the first one's points that are detected again in the second."""

    a: int
    b: int
    found: Ints
    """(n,) sightings"""


def frame_pairs(points: ScenePoints, same: Bools, max_angle_rad: float) -> list[FramePair]:
    """Pairs of a scene's frames with enough common points, seen from directions within ``max_angle_rad``.

    ``same`` (M,): sightings with the same appearance.
    """
    count = int(points.X_KG.shape[0])
    usable = same & (points.angle_rad < max_angle_rad)
    key = np.where(usable, points.frame[points.point] * count + points.other, -1)
    pairs = []
    for each in np.unique(key[key >= 0]):
        found = np.flatnonzero(key == each)
        if len(found) >= 12:  # frame pairs with fewer common points are not used
            pairs.append(FramePair(int(each) // count, int(each) % count, found))
    return pairs


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


class PatchBatches:
    """Draws the batch of each step."""

    def __init__(self, scenes: Mapping[int, ScenePoints], config: DescriptorTraining, seed: int) -> None:
        self._config, self._seed = config, seed
        self._scenes: list[tuple[ScenePoints, list[FramePair], Bools]] = []
        for points in scenes.values():
            same = same_appearance(points)
            # largest angle between the two views of a point
            pairs = frame_pairs(points, same, np.deg2rad(70.0))
            if pairs:
                self._scenes.append((points, pairs, distractor_points(points, same)))

    @property
    def is_empty(self) -> bool:
        """Whether no two frames have enough common points."""
        return not self._scenes

    def batch(self, step: int) -> Batch:
        """``patches`` (2 m + k, 1, s, s): the first patches of m pairs, their second ones, k distractors.

        ``pair`` (m,) and ``distractors`` (k,): the frame pair of each; ``uv_...`` (., 2) [px] and ``p_...``
        (., 3) [m] of a, b and distractor, each in its camera; ``rotation`` (m,): angle in the second patch of
        the direction that is x in the first [rad]; ``X_AB`` (c, 4, 4): the motion of each frame pair.
        """
        config = self._config
        rng = np.random.default_rng([self._seed, 0xBA7C, step])
        each = config.batch // config.frame_pairs
        errors = PatchErrors(config.normal_noise_deg, config.fronto_parallel)
        rows: dict[str, list[Array]] = {}
        for number in range(config.frame_pairs):
            points, pairs, is_distractor = self._scenes[rng.integers(len(self._scenes))]
            pair = pairs[rng.integers(len(pairs))]
            rig, R_ba = scene_rig(points), camera_rotation(points, pair.a, pair.b)
            depth_m = float(np.nanmedian(points.p_K[points.frame == pair.a, 2]))
            half_m = random_half_m(depth_m, rig.focal_px, rng)
            chosen = rng.permutation(pair.found)[:each]
            a, b = points_at(points, points.point[chosen]), points_at(points, points.again[chosen])
            affine_a, affine_b = (errors.affines(at, rig, half_m, rng) for at in (a, b))
            patches_a = self._cut(points.grey[pair.a], a, affine_a, rng)
            patches_b = self._cut(points.grey[pair.b], b, affine_b, rng)
            free = np.flatnonzero(is_distractor & (points.frame == pair.b))
            off = points_at(points, rng.permutation(free)[: round(each * DISTRACTORS)])
            affine_off = errors.affines(off, rig, half_m, rng)
            for name, value in {
                "patches_a": patches_a,
                "patches_b": patches_b,
                "patches_distractor": self._cut(points.grey[pair.b], off, affine_off, rng),
                "pair": np.full(len(a.p_K), number),
                "distractors": np.full(len(off.p_K), number),
                "rotation": patch_rotation(affine_a, affine_b, a, b.p_K, R_ba, rig),
                "X_AB": (points.X_KG[pair.a] @ inverse_pose(points.X_KG[pair.b]))[None],
                "uv_a": a.uv_px,
                "uv_b": b.uv_px,
                "uv_distractor": off.uv_px,
                "p_a": a.p_K,
                "p_b": b.p_K,
                "p_distractor": off.p_K,
            }.items():
                rows.setdefault(name, []).append(value)
        batch = batch_of_rows(rows)
        patches = [batch.pop(f"patches_{name}") for name in ("a", "b", "distractor")]
        return {"patches": torch.cat(patches), **batch}

    def _cut(self, image: Grey, at: SurfacePoints, affine_px: Array, rng: np.random.Generator) -> Patches:
        """Patches (n, 1, s, s) near the points."""
        uv = at.uv_px + rng.normal(0.0, self._config.place_noise_px, at.uv_px.shape)
        return cut_patches(image, uv, affine_px)


def batch_of_rows(rows: Mapping[str, list[Any]]) -> Batch:
    """The rows of each name in one tensor; numbers that are not whole become single precision."""
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    return {
        name: torch.from_numpy(value.astype(np.float32) if value.dtype.kind == "f" else value)
        for name, value in joined.items()
    }
