"""Solid drawings in a matplotlib panel: translucent surfaces by ray casting, lines that dim behind them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from polhode.lie import Array
from polhode.records import Bools

LIGHT = np.array([-0.5, 0.62, 0.6])
"""Towards the light: right, up, towards the viewer."""
AMBIENT, DIFFUSE, GLOSS, SHININESS = 0.62, 0.42, 0.16, 30.0
HEADROOM = 0.07
"""Above the highest point, for its name; relative to the largest side."""
LAYERS = 8
"""Surfaces one behind the other that shine through."""


@dataclass(frozen=True)
class _Line:
    points: Array
    """(n, 3) right, up, nearness"""
    color: tuple[float, float, float]
    width_pt: float
    hidden: float
    """Opacity behind a surface"""


class Drawing:
    """Surfaces and lines in space, seen from far away."""

    def __init__(self, towards_viewer: Array, up: Array) -> None:
        """Directions (3,) in the drawn frame, of any length, not parallel."""
        near = np.asarray(towards_viewer, dtype=np.float64) / np.linalg.norm(towards_viewer)
        right = np.cross(up, near)
        right /= np.linalg.norm(right)
        self._R = np.stack([right, np.cross(near, right), near])
        self._triangles: list[Array] = []
        self._paints: list[Array] = []
        self._lines: list[_Line] = []

    def seen(self, points: Array) -> Array:
        """Points (..., 3) as the viewer has them: right, up, nearness."""
        return np.asarray(np.asarray(points) @ self._R.T)

    def surface(self, grid: Array, color: str, opacity: float) -> None:
        """A surface through a grid of points (m, n, 3)."""
        p = self.seen(grid)
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        triangles = np.concatenate(
            [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
        )
        self._triangles.append(triangles)
        self._paints.append(np.tile([*to_rgb(color), opacity], (len(triangles), 1)))

    def line(self, points: Array, color: str, width_pt: float, hidden: float = 0.3) -> None:
        """A line through points (n, 3); where a surface is before it, it has the opacity ``hidden``."""
        self._lines.append(_Line(self.seen(points), to_rgb(color), width_pt, hidden))

    def paint(self, axes: Axes, pixels: int = 1000) -> None:
        """Draw all; ``pixels`` is the larger side of the surfaces' picture."""
        corners = np.concatenate(
            [*(t.reshape(-1, 3) for t in self._triangles), *(x.points for x in self._lines)]
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
        size = float((high - low).max())
        triangles = np.concatenate([np.zeros((0, 3, 3)), *self._triangles])
        scene = EmbreeScene(robust=True)
        if len(triangles):
            TriangleMesh(scene, _floats(triangles))
            step = float((high - low)[:2].max()) / pixels
            x, y = (np.arange(low[k] - step, high[k] + 2 * step, step) for k in (0, 1))
            rays = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), high[2] + size)], axis=-1)
            picture = _composed(
                scene, rays.reshape(-1, 3), triangles, np.concatenate(self._paints), 1e-3 * size
            )
            extent = (x[0] - step / 2, x[-1] + step / 2, y[0] - step / 2, y[-1] + step / 2)
            axes.imshow(picture.reshape(len(y), len(x), 4), extent=extent, origin="lower")
        for line in self._lines:
            self._paint_line(axes, scene, line, 4e-3 * size)
        axes.set(xlim=(low[0] - 0.02 * size, high[0] + 0.02 * size))
        axes.set(ylim=(low[1] - 0.02 * size, high[1] + HEADROOM * size))
        axes.set_aspect("equal")
        axes.axis("off")

    def _paint_line(self, axes: Axes, scene: EmbreeScene, line: _Line, lift: float) -> None:
        middles = 0.5 * (line.points[:-1] + line.points[1:]) + np.array([0.0, 0.0, lift])
        behind = _covered(scene, middles) if self._triangles else np.zeros(len(middles), dtype=bool)
        # Whole stretches: pieces that overlap would show where they are translucent.
        cuts = np.flatnonzero(np.diff(behind)) + 1
        for start, end in pairwise([0, *cuts.tolist(), len(behind)]):
            opacity = line.hidden if behind[start] else 1.0
            stretch = line.points[start : end + 1, :2]
            axes.plot(
                *stretch.T, color=(*line.color, opacity), lw=line.width_pt, solid_capstyle="butt", zorder=3
            )


def _composed(scene: EmbreeScene, rays: Array, triangles: Array, paints: Array, skip: float) -> Array:
    """Colours (n, 4) of rays that come down from (n, 3), surface behind surface."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    shades = _shaded(normals, paints)
    color, passing = np.zeros((len(rays), 3)), np.ones(len(rays))
    origins, alive = rays.copy(), np.arange(len(rays))
    for _ in range(LAYERS):
        down = np.tile([0.0, 0.0, -1.0], (len(alive), 1))
        answer = scene.run(_floats(origins[alive]), _floats(down), output=True)
        met = answer["primID"] >= 0
        face, alive = answer["primID"][met], alive[met]
        opacity = paints[face, 3]
        color[alive] += (passing[alive] * opacity)[:, None] * shades[face]
        passing[alive] *= 1.0 - opacity
        origins[alive, 2] -= answer["tfar"][met] + skip
        if len(alive) == 0:
            break
    covered = 1.0 - passing
    return np.column_stack([color / np.maximum(covered, 1e-9)[:, None], covered]).clip(0.0, 1.0)


def _shaded(normals: Array, paints: Array) -> Array:
    """Colours (f, 3) of faces with normals (f, 3) towards the viewer."""
    light = LIGHT / np.linalg.norm(LIGHT)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    # Light that reaches around: no face is black.
    diffuse = (0.35 + 0.65 * normals @ light)[:, None]
    gloss = np.maximum(normals @ half, 0.0)[:, None] ** SHININESS
    return np.asarray(paints[:, :3] * (AMBIENT + DIFFUSE * diffuse) + GLOSS * gloss)


def _covered(scene: EmbreeScene, points: Array) -> Bools:
    """Whether a surface lies between points (n, 3) and the viewer."""
    towards = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return np.asarray(scene.run(_floats(points), _floats(towards), query="OCCLUDED") >= 0)


def _floats(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)
