"""Batches of the surface network: pairs of images of one body that differ in light, in pose, or in both.

A pair has the landmarks that both images show, with patches cut with the errors of a run, and distractors:
key points of the second image that are no landmarks. Where the Sun stands still and the body turns, the
light's own marks are among them, and look like those of the first image.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from polhode.geometry.lie import Array, Bools, Ints
from polhode.train.descriptor.batches import (
    PatchErrors,
    SurfacePoints,
    batch_of_rows,
    patch_rotation,
    random_half_m,
    same_marks,
)
from polhode.train.surface.landmarks import KnownBody, seen_in, surface_at
from polhode.train.surface.lit_bodies import SKY, LitBody
from polhode.train.task import Batch

MIN_COMMON = 12
"""Landmarks that both images of a pair show, at least."""
NEAR_PX = 1.5
"""Pixels this close to a landmark learn its place [px]."""
ERRORS, PLACE_NOISE_PX = PatchErrors(8.0, 0.05), 0.4
"""Errors of a run: of the maps of patches, of places [px]."""
_TRIES = 12


@dataclass(frozen=True)
class Window:
    """A part of a view: the views' parts may be larger than what a step looks at."""

    u0: int
    v0: int
    side_u: int
    side_v: int

    @property
    def part(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return np.s_[self.v0 : self.v0 + self.side_v, self.u0 : self.u0 + self.side_u]

    @property
    def corner_px(self) -> Array:
        """(2,) its first pixel (u, v)."""
        return np.array([self.u0, self.v0], float)

    def has(self, uv_px: Array) -> Bools:
        """Which places (n, 2) are inside, three pixels from the border."""
        u, v = (uv_px - self.corner_px).T
        return np.asarray((u > 3) & (v > 3) & (u < self.side_u - 4) & (v < self.side_v - 4))

    @classmethod
    def around(cls, body: LitBody, pose: int, middle_px: Array, largest_px: int) -> "Window":
        """The pose's target, or as much of it around a place as is allowed."""
        mask = body.on_target(pose)
        starts, sides = [], []
        for axis in (0, 1):
            lines, length = np.flatnonzero(mask.any(axis=axis)), mask.shape[1 - axis]
            first, last = max(int(lines[0]) - 8, 0), min(int(lines[-1]) + 9, length)
            if last - first > largest_px:
                first = int(np.clip(round(middle_px[axis]) - largest_px // 2, first, last - largest_px))
                last = first + largest_px
            starts.append(first)
            sides.append(last - first)
        return cls(starts[0], starts[1], sides[0], sides[1])


@dataclass(frozen=True)
class Example:
    """One pair of images."""

    known: KnownBody
    views: tuple[int, int]
    windows: tuple[Window, Window]
    index: Ints
    """(n,) the landmarks, weak ones among them, that look alike in both windows"""
    common: tuple[SurfacePoints, SurfacePoints]
    """these n as both images show them"""

    @property
    def poses(self) -> tuple[int, int]:
        """Of both images."""
        a, b = self.views
        return self.known.body.pose_of(a), self.known.body.pose_of(b)


def draw_example(
    known: KnownBody, rng: np.random.Generator, largest_px: int, kinds: Sequence[float], wide: float = 0.0
) -> Example | None:
    """A pair of images with enough common landmarks; None: none was found.

    kinds (3,): shares of pairs that differ in light alone, in pose alone, in both; wide: share of the pairs
    of different poses that are the first and the last one, the farthest apart.
    """
    body, landmarks = known.body, known.landmarks
    poses = body.poses
    suns = len(body.grey) // poses
    for _ in range(_TRIES):
        kind = rng.choice(3, p=np.asarray(kinds))
        pose_a, sun_a = int(rng.integers(poses)), int(rng.integers(suns))
        if kind != 0 and rng.random() < wide:
            pose_a = (poses - 1) * int(rng.integers(2))
            pose_b = poses - 1 - pose_a
        else:
            pose_b = pose_a if kind == 0 else int((pose_a + rng.integers(1, poses)) % poses)
        sun_b = sun_a if kind == 1 else int((sun_a + rng.integers(1, suns)) % suns)
        views = sun_a * poses + pose_a, sun_b * poses + pose_b
        seen = [seen_in(body, view, landmarks.p_G, landmarks.normal_G) for view in views]
        index, at_a, at_b = np.intersect1d(seen[0][0], seen[1][0], return_indices=True)
        if len(index) < MIN_COMMON:
            continue
        a, b = seen[0][1][at_a], seen[1][1][at_b]
        middle = int(rng.integers(len(index)))
        windows = (
            Window.around(body, pose_a, a.uv_px[middle], largest_px),
            Window.around(body, pose_b, b.uv_px[middle], largest_px),
        )
        inside = np.flatnonzero(windows[0].has(a.uv_px) & windows[1].has(b.uv_px))
        images = body.grey[views[0]], body.grey[views[1]]
        R_ba, rigs = body.X_between(pose_b, pose_a)[:3, :3], (body.rig(pose_a), body.rig(pose_b))
        alike = inside[same_marks(images, a[inside], b[inside], R_ba, rigs)]
        if len(alike) >= MIN_COMMON:
            return Example(known, views, windows, index[alike], (a[alike], b[alike]))
    return None


def batch_of(examples: Sequence[Example], points: int, rng: np.random.Generator) -> Batch:
    """The batch of c examples with up to ``points`` landmarks each.

    What has the images' size is stored in few bits: it travels between processes. Images 2 k and 2 k + 1 are
    those of example k. ``images`` (2 c, 1, h, w); ``light``, ``heat``, ``weight``
    (2 c, h, w): kind of light, map of the landmarks, and whether a pixel's score counts; ``near`` (q, 3):
    image, row and column of pixels near landmarks, and ``place`` (q, 2): the landmark's place less the
    pixel's centre. Points (2 m + k), the first ones of m pairs, the second ones, distractors: ``owner``,
    ``uv``, ``affine``. ``plane_...`` (m, 3): the plane of the surface n / (n . p), in its camera;
    ``centre_...`` (c, 2) and ``focal`` (c,) of the images; ``is_strict`` (m,): no weak landmark; ``pair``,
    ``distractors``, ``rotation``, ``uv_...``, ``p_...``, ``X_AB`` as ``train.descriptor.batches``.
    """
    windows = [window for example in examples for window in example.windows]
    height, width = (
        -(-max(sides) // 8) * 8 for sides in zip(*((w.side_v, w.side_u) for w in windows), strict=True)
    )
    images = np.zeros((2 * len(examples), 1, height, width), np.uint8)
    light = np.full((len(images), height, width), SKY, np.uint8)
    heat, weight = np.zeros(light.shape, np.float32), np.zeros(light.shape, bool)
    rows: dict[str, list[NDArray[np.generic]]] = {}
    for k, example in enumerate(examples):
        body = example.known.body
        for side in (0, 1):
            image, view, window, pose = (
                2 * k + side,
                example.views[side],
                example.windows[side],
                example.poses[side],
            )
            # black beyond a mask that is a little too large
            mask, reach = body.on_target(pose).astype(np.uint8), int(rng.integers(0, 4))
            wide = cv2.dilate(mask, np.ones((3, 3), np.uint8), iterations=reach) if reach else mask
            corner = np.s_[: window.side_v, : window.side_u]
            images[image, 0][corner] = np.where(wide[window.part] > 0, body.grey[view][window.part], 0)
            light[image][corner] = body.light[view][window.part]
            weight[image][corner] = mask[window.part] > 0
            cells, offsets = _targets(example, side, heat[image], weight[image])
            rows.setdefault("near", []).append(np.column_stack([np.full(len(cells), image), cells]))
            rows.setdefault("place", []).append(offsets)
        for name, value in _points(example, k, points, rng).items():
            rows.setdefault(name, []).append(value)
    # the points of all examples by kind: the first ones of pairs, the second ones, distractors
    for name in ("uv", "affine", "owner"):
        rows[name] = [each for kind in ("a", "b", "distractor") for each in rows[f"{name}_{kind}"]]
    uv = np.concatenate(rows["uv"])
    rows["uv"] = [uv + rng.normal(0.0, PLACE_NOISE_PX, uv.shape)]
    whole = {"images": images, "light": light, "heat": heat.astype(np.float16), "weight": weight}
    batch = batch_of_rows({k: each for k, each in rows.items() if not k.startswith(("affine_", "owner_"))})
    return {name: torch.from_numpy(value) for name, value in whole.items()} | batch


def _targets(example: Example, side: int, heat: NDArray[np.float32], weight: Bools) -> tuple[Ints, Array]:
    """Fill the map of landmarks, and change the weights around them.

    Returns pixels (q, 2) (row, column) near landmarks, and the landmarks' places (q, 2) (u, v) less their
    centres.
    """
    body, landmarks, window = example.known.body, example.known.landmarks, example.windows[side]
    index, seen = seen_in(body, example.views[side], landmarks.p_G, landmarks.normal_G)
    inside = window.has(seen.uv_px)
    uv, weak = seen.uv_px[inside] - window.corner_px, landmarks.is_weak[index[inside]]
    best = np.full(heat.shape, np.inf, np.float32)
    offset = np.zeros((*heat.shape, 2), np.float32)
    base = np.round(uv).astype(int)
    for dv in (-2, -1, 0, 1, 2):
        for du in (-2, -1, 0, 1, 2):
            column, row = base[:, 0] + du, base[:, 1] + dv
            away = uv - np.column_stack([column, row])
            square = (away**2).sum(axis=1)
            close = weak & (square < NEAR_PX**2)
            weight[row[close], column[close]] = False
            own = np.flatnonzero(~weak & (square < NEAR_PX**2))
            order = own[np.argsort(-square[own])]
            nearer = order[square[order] < best[row[order], column[order]]]
            best[row[nearer], column[nearer]] = square[nearer]
            offset[row[nearer], column[nearer]] = away[nearer]
    known = np.isfinite(best)
    # standard deviation of a landmark's mark in the map of scores [px]
    heat[known] = np.exp(-best[known] / (2.0 * 0.8**2))
    heat[base[~weak, 1], base[~weak, 0]] = 1.0
    weight[known] = True
    return np.argwhere(known), offset[known].astype(np.float64)


def _points(
    example: Example, k: int, points: int, rng: np.random.Generator
) -> dict[str, NDArray[np.generic]]:
    """Landmarks of both sides and distractors of the second one, as rows of the batch."""
    body, landmarks = example.known.body, example.known.landmarks
    chosen = rng.permutation(len(example.index))[:points]
    a, b = example.common[0][chosen], example.common[1][chosen]
    pose_a, pose_b = example.poses
    rig_a, rig_b = body.rig(pose_a), body.rig(pose_b)
    half_m = random_half_m(float(np.median(a.p_K[:, 2])), rig_a.focal_px, rng)
    affine_a, affine_b = ERRORS.affines(a, rig_a, half_m, rng), ERRORS.affines(b, rig_b, half_m, rng)
    free = np.flatnonzero((landmarks.view == example.views[1]) & (landmarks.landmark < 0))
    free = free[example.windows[1].has(landmarks.uv_px[free])]
    # not the second place of a pair
    # smallest distance of a distractor from the second places of pairs [px]
    free = free[cKDTree(b.uv_px).query(landmarks.uv_px[free])[0] > 4.0]
    # number of distractors, over the number of landmarks
    off = surface_at(body, pose_b, landmarks.uv_px[rng.permutation(free)[: round(0.6 * len(chosen))]])
    off = off[np.asarray(np.isfinite(off.p_K).all(axis=1))]
    corner_a, corner_b = (window.corner_px for window in example.windows)
    n, d, X_AB = len(chosen), len(off.p_K), body.X_between(pose_a, pose_b)
    return {
        "uv_a": a.uv_px - corner_a,
        "uv_b": b.uv_px - corner_b,
        "uv_distractor": off.uv_px - corner_b,
        "affine_a": affine_a,
        "affine_b": affine_b,
        "affine_distractor": ERRORS.affines(off, rig_b, half_m, rng),
        "owner_a": np.full(n, 2 * k),
        "owner_b": np.full(n, 2 * k + 1),
        "owner_distractor": np.full(d, 2 * k + 1),
        "pair": np.full(n, k),
        "distractors": np.full(d, k),
        "is_strict": ~landmarks.is_weak[example.index[chosen]],
        "rotation": patch_rotation(affine_a, affine_b, a, b.p_K, X_AB[:3, :3].T, rig_a),
        "p_a": a.p_K,
        "p_b": b.p_K,
        "p_distractor": off.p_K,
        "X_AB": X_AB[None],
        "plane_a": a.normal_K / np.einsum("nk,nk->n", a.normal_K, a.p_K)[:, None],
        "plane_b": b.normal_K / np.einsum("nk,nk->n", b.normal_K, b.p_K)[:, None],
        "centre_a": np.array([[rig_a.cx_px, rig_a.cy_px]]) - corner_a,
        "centre_b": np.array([[rig_b.cx_px, rig_b.cy_px]]) - corner_b,
        "focal": np.array([rig_a.focal_px]),
    }
