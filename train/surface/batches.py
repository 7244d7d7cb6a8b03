"""Batches of the surface network: pairs of images of one body that differ in light, in pose, or in both.

A pair has the landmarks that both images show, with patches cut with the errors of a run, and distractors:
key points of the second image that are no landmarks. Where the Sun stands still and the body turns, the
light's own marks are among them, and look like those of the first image.

On request there are further images, which have no targets of their own: a third one of the body, for the
places of one landmark in three images; and, of a shape with several albedos, the second one under another
albedo, where the same places, in the same light, should be described otherwise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from polhode.frontend.features.patches import (
    cut_patches,
    rotate_affines,
    tangent_affines,
    upright_affines,
)
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.train.descriptor.batches import (
    HALF_PX,
    HALF_RANGE_PX,
    MIN_CORRELATION,
    SCALE_NOISE,
    correlation,
    patch_rotation,
    perturbed_normals,
)
from polhode.train.surface.landmarks import Landmarks, Seen, seen_in, surface_at
from polhode.train.surface.lit_bodies import SKY, LitBody, on_target
from polhode.train.task import Batch

MIN_COMMON = 12
"""Landmarks that both images of a pair show, at least."""
MIN_THIRD = 8
"""Of these, landmarks that a third image shows, at least."""
HEAT_PX = 0.8
"""Standard deviation of a landmark's mark in the map of scores [px]."""
NEAR_PX = 1.5
"""Pixels this close to a landmark learn its place [px]."""
APART_PX = 4.0
"""Smallest distance of a distractor from the second places of pairs [px]."""
DISTRACTORS = 0.6
"""Number of distractors, over the number of landmarks."""
NORMAL_NOISE_DEG, FRONTO_PARALLEL, PLACE_NOISE_PX = 8.0, 0.05, 0.4
"""Errors of a run: normals, rms; share of patches cut as if the surface faced the camera; places [px]."""
_TRIES = 12


class Add(Protocol):
    """Adds rows to the columns of a batch."""

    def __call__(self, **values: Array | Bools) -> None: ...


@dataclass(frozen=True)
class KnownBody:
    """A body's images and landmarks, with one albedo."""

    body: LitBody
    landmarks: Landmarks
    others: tuple[LitBody, ...] = ()
    """The same shape with other albedos"""


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

    def has(self, uv_px: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) are inside, three pixels from the border."""
        u, v = uv_px[:, 0] - self.u0, uv_px[:, 1] - self.v0
        return np.asarray((u > 3) & (v > 3) & (u < self.side_u - 4) & (v < self.side_v - 4))


@dataclass(frozen=True)
class Further:
    """An image beside a pair, and those of the pair's landmarks that it shows."""

    body: LitBody
    view: int
    window: Window
    rows: Ints
    """(n,) among the pair's"""
    seen: Seen
    """n points"""


@dataclass(frozen=True)
class Example:
    """One pair of images."""

    known: KnownBody
    views: tuple[int, int]
    windows: tuple[Window, Window]
    common: tuple[Seen, Seen]
    """The landmarks, weak ones among them, that look alike in both windows, in the same order"""
    third: Further | None = None
    """Another image of the body"""
    other_albedo: Further | None = None
    """The second image under another albedo"""


def draw_example(
    known: KnownBody,
    rng: np.random.Generator,
    largest_px: int,
    kinds: Sequence[float],
    wide: float = 0.0,
    with_third: bool = False,
) -> Example | None:
    """A pair of images with enough common landmarks; None: none was found.

    kinds (3,): shares of pairs that differ in light alone, in pose alone, in both; wide: share of the pairs
    of different poses that are the first and the last one, the farthest apart; with_third: with another image
    of the body, if one shows enough of the landmarks. A body that has other albedos gives one of them.
    """
    body, landmarks = known.body, known.landmarks
    views, poses = len(body.grey), body.poses
    suns = views // poses
    for _ in range(_TRIES):
        kind = rng.choice(3, p=np.asarray(kinds))
        pose_a, sun_a = int(rng.integers(poses)), int(rng.integers(suns))
        if kind != 0 and rng.random() < wide:
            pose_a = (poses - 1) * int(rng.integers(2))
            pose_b = poses - 1 - pose_a
        else:
            pose_b = pose_a if kind == 0 else int((pose_a + rng.integers(1, poses)) % poses)
        sun_b = sun_a if kind == 1 else int((sun_a + rng.integers(1, suns)) % suns)
        a, b = sun_a * poses + pose_a, sun_b * poses + pose_b
        seen_a, seen_b = (seen_in(body, view, landmarks.p_G, landmarks.normal_G) for view in (a, b))
        _, at_a, at_b = np.intersect1d(seen_a.index, seen_b.index, return_indices=True)
        if len(at_a) < MIN_COMMON:
            continue
        middle = int(rng.integers(len(at_a)))
        window_a = _window(body, pose_a, seen_a.uv_px[at_a[middle]], largest_px)
        window_b = _window(body, pose_b, seen_b.uv_px[at_b[middle]], largest_px)
        inside = window_a.has(seen_a.uv_px[at_a]) & window_b.has(seen_b.uv_px[at_b])
        common = _some(seen_a, at_a[inside]), _some(seen_b, at_b[inside])
        alike = np.flatnonzero(_correlations(body, (a, b), common) > MIN_CORRELATION)
        if len(alike) < MIN_COMMON:
            continue
        common = _some(common[0], alike), _some(common[1], alike)
        return Example(
            known,
            (a, b),
            (window_a, window_b),
            common,
            _third(known, (a, b), common[0].index, largest_px, rng) if with_third else None,
            _other_albedo(known, b, window_b, common[1], rng) if known.others else None,
        )
    return None


def _third(
    known: KnownBody, pair: tuple[int, int], index: Ints, largest_px: int, rng: np.random.Generator
) -> Further | None:
    """An image beside the pair that shows enough of its landmarks ``index`` which are no weak ones."""
    body, landmarks = known.body, known.landmarks
    strict = np.flatnonzero(~landmarks.is_weak[index])
    p_G, normal_G = landmarks.p_G[index[strict]], landmarks.normal_G[index[strict]]
    for view in rng.permutation([v for v in range(len(body.grey)) if v not in pair]):
        seen = seen_in(body, int(view), p_G, normal_G)
        if len(seen.index) < MIN_THIRD:
            continue
        middle = seen.uv_px[int(rng.integers(len(seen.index)))]
        window = _window(body, body.pose_of(int(view)), middle, largest_px)
        inside = np.flatnonzero(window.has(seen.uv_px))
        if len(inside) >= MIN_THIRD:
            return Further(body, int(view), window, strict[seen.index[inside]], _some(seen, inside))
    return None


def _other_albedo(
    known: KnownBody, view: int, window: Window, seen: Seen, rng: np.random.Generator
) -> Further | None:
    """The image ``view`` under another albedo, with the same points."""
    other = known.others[int(rng.integers(len(known.others)))]
    pose = other.pose_of(view)
    # A silhouette may round to other pixels where parts were joined otherwise.
    same = np.array_equal(other.corner_px[pose], known.body.corner_px[pose])
    height, width = other.grey.shape[1:]
    fits = window.u0 + window.side_u <= width and window.v0 + window.side_v <= height
    return Further(other, view, window, np.arange(len(seen.index)), seen) if same and fits else None


def _correlations(body: LitBody, views: tuple[int, int], common: tuple[Seen, Seen]) -> Array:
    """Correlation (n,) of the patches of points in two views, cut by the truth in the same orientation."""
    a, b = common
    if len(a.index) == 0:
        return np.zeros(0)
    half = np.full(len(a.index), HALF_PX * float(np.median(a.p_K[:, 2])) / float(body.focal_px))
    pose_a, pose_b = (body.pose_of(view) for view in views)
    rig_a, rig_b = _rig(body, pose_a), _rig(body, pose_b)
    affine_a = tangent_affines(a.p_K, a.normal_K, rig_a, half)
    affine_b = tangent_affines(b.p_K, b.normal_K, rig_b, half)
    R_ba = body.X_KG[pose_b, :3, :3] @ body.X_KG[pose_a, :3, :3].T
    rotation = patch_rotation(affine_a, affine_b, a.p_K, a.normal_K, R_ba, b.p_K, rig_a)
    patches_a = cut_patches(body.grey[views[0]], a.uv_px, affine_a)
    patches_b = cut_patches(body.grey[views[1]], b.uv_px, rotate_affines(affine_b, rotation))
    return correlation(patches_a, patches_b)


def _some(seen: Seen, index: Ints) -> Seen:
    return Seen(seen.index[index], seen.uv_px[index], seen.p_K[index], seen.normal_K[index])


def _window(body: LitBody, pose: int, middle_px: Array, largest_px: int) -> Window:
    """The pose's target, or as much of it around a place as is allowed."""
    mask = on_target(body, pose)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    starts, sides = [], []
    for lines, at, length in ((columns, middle_px[0], mask.shape[1]), (rows, middle_px[1], mask.shape[0])):
        first, last = max(int(lines[0]) - 8, 0), min(int(lines[-1]) + 9, length)
        if last - first > largest_px:
            first = int(np.clip(round(at) - largest_px // 2, first, last - largest_px))
            last = first + largest_px
        starts.append(first)
        sides.append(last - first)
    return Window(starts[0], starts[1], sides[0], sides[1])


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

    Further images come after those of the pairs. Where there are third ones: ``third`` (t,): the pair's row
    of each point that they show, ``image_third`` (t,), ``uv_third`` (t, 2), ``p_third`` and ``plane_third``
    (t, 3), ``centre_third`` (t, 2), ``X_A_third`` (t, 4, 4). Where there are other albedos: ``other`` (o,):
    the pair's row of each point; the points come after the distractors.
    """
    further = [each for e in examples for each in (e.third, e.other_albedo) if each is not None]
    windows = [w for e in examples for w in e.windows] + [each.window for each in further]
    height, width = max(w.side_v for w in windows), max(w.side_u for w in windows)
    height, width = (-(-side // 8) * 8 for side in (height, width))
    images = np.zeros((2 * len(examples) + len(further), 1, height, width), np.uint8)
    light = np.full((len(images), height, width), SKY, np.uint8)
    heat = np.zeros((len(images), height, width), np.float32)
    weight = np.zeros_like(heat, bool)
    near: list[Array] = []
    place: list[Array] = []
    rows: dict[str, list[NDArray[Any]]] = {}

    def add(**values: Array | Bools) -> None:
        for name, value in values.items():
            rows.setdefault(name, []).append(value)

    image_of = {id(each): 2 * len(examples) + k for k, each in enumerate(further)}
    before = 0
    for k, example in enumerate(examples):
        for side in (0, 1):
            index = 2 * k + side
            body, view, window = example.known.body, example.views[side], example.windows[side]
            _fill(body, view, window, images[index, 0], rng)
            light[index, : window.side_v, : window.side_u] = body.light[view][window.part]
            cells, offsets = _targets(example, side, heat[index], weight[index])
            near.append(np.column_stack([np.full(len(cells), index), cells]))
            place.append(offsets)
        _add_points(example, k, points, image_of, before, rng, add)
        before += len(rows["uv_a"][-1])
    for each in further:
        _fill(each.body, each.view, each.window, images[image_of[id(each)], 0], rng)
    described = [name for name in ("a", "b", "distractor", "other") if f"uv_{name}" in rows]
    m = [np.concatenate(rows[f"uv_{name}"]) for name in described]
    owners = np.concatenate([each for name in described for each in rows[f"owner_{name}"]])
    affine = np.concatenate([each for name in described for each in rows[f"affine_{name}"]])
    jitter = rng.normal(0.0, PLACE_NOISE_PX, (sum(map(len, m)), 2))
    result = {
        "images": torch.from_numpy(images),
        "light": torch.from_numpy(light),
        "heat": torch.from_numpy(heat).half(),
        "weight": torch.from_numpy(weight),
        "near": torch.from_numpy(np.concatenate(near).astype(np.int64)),
        "place": _tensor(np.concatenate(place)),
        "owner": torch.from_numpy(owners.astype(np.int64)),
        "uv": _tensor(np.concatenate(m) + jitter),
        "affine": _tensor(affine),
    }
    result["is_strict"] = torch.from_numpy(np.concatenate(rows["is_strict"]).astype(bool))
    for key in ("pair", "distractors", "third", "image_third", "other"):
        if key in rows:
            result[key] = torch.from_numpy(np.concatenate(rows[key]).astype(np.int64))
    places = ("uv_a", "uv_b", "uv_distractor", "p_a", "p_b", "p_distractor", "plane_a", "plane_b")
    third = ("uv_third", "p_third", "plane_third", "centre_third", "X_A_third")
    for key in (*places, "rotation", "X_AB", "centre_a", "centre_b", "focal", *third):
        if key in rows:
            result[key] = _tensor(np.concatenate(rows[key]))
    return result


def _fill(
    body: LitBody, view: int, window: Window, image: NDArray[np.uint8], rng: np.random.Generator
) -> None:
    """The image in a window, black beyond a mask that is a little too large."""
    mask = on_target(body, body.pose_of(view)).astype(np.uint8)
    reach = int(rng.integers(0, 4))
    wide = cv2.dilate(mask, np.ones((3, 3), np.uint8), iterations=reach) if reach else mask
    seen = np.where(wide[window.part] > 0, body.grey[view][window.part], 0)
    image[: window.side_v, : window.side_u] = seen


def _targets(example: Example, side: int, heat: NDArray[np.float32], weight: Bools) -> tuple[Ints, Array]:
    """Fill the map of landmarks and the weights.

    Returns pixels (q, 2) (row, column) near landmarks, and the landmarks' places (q, 2) (u, v) less their
    centres.
    """
    body, view, window = example.known.body, example.views[side], example.windows[side]
    landmarks = example.known.landmarks
    weight[: window.side_v, : window.side_u] = on_target(body, body.pose_of(view))[window.part]
    seen = seen_in(body, view, landmarks.p_G, landmarks.normal_G)
    inside = window.has(seen.uv_px)
    uv, weak = seen.uv_px[inside] - [window.u0, window.v0], landmarks.is_weak[seen.index[inside]]
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
    heat[known] = np.exp(-best[known] / (2.0 * HEAT_PX**2))
    good = uv[~weak]
    middle = np.round(good).astype(int)
    heat[middle[:, 1], middle[:, 0]] = 1.0
    weight[known] = True
    cells = np.argwhere(known)
    return cells, offset[known].astype(np.float64)


def _add_points(
    example: Example,
    k: int,
    points: int,
    image_of: Mapping[int, int],
    before: int,
    rng: np.random.Generator,
    add: Add,
) -> None:
    """Landmarks of both sides, distractors of the second one, and what further images show.

    before: number of landmarks of the examples before.
    """
    body, landmarks = example.known.body, example.known.landmarks
    a, b = example.common
    chosen = rng.permutation(len(a.index))[:points]
    a, b = _some(a, chosen), _some(b, chosen)
    poses = [body.pose_of(view) for view in example.views]
    focal = float(body.focal_px)
    low, high = np.log(HALF_RANGE_PX)
    half_m = float(np.exp(rng.uniform(low, high))) * float(np.median(a.p_K[:, 2])) / focal
    affines = [
        _affine(seen.p_K, seen.normal_K, half_m, body, pose, rng)
        for seen, pose in ((a, poses[0]), (b, poses[1]))
    ]
    R_ba = body.X_KG[poses[1], :3, :3] @ body.X_KG[poses[0], :3, :3].T
    rotation = patch_rotation(affines[0], affines[1], a.p_K, a.normal_K, R_ba, b.p_K, _rig(body, poses[0]))
    free = np.flatnonzero((landmarks.view == example.views[1]) & (landmarks.landmark < 0))
    free = free[example.windows[1].has(landmarks.uv_px[free])]
    # not the second place of a pair
    free = free[cKDTree(b.uv_px).query(landmarks.uv_px[free])[0] > APART_PX]
    uv_d = landmarks.uv_px[rng.permutation(free)[: round(DISTRACTORS * len(chosen))]]
    p_d, normal_d = surface_at(body, poses[1], uv_d)
    known = np.isfinite(p_d).all(axis=1)
    uv_d, p_d, normal_d = uv_d[known], p_d[known], normal_d[known]
    corner = [window.corner_px for window in example.windows]
    n = len(chosen)
    add(
        uv_a=a.uv_px - corner[0],
        uv_b=b.uv_px - corner[1],
        uv_distractor=uv_d - corner[1],
        affine_a=affines[0],
        affine_b=affines[1],
        affine_distractor=_affine(p_d, normal_d, half_m, body, poses[1], rng),
        owner_a=np.full(n, 2 * k),
        owner_b=np.full(n, 2 * k + 1),
        owner_distractor=np.full(len(uv_d), 2 * k + 1),
        pair=np.full(n, k),
        is_strict=~landmarks.is_weak[a.index],
        distractors=np.full(len(uv_d), k),
        rotation=rotation,
        p_a=a.p_K,
        p_b=b.p_K,
        p_distractor=p_d,
        X_AB=(body.X_KG[poses[0]] @ inverse_pose(body.X_KG[poses[1]]))[None],
        plane_a=a.normal_K / np.einsum("nk,nk->n", a.normal_K, a.p_K)[:, None],
        plane_b=b.normal_K / np.einsum("nk,nk->n", b.normal_K, b.p_K)[:, None],
        centre_a=(body.centre_of_part_px(poses[0]) - corner[0])[None],
        centre_b=(body.centre_of_part_px(poses[1]) - corner[1])[None],
        focal=np.array([focal]),
    )
    row = np.full(len(example.common[0].index), -1)
    row[chosen] = np.arange(n)
    for further in (example.third, example.other_albedo):
        if further is None:
            continue
        own = row[further.rows] >= 0
        rows, seen = before + row[further.rows[own]], _some(further.seen, np.flatnonzero(own))
        pose, image = body.pose_of(further.view), np.full(len(rows), image_of[id(further)])
        uv = seen.uv_px - further.window.corner_px
        if further is example.other_albedo:
            affine = _affine(seen.p_K, seen.normal_K, half_m, further.body, pose, rng)
            add(uv_other=uv, owner_other=image, affine_other=affine, other=rows)
            continue
        X_A = body.X_KG[poses[0]] @ inverse_pose(body.X_KG[pose])
        add(
            third=rows,
            image_third=image,
            uv_third=uv,
            p_third=seen.p_K,
            plane_third=seen.normal_K / np.einsum("nk,nk->n", seen.normal_K, seen.p_K)[:, None],
            centre_third=np.tile(body.centre_of_part_px(pose) - further.window.corner_px, (len(rows), 1)),
            X_A_third=np.tile(X_A, (len(rows), 1, 1)),
        )


def _affine(
    p_K: Array, normal_K: Array, half_m: float, body: LitBody, pose: int, rng: np.random.Generator
) -> Array:
    """Maps (n, 2, 2) of patches at points, with the errors of a run and random rotations."""
    n = len(p_K)
    half = half_m * np.exp(rng.normal(0.0, SCALE_NOISE, n))
    normal = perturbed_normals(normal_K, np.deg2rad(NORMAL_NOISE_DEG), rng)
    affine = tangent_affines(p_K, normal, _rig(body, pose), half)
    flat = rng.random(n) < FRONTO_PARALLEL
    affine[flat] = upright_affines(half[flat] * float(body.focal_px) / p_K[flat, 2])
    return rotate_affines(affine, rng.uniform(0.0, 2.0 * np.pi, n))


def _rig(body: LitBody, pose: int) -> RectifiedRig:
    """The camera of a pose's part; patches need no baseline."""
    height, width = body.depth_m.shape[1:]
    u, v = body.centre_of_part_px(pose)
    return RectifiedRig(float(body.focal_px), float(u), float(v), 1.0, int(width), int(height))


def _tensor(values: Array) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))
