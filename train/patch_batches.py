"""Batches of patch pairs: one surface point in two frames, cut as a run would cut it, with a run's errors.

Points of the same two frames are each other's hard negatives. Beside the pairs a batch holds strays: key
points that are no surface feature (edges of cast shadows, silhouettes) or that nobody finds again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from polhode.config.train import DescriptorTraining
from polhode.frontend.features.patches import Patches, cut_patches, tangent_affines, turned, upright_affines
from polhode.lie import Array, inverse_pose
from polhode.records import Bools, Ints
from polhode.train.alikeness import alike, rig_of, turn_of
from polhode.train.points import ScenePoints
from polhode.train.surface_turn import turn_between
from polhode.train.task import Batch

FEWEST = 12
"""Two frames with fewer points in common are not drawn."""


@dataclass(frozen=True)
class FramePair:
    """Two frames of a scene and the first's points that are found again in the second."""

    scene: int
    a: int
    b: int
    found: Ints
    """(n,) sightings"""


@dataclass(frozen=True)
class Places:
    """Where patches are to be cut in one image."""

    uv_px: Array
    """(n, 2)"""
    p_K: Array
    """(n, 3) [m]"""
    normal_K: Array
    """(n, 3)"""


def frame_pairs(points: ScenePoints, same: Bools, number: int, most_turn_rad: float) -> list[FramePair]:
    """Pairs of a scene's frames with enough points in common, seen from directions within ``most_turn_rad``.

    ``same`` (M,): sightings that are found again.
    """
    count = int(points.X_KG.shape[0])
    usable = same & (points.angle_rad < most_turn_rad)
    key = np.where(usable, points.frame[points.point] * count + points.other, -1)
    pairs = []
    for each in np.unique(key[key >= 0]):
        found = np.flatnonzero(key == each)
        if len(found) >= FEWEST:
            pairs.append(FramePair(number, int(each) // count, int(each) % count, found))
    return pairs


class PatchBatches:
    """Draws the batch of a step."""

    def __init__(self, scenes: Mapping[int, ScenePoints], config: DescriptorTraining, seed: int) -> None:
        self._scenes, self._config, self._seed = scenes, config, seed
        same = {i: alike(points) for i, points in scenes.items()}
        most_rad = np.deg2rad(config.most_turn_deg)
        self._of_scene = {i: frame_pairs(points, same[i], i, most_rad) for i, points in scenes.items()}
        self._strays = {i: stray_points(points, same[i]) for i, points in scenes.items()}
        self._drawable = [i for i, its in self._of_scene.items() if its]

    @property
    def is_empty(self) -> bool:
        """Whether no two frames share enough points."""
        return not self._drawable

    def batch(self, step: int) -> Batch:
        """``patches`` (2 m + k, 1, s, s): the first of m pairs, their second, k strays of the second frames.

        ``pair`` (m,) and ``strays`` (k,): which frame pair each is of; ``uv_...`` (., 2) [px] and ``p_...``
        (., 3) [m] of a, b and stray, each in its camera; ``turn`` (m,): angle in the second patch of what
        lies along x in the first [rad]; ``X_AB`` (c, 4, 4) the motion of each frame pair.
        """
        rng = np.random.default_rng([self._seed, 0xBA7C, step])
        count = self._config.frame_pairs
        each = self._config.batch // count
        stray = round(each * self._config.strays)
        first, second, strays, turns, motions = [], [], [], [], []
        places: dict[str, list[Places]] = {"a": [], "b": [], "stray": []}
        for _ in range(count):
            number = self._drawable[rng.integers(len(self._drawable))]
            its = self._of_scene[number]
            pair = its[rng.integers(len(its))]
            points = self._scenes[number]
            half_m = self._half_m(points, pair.a, rng)
            chosen = rng.permutation(pair.found)[:each]
            a, b = _at(points, points.point[chosen]), _at(points, points.again[chosen])
            affine_a, affine_b = (self._affine(points, at, half_m, rng) for at in (a, b))
            R_ba = np.broadcast_to(turn_of(points, pair.a, pair.b), (len(chosen), 3, 3))
            turns.append(turn_between(affine_a, affine_b, a.p_K, a.normal_K, R_ba, b.p_K, rig_of(points)))
            first.append(self._cut(points, pair.a, a, affine_a, rng))
            second.append(self._cut(points, pair.b, b, affine_b, rng))
            here = np.flatnonzero(self._strays[number] & (points.frame == pair.b))
            off = _at(points, rng.permutation(here)[:stray])
            strays.append(self._cut(points, pair.b, off, self._affine(points, off, half_m, rng), rng))
            motions.append(points.X_KG[pair.a] @ inverse_pose(points.X_KG[pair.b]))
            for name, at in (("a", a), ("b", b), ("stray", off)):
                places[name].append(at)
        patches = np.concatenate([*first, *second, *strays])
        owner = [np.full(len(cut), k) for k, cut in enumerate(first)]
        owner_stray = [np.full(len(cut), k) for k, cut in enumerate(strays)]
        return {
            "patches": torch.from_numpy(patches),
            "pair": torch.from_numpy(np.concatenate(owner)),
            "strays": torch.from_numpy(np.concatenate(owner_stray)),
            "turn": _tensor(turns),
            "X_AB": _tensor([np.stack(motions)]),
            **{f"uv_{name}": _tensor([at.uv_px for at in those]) for name, those in places.items()},
            **{f"p_{name}": _tensor([at.p_K for at in those]) for name, those in places.items()},
        }

    def _half_m(self, points: ScenePoints, frame: int, rng: np.random.Generator) -> float:
        """Half the side of the patches on the surface, the same for both frames [m]."""
        least, most = self._config.half_px
        half_px = float(np.exp(rng.uniform(np.log(least), np.log(most))))
        depth_m = float(np.nanmedian(points.p_K[points.frame == frame, 2]))
        return half_px * depth_m / float(points.focal_px)

    def _affine(self, points: ScenePoints, at: Places, half_m: float, rng: np.random.Generator) -> Array:
        """Maps (n, 2, 2) of patches at places, off by what a run does not know, turned at random."""
        n, config = len(at.uv_px), self._config
        half = half_m * np.exp(rng.normal(0.0, config.scale_noise, n))
        normal = leaning(at.normal_K, np.deg2rad(config.normal_noise_deg), rng)
        affine = tangent_affines(at.p_K, normal, rig_of(points), half)
        flat = rng.random(n) < config.fronto_parallel
        affine[flat] = upright_affines(half[flat] * float(points.focal_px) / at.p_K[flat, 2])
        return turned(affine, rng.uniform(0.0, 2.0 * np.pi, n))

    def _cut(
        self, points: ScenePoints, frame: int, at: Places, affine_px: Array, rng: np.random.Generator
    ) -> Patches:
        """Patches (n, 1, s, s) near the places."""
        uv = at.uv_px + rng.normal(0.0, self._config.place_noise_px, at.uv_px.shape)
        return cut_patches(points.grey[frame], uv, affine_px)


def _tensor(parts: Sequence[Array]) -> Tensor:
    """The parts together, in single precision."""
    return torch.from_numpy(np.concatenate(parts).astype(np.float32))


def leaning(normal: Array, sigma_rad: float, rng: np.random.Generator) -> Array:
    """Unit normals (n, 3) with an error of ``sigma_rad`` rms."""
    off = normal + rng.normal(0.0, sigma_rad / np.sqrt(2.0), normal.shape)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


def _at(points: ScenePoints, index: Ints) -> Places:
    return Places(points.uv_px[index], points.p_K[index], points.normal_K[index])


def stray_points(points: ScenePoints, same: Bools) -> Bools:
    """Key points (N,) that are no surface feature: on the edges of shadows, near silhouettes, or never found.

    ``same`` (M,): sightings that are found again. What half of the frames find again is no stray.
    """
    seen = np.bincount(points.point, minlength=len(points.uv_px))
    again = np.bincount(points.point[same], minlength=len(points.uv_px))
    often = again >= 0.5 * np.maximum(seen, 1)
    suspect = points.on_shadow | points.on_rim | (again == 0)
    return np.asarray(np.isfinite(points.p_K).all(axis=1) & suspect & ~often)
