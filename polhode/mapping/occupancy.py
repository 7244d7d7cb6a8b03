"""Space around the mesh that may hold matter, by the outlines of the target in all frames.

Stereo measures no boom that is thinner than its windows, and a mesh ends where nothing was measured. Each
frame says of each cell of a grid in G one of three things:

    free      the ray through it ends on surface that stereo measured behind it, or in the sky although the
              Sun reaches the cell
    shown     the ray ends on the target where the model has no surface: matter somewhere along it
    nothing   it lies behind the surface, in the model's shadow, or within the blur of an edge

A cell is *outlined* where frames agree that it is shown, as a boom is from all sides (shape from
silhouettes: Laurentini, IEEE PAMI 16, 1994). As antennas glint in few frames, a share of them is enough. The
dark side of a panel looks like the sky: of some normal of a plate, those frames count that would see its lit
side. Of the cells on one ray those count that most frames agree on, and of these the ones that are not much
farther from the surface than others, as a body is in one piece. Cells are larger than antennas: one is shown
where any pixel that it covers shows matter, and before the sky where all are sky. It is *possible* where no
two frames say that it is free and the convex hull of surface and outlined cells contains it: dark sides,
holes of the mesh, concavities (space carving: Kutulakos and Seitz, Int. J. Computer Vision 38, 2000). It is
*empty* where two frames show the sky although the Sun reaches it: however uncertain, no surface is there.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.ndimage import label, maximum_filter, minimum_filter
from scipy.spatial import ConvexHull, QhullError, cKDTree

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints
from polhode.mapping.visibility import MIN_COSINE, FrameView, MeshViewer, directions, sun_in_G
from polhode.records.occupancy import EMPTY, FREE, OUTLINED, POSSIBLE, Occupancy
from polhode.records.surface import DepthMap
from polhode.runtime.compiled import compiled_ieee

Floats = NDArray[np.float32]
Frames = NDArray[np.uint64]
"""Sets of frames, a bit for each"""

LEAST_CELLS_ALONG, MOST_CELLS_ALONG = 24, 80
"""A side of the grid; between them a cell is as large as a pixel of the frame that was nearest"""
BEYOND_MOST = 1.2
"""Half a side of the grid over the farthest that three quarters of the outlines reach"""
BLUR_PX = 2.5
"""Distance from an outline within which a pixel says nothing"""
EVERY_PX = 2
"""Pixels on which rays are cast to the model"""
ABOVE_SKY = 5.0
"""Intensity over the sky's at which a pixel is no sky [8-bit levels]"""
DEPTH_SIGMAS = 3.0
LEAST_SHOWN = 2
"""Frames that make a cell outlined; as many exclude it"""
SHARE_SHOWN = 0.3
"""Of the frames that say something, those that show an outlined cell"""
PLATES = 100
"""Normals of plates whose dark side may be what looks like the sky"""
LEAST_OF_PLATE, SHARE_OF_PLATE, MOST_OF_PLATE = 3, 0.8, 0.8
"""Frames that show the lit side of such a plate, their share of those that say something of it and would see
it in light, and of all that show the cell"""
SHARE_OF_RAY = 0.6
"""Of the largest such share on a ray, that of the cells which may be what the pixel shows"""
NEAREST_OF_RAY, MORE_CELLS = 2.0, 8.0
"""Distance from the surface up to which such cells count, over that of the nearest, and cells beyond that"""
MOST_FRAMES = 0.5
"""Of the frames that show a cell, those in which it counts"""
LEAST_LIT = 0.25
"""Share of the visible model that must be in light where the sky is to tell that nothing is there"""
PASSES, SETTLED = 10, 0.01
"""Over all frames, at most; and the share of the open cells below which one has closed too few for another"""
SHADOW_PX, SHADOW_CELLS = 160, 1.5
LEAST_CELLS = 8
"""Of a piece of outlined cells"""
SKY, TARGET, NOTHING, BEFORE = 0, 1, 2, 3
"""What a pixel shows"""


def occupancy_of(
    mesh: trimesh.Trimesh,
    views: Sequence[FrameView],
    depths: Iterable[DepthMap],
    rig: RectifiedRig,
    sun_N: Array | None,
) -> Occupancy:
    """The grid of a mesh in G and the frames that show it, with their depth maps; sun_N (3,): None: unknown.

    Raises ValueError without frames.
    """
    if not views:
        raise ValueError("no frames")
    viewer, vertices = MeshViewer(mesh), np.asarray(mesh.vertices, dtype=np.float64)
    pictures = [_Picture(*each, viewer, rig) for each in zip(views, depths, strict=True)]
    grid = _grid(mesh, pictures)
    for picture in pictures:
        picture.see_in_cells(0.5 * grid.step_m / picture.pixel_m(grid.middle_G))
    # what lies within a cell stands for the rest of the surface
    surface = np.zeros((grid.cells,) * 3, dtype=np.bool_)
    surface[tuple(np.rint((vertices - grid.origin_G) / grid.step_m).astype(int).T)] = True
    thin = grid.centres(np.argwhere(surface))
    suns_G = [np.zeros(3) if sun_N is None else sun_in_G(view, sun_N) for view in views]
    outlined = _outlined(grid, pictures, _lit_and_seen(grid.middle_G, pictures, suns_G), thin)
    state = np.where(outlined, np.uint8(OUTLINED), np.uint8(FREE))
    cell = _inside_hull(np.concatenate([thin, grid.centres(np.argwhere(outlined))]), grid)
    left = cell[_stay_open(cell, grid, pictures, suns_G, thin, True)]
    possible = left[state[tuple(left.T)] == FREE]
    state[tuple(possible.T)] = POSSIBLE
    rest, opaque = np.argwhere(state == FREE), np.concatenate([thin, grid.centres(left)])
    empty = rest[~_stay_open(rest, grid, pictures, suns_G, opaque, False)]
    state[tuple(empty.T)] = EMPTY
    return Occupancy(grid.origin_G, grid.step_m, state)


@dataclass(frozen=True)
class _Grid:
    """A cube of cells."""

    origin_G: Array
    """(3,) centre of the first cell [m]"""
    step_m: float
    cells: int
    """along a side"""

    @property
    def middle_G(self) -> Array:
        """(3,) of the cube."""
        return np.asarray(self.origin_G + 0.5 * self.step_m * self.cells)

    def centres(self, cell: Array | Ints) -> Array:
        """(n, 3) in G [m] of cells (n, 3)."""
        return np.asarray(self.origin_G + self.step_m * cell)


def _outlined(grid: _Grid, pictures: Sequence["_Picture"], lit: Frames, surface_G: Array) -> Bools:
    """The cells that several frames show beside the surface (n, 3); lit (m,): as ``_lit_and_seen``."""
    shape = (grid.cells, grid.cells, grid.cells)
    shown_in, sky_in, before_in = (np.zeros(shape, dtype=np.uint64) for _ in range(3))
    for n, picture in enumerate(pictures):
        bit = np.uint64(1) << np.uint64(n)
        _add_frame(shown_in, sky_in, before_in, bit, grid.origin_G, grid.step_m, *picture.parts)
    tree, outlined = cKDTree(surface_G), np.zeros(shape, dtype=np.bool_)
    for shares in _shares(shown_in.reshape(-1), sky_in.reshape(-1), before_in.reshape(-1), lit):
        share = shares.reshape(shape)
        cells = np.argwhere(share >= SHARE_SHOWN)
        places_G = grid.centres(cells)
        explains = _explains(places_G, share[tuple(cells.T)], tree.query(places_G)[0], grid.step_m, pictures)
        outlined[tuple(cells[explains].T)] = True
    pieces = label(outlined, np.ones((3, 3, 3)))[0]
    outlined &= (np.bincount(pieces.reshape(-1)) >= LEAST_CELLS)[pieces]
    return np.asarray(outlined)


def _lit_and_seen(middle_G: Array, pictures: Sequence["_Picture"], suns_G: Sequence[Array]) -> Frames:
    """(m,) for normals in all directions, the frames that see the side of such a plate that is in light.

    The others see its dark side, which is like the sky. None where the Sun's direction (3,) is zero: unknown.
    """
    towards = np.array([picture.eye_G - middle_G for picture in pictures])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    normal = directions(PLATES)
    seen, lit = towards @ normal.T, np.asarray(suns_G) @ normal.T
    are_lit = (seen * lit > 0.0) & (np.abs(seen) > MIN_COSINE) & (np.abs(lit) > MIN_COSINE)
    bit = np.uint64(1) << np.arange(len(pictures), dtype=np.uint64)
    return np.unique(np.where(are_lit, bit[:, None], np.uint64(0)).sum(axis=0, dtype=np.uint64))


def _stay_open(
    cell: Ints,
    grid: _Grid,
    pictures: Sequence["_Picture"],
    suns_G: Sequence[Array],
    opaque_G: Array,
    is_first: bool,
) -> Bools:
    """(m,) whether no two frames exclude the cells (m, 3); as ``_carve``, at first in several passes."""
    excluded, open_ = np.zeros(len(cell), dtype=np.uint64), np.ones(len(cell), dtype=bool)
    for _ in range(PASSES if is_first else 1):
        before = open_.sum()
        for n, (sun, picture) in enumerate(zip(suns_G, pictures, strict=True)):
            bit = np.uint64(1) << np.uint64(n)
            _carve(
                excluded, open_, cell, grid.origin_G, grid.step_m, grid.middle_G, bit, sun, opaque_G,
                is_first, *picture.parts,
            )  # fmt: skip
        if before - open_.sum() < SETTLED * before:
            break
    return open_


def _explains(
    p_G: Array, share: Floats, away_m: Array, step_m: float, pictures: Sequence["_Picture"]
) -> Bools:
    """(n,) whether several frames, most of those that show cells (n, 3), have no better ones on their rays:
    on which much more frames agree, or as many and that are much nearer to the surface, away_m (n,) away.
    """
    shows, agreed = (np.zeros(len(p_G), dtype=np.int64) for _ in range(2))
    for picture in pictures:
        pixel = _shown_in(p_G, step_m, *picture.parts)
        shown = np.flatnonzero(pixel[:, 0] >= 0)
        shows[shown] += 1
        at = tuple(pixel[shown].T)
        best, nearest = np.zeros(picture.kind.shape, dtype=np.float32), np.full(picture.kind.shape, np.inf)
        np.maximum.at(best, at, share[shown])
        shown = shown[share[shown] >= SHARE_OF_RAY * maximum_filter(best, 3)[at]]
        at = tuple(pixel[shown].T)
        np.minimum.at(nearest, at, away_m[shown])
        reach_m = NEAREST_OF_RAY * minimum_filter(nearest, 3)[at] + MORE_CELLS * step_m
        agreed[shown] += away_m[shown] <= reach_m
    return np.asarray((agreed >= LEAST_SHOWN) & (agreed >= MOST_FRAMES * shows))


def _inside_hull(points: Array, grid: _Grid) -> Ints:
    """(m, 3) cells in planes around the convex hull of cells at points; none where these are in a plane."""
    try:
        normals = ConvexHull(points).equations[:, :3]
    except QhullError:
        return np.zeros((0, 3), dtype=np.int64)
    # of many planes those in different directions
    normals = np.unique(np.round(normals, 1), axis=0)
    reach = (points @ normals.T).max(axis=0) + 0.5 * grid.step_m * np.abs(normals).sum(axis=1)
    return np.argwhere(_within(normals, reach, grid.origin_G, grid.step_m, grid.cells))


@compiled_ieee
def _within(normals: Array, reach: Array, origin: Array, step: float, cells: int) -> Bools:
    """Cells (cells, cells, cells) behind all planes, with normals (n, 3) of any length and offsets (n,)."""
    inside = np.zeros((cells, cells, cells), dtype=np.bool_)
    for i in range(cells):
        for j in range(cells):
            for k in range(cells):
                x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                inside[i, j, k] = True
                for n in range(len(reach)):
                    if normals[n, 0] * x + normals[n, 1] * y + normals[n, 2] * z > reach[n]:
                        inside[i, j, k] = False
                        break
    return inside


def _grid(mesh: trimesh.Trimesh, pictures: Sequence["_Picture"]) -> _Grid:
    """A cube about most outlines.

    A frame whose outline goes far beyond the others' has failed masks: it shows no matter.
    """
    low, high = np.asarray(mesh.bounds)
    middle = 0.5 * (low + high)
    reaches_m = np.array([picture.reach_m(middle) for picture in pictures])
    half_m = max(BEYOND_MOST * float(np.quantile(reaches_m, 0.75)), 0.55 * float((high - low).max()))
    for picture, reach_m in zip(pictures, reaches_m, strict=True):
        if reach_m > half_m:
            picture.kind[picture.kind == TARGET] = NOTHING
    pixel_m = min(picture.pixel_m(middle) for picture in pictures)
    cells = int(np.clip(np.ceil(2.0 * half_m / pixel_m), LEAST_CELLS_ALONG, MOST_CELLS_ALONG))
    return _Grid(middle - half_m, 2.0 * half_m / (cells - 1), cells)


class _Picture:
    """What one frame's pixels (h, w) say."""

    def __init__(self, view: FrameView, depth: DepthMap, viewer: MeshViewer, rig: RectifiedRig) -> None:
        height, width = view.image.shape
        rows, columns = slice(view.v0, view.v0 + height), slice(view.u0, view.u0 + width)
        measured = depth.depth_m[rows, columns]
        sigma = np.float32(DEPTH_SIGMAS) * depth.sigma_m[rows, columns]
        # of every other pixel, which is less than the blur
        u, v = (np.arange(0.5 * (EVERY_PX - 1), size, EVERY_PX) for size in (width, height))
        few = viewer.perspective(rig, view.X_RG, view.u0 + u, view.v0 + v).depth_m.astype(np.float32)
        model_m = few.repeat(EVERY_PX, axis=0).repeat(EVERY_PX, axis=1)[:height, :width]
        nearest = np.fmin(measured + sigma, model_m)
        self.behind_m = np.where(np.isfinite(nearest), nearest, np.float32(np.inf))
        """Depth beyond which nothing is seen"""
        before = np.where(np.isfinite(measured), measured - sigma, np.float32(-np.inf))
        self.free_to_m = np.ascontiguousarray(minimum_filter(before, 3))
        """Depth up to which nothing is there"""
        sky_level = view.lit_above - 12.0
        shows = view.silhouette | (view.smooth > sky_level + ABOVE_SKY)
        kind = np.full(view.image.shape, NOTHING, dtype=np.uint8)
        hit = np.isfinite(model_m)
        is_lit = (hit & shows).sum() >= LEAST_LIT * hit.sum()
        if is_lit:
            kind[_far_from(shows)] = SKY
        kind[shows & _far_from(np.isfinite(self.behind_m))] = TARGET
        self.eye_G = view.eye_G
        self.outline = view.silhouette & _reached(shows, np.isfinite(self.behind_m))
        # beyond what was read there is the sky, which only tells something in light
        size = (rig.width_px, rig.height_px) if is_lit else (0, 0)
        pinhole = np.array(
            [rig.focal_px, rig.cx_px - view.u0, rig.cy_px - view.v0, view.u0, view.v0, *size],
            dtype=np.float64,
        )
        X = np.ascontiguousarray(view.X_RG, dtype=np.float64)
        self.kind = kind
        self.parts = (X, pinhole, self.behind_m.astype(np.float32), self.free_to_m, kind)

    def see_in_cells(self, radius_px: float) -> None:
        """Let each pixel say what a cell of this radius about it shows."""
        size = 2 * int(radius_px) + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        near = cv2.dilate(np.stack([self.kind != SKY, self.kind == TARGET], axis=-1).astype(np.uint8), disc)
        self.kind[(self.kind == SKY) & (near[..., 0] > 0)] = NOTHING
        self.kind[near[..., 1] > 0] = TARGET

    def pixel_m(self, middle_G: Array) -> float:
        """Size of a pixel at a point (3,)."""
        X, pinhole = self.parts[:2]
        return float((X[2, :3] @ middle_G + X[2, 3]) / pinhole[0])

    def reach_m(self, middle_G: Array) -> float:
        """The farthest that the outline is from a point (3,), in its plane across the line of sight."""
        X, (focal_px, *centre_px) = self.parts[0], self.parts[1][:3]
        at, (v, u) = X[:3, :3] @ middle_G + X[:3, 3], np.nonzero(self.outline)
        place_px = focal_px * at[:2] / at[2] + centre_px
        return float(np.hypot(u - place_px[0], v - place_px[1]).max(initial=0.0) * at[2] / focal_px)


def _reached(mask: Bools, start: Bools) -> Bools:
    """The parts of a mask (h, w) that touch ``start``, which stars and other junk do not."""
    parts, count = label(mask, np.ones((3, 3)))
    touched = np.zeros(count + 1, dtype=bool)
    touched[np.unique(parts[start])] = True
    touched[0] = False
    return np.asarray(touched[parts])


def _far_from(mask: Bools) -> Bools:
    """Pixels farther than the blur from all of a mask (h, w)."""
    away = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(away > BLUR_PX)


@compiled_ieee
def _shows(
    x: float, y: float, z: float, step: float,
    X: Array, pinhole: Array, behind: Floats, free_to: Floats, kind: NDArray[np.uint8],
) -> int:  # fmt: skip
    """What a frame says of the cell at a point: SKY, TARGET, NOTHING, or BEFORE a measured surface."""
    height, width = kind.shape
    depth = X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3]
    if depth <= 0.0:
        return NOTHING
    row, column = _pixel(x, y, z, X, pinhole)
    if row < 0 or row >= height or column < 0 or column >= width:
        # the part of the image that was read contains the whole outline
        row, column = row + int(pinhole[4]), column + int(pinhole[3])
        return SKY if 0 <= row < pinhole[6] and 0 <= column < pinhole[5] else NOTHING
    if depth > behind[row, column] + step:
        return NOTHING
    return BEFORE if depth < free_to[row, column] - step else int(kind[row, column])


@compiled_ieee
def _add_frame(
    shown: Frames, sky: Frames, before: Frames, bit: np.uint64, origin: Array, step: float,
    X: Array, pinhole: Array, behind: Floats, free_to: Floats, kind: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Note for each cell whether the frame of this bit shows matter on its ray, the sky or surface behind."""
    nx, ny, nz = shown.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                x, y, z = origin[0] + i * step, origin[1] + j * step, origin[2] + k * step
                what = _shows(x, y, z, step, X, pinhole, behind, free_to, kind)
                if what == TARGET:
                    shown[i, j, k] |= bit
                elif what == SKY:
                    sky[i, j, k] |= bit
                elif what == BEFORE:
                    before[i, j, k] |= bit


@compiled_ieee
def _shares(shown: Frames, sky: Frames, before: Frames, lit: Frames) -> tuple[Floats, Floats]:
    """Of the frames that say something of each cell (n,), the share of those that show it; and the largest of
    the shares of those frames (m,) to which a plate there would turn its lit side. 0: too few show it.
    """
    of_all, of_plates = np.zeros(len(shown), dtype=np.float32), np.zeros(len(shown), dtype=np.float32)
    for n in range(len(shown)):
        count = _ones(shown[n])
        if count >= LEAST_SHOWN:
            of_all[n] = count / (count + _ones(sky[n] | before[n]))
        if count < LEAST_OF_PLATE:
            continue
        for frames in lit:
            of_plate = _ones(shown[n] & frames)
            if of_plate >= MOST_OF_PLATE * count:
                share = of_plate / (of_plate + _ones((sky[n] & frames) | before[n]))
                if share >= SHARE_OF_PLATE:
                    of_plates[n] = max(of_plates[n], share)
    return of_all, of_plates


@compiled_ieee
def _ones(bits: Any) -> int:
    """How many bits are set."""
    count = 0
    while bits:
        bits &= bits - np.uint64(1)
        count += 1
    return count


@compiled_ieee
def _shown_in(
    p_G: Array, step: float,
    X: Array, pinhole: Array, behind: Floats, free_to: Floats, kind: NDArray[np.uint8],
) -> Ints:  # fmt: skip
    """Row and column (n, 2) at which a frame shows cells at p_G (n, 3); -1 for those that it does not."""
    out = np.full((len(p_G), 2), -1)
    for n in range(len(p_G)):
        x, y, z = p_G[n]
        if _shows(x, y, z, step, X, pinhole, behind, free_to, kind) == TARGET:
            out[n] = _pixel(x, y, z, X, pinhole)
    return out


@compiled_ieee
def _pixel(x: float, y: float, z: float, X: Array, pinhole: Array) -> tuple[int, int]:
    """Row and column of a point in front of the camera."""
    depth = X[2, 0] * x + X[2, 1] * y + X[2, 2] * z + X[2, 3]
    across = X[0, 0] * x + X[0, 1] * y + X[0, 2] * z + X[0, 3]
    down = X[1, 0] * x + X[1, 1] * y + X[1, 2] * z + X[1, 3]
    column = int(np.rint(pinhole[0] * across / depth + pinhole[1]))
    return int(np.rint(pinhole[0] * down / depth + pinhole[2])), column


@compiled_ieee
def _carve(
    excluded: Frames, open_: Bools, cell: Ints, origin: Array, step: float, middle: Array,
    bit: np.uint64, sun: Array, opaque: Array, is_first: bool,
    X: Array, pinhole: Array, behind: Floats, free_to: Floats, kind: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Close the cells (m, 3) that the frame of this bit and another one exclude.

    A cell before the sky is only excluded where the Sun reaches it past opaque places (n, 3) and, at first,
    open cells; at first also before a measured surface.
    """
    # directions across the Sun's
    a = np.zeros(3)
    a[np.argmin(np.abs(sun))] = 1.0
    a = np.cross(a, sun)
    length = np.sqrt(np.sum(a * a))
    is_known = length > 0.0
    a /= max(length, 1e-300)
    axes = np.stack((a, np.cross(sun, a), sun))
    pixel = SHADOW_CELLS * step
    nearest = np.full((SHADOW_PX, SHADOW_PX), -np.inf)
    if is_known:
        for n in range(len(opaque)):
            p, q, towards = _in_shadow_map(opaque[n, 0], opaque[n, 1], opaque[n, 2], middle, axes, pixel)
            nearest[p, q] = max(nearest[p, q], towards)
        for n in range(len(cell)):
            if is_first and open_[n]:
                x, y, z = _centre(origin, step, cell, n)
                p, q, towards = _in_shadow_map(x, y, z, middle, axes, pixel)
                nearest[p, q] = max(nearest[p, q], towards)
    for n in range(len(cell)):
        if not open_[n] or excluded[n] & bit:
            continue
        x, y, z = _centre(origin, step, cell, n)
        what = _shows(x, y, z, step, X, pinhole, behind, free_to, kind)
        if what == SKY and is_known:
            p, q, towards = _in_shadow_map(x, y, z, middle, axes, pixel)
            if towards < nearest[p, q] - pixel:
                continue
        if what == SKY or (is_first and what == BEFORE):
            excluded[n] |= bit
            if excluded[n] != bit:
                open_[n] = False


@compiled_ieee
def _centre(origin: Array, step: float, cell: Ints, n: int) -> tuple[float, float, float]:
    """Of cell n; no array, which would take most of the time."""
    return origin[0] + step * cell[n, 0], origin[1] + step * cell[n, 1], origin[2] + step * cell[n, 2]


@compiled_ieee
def _in_shadow_map(
    x: float, y: float, z: float, middle: Array, axes: Array, pixel: float
) -> tuple[int, int, float]:
    """Row and column of a place as the Sun sees it, and how far towards the Sun it is; axes (3, 3)."""
    x, y, z = x - middle[0], y - middle[1], z - middle[2]
    right = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
    up = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
    p = min(max(int(np.rint(right / pixel)) + SHADOW_PX // 2, 0), SHADOW_PX - 1)
    q = min(max(int(np.rint(up / pixel)) + SHADOW_PX // 2, 0), SHADOW_PX - 1)
    return p, q, axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z
