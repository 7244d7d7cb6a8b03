"""The mesh from eight sides: as it looked, by standard deviation, by the number of frames that saw it."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from polhode.lie import Array
from polhode.mapping.mesh_viewer import MeshView, MeshViewer
from polhode.pipeline.pictures.body_views import ALONG_AXES, OBLIQUE, BodyFrame, Direction, round_length_mm
from polhode.pipeline.pictures.landmarks import SIGMA_MAP
from polhode.pipeline.report.figures.plot import INK
from polhode.pipeline.report.figures.shape import stretched, vertex_rgb
from polhode.records import SurfaceModel

DIRECTIONS = ALONG_AXES + OBLIQUE
TILE_PX, GAP_PX, LEFT_PX, RIGHT_PX, HEAD_PX, TITLE_PX, FOOT_PX = 216, 6, 16, 74, 76, 26, 34
PITCH_PX, ROW_PX, DPI = TILE_PX + GAP_PX, TITLE_PX + TILE_PX, 100
GROUND = np.array((0.925, 0.94, 0.95))
INNER = np.array((0.86, 0.66, 0.64))
LIGHT = np.array((-0.35, 0.45, 0.82))
"""Where the light stands in a tile: left, above, towards the eye."""


@dataclass(frozen=True)
class _Row:
    title: str
    values: Array
    """(V, 3) colours 0..1, or numbers (V,) for the scale"""
    ambient: float
    """share of the light that falls on every side"""
    scale: ScalarMappable | None = None
    """from numbers to colours; None: ``values`` are colours"""


def draw_mesh(surface: SurfaceModel, viewer: MeshViewer, frame: BodyFrame) -> bytes:
    """A PNG: a column for each direction, a row for each quantity. ``viewer`` looks at the mesh."""
    mesh = surface.mesh
    p_A, normal_A = frame.points(np.asarray(mesh.vertices)), np.asarray(mesh.vertex_normals) @ frame.R_GA
    middle_A = 0.5 * (p_A.min(axis=0) + p_A.max(axis=0))
    middle_G, screens = frame.com_G + frame.R_GA @ middle_A, [(each.right, each.up) for each in DIRECTIONS]
    half_m = 1.05 * float(np.abs((p_A - middle_A) @ np.concatenate(screens).T).max())
    views = [
        viewer.orthographic(middle_G, frame.R_GA @ right, frame.R_GA @ up, half_m, TILE_PX)
        for right, up in screens
    ]
    light = [_light(view, normal_A, each) for view, each in zip(views, DIRECTIONS, strict=True)]
    rows = _rows(surface)
    page = _Page(LEFT_PX + len(DIRECTIONS) * PITCH_PX + RIGHT_PX, HEAD_PX + len(rows) * ROW_PX + FOOT_PX)
    page.write(LEFT_PX, 18, f"Mesh: {len(mesh.faces)} triangles", size=13, weight="bold")
    page.write(LEFT_PX, 40, f"Orthographic. {frame.words}", size=10)
    for k, direction in enumerate(DIRECTIONS):
        middle_px = LEFT_PX + k * PITCH_PX + 0.5 * TILE_PX
        page.write(middle_px, 64, f"from {direction.name}", size=10, ha="center")
    for number, row in enumerate(rows):
        tiles = [_tile(view, shade, row) for view, shade in zip(views, light, strict=True)]
        page.add_row(HEAD_PX + number * ROW_PX, row, tiles)
    page.add_scale_bar(1e-3 * round_length_mm(2e3 * half_m), TILE_PX / (2.0 * half_m))
    return page.png()


class _Page:
    """A matplotlib figure that is laid out in pixels from the top left corner."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._size = width_px, height_px
        self._figure = Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI, facecolor="white")
        FigureCanvasAgg(self._figure)

    def write(self, x_px: float, y_px: float, words: str, **style: Any) -> None:
        width, height = self._size
        self._figure.text(x_px / width, 1.0 - y_px / height, words, color=INK, va="center", **style)

    def add_row(self, top_px: int, row: _Row, tiles: Sequence[Array]) -> None:
        self.write(LEFT_PX, top_px + TITLE_PX / 2, row.title, size=10, weight="bold")
        strip = np.ones((TILE_PX, len(tiles) * PITCH_PX - GAP_PX, 3))
        for k, tile in enumerate(tiles):
            strip[:, k * PITCH_PX : k * PITCH_PX + TILE_PX] = tile
        axes = self._axes(LEFT_PX, top_px + TITLE_PX, strip.shape[1])
        axes.imshow(strip, interpolation="nearest", aspect="auto")
        axes.set_axis_off()
        if row.scale is not None:
            bar = self._axes(LEFT_PX + strip.shape[1] + 10, top_px + TITLE_PX, 12)
            self._figure.colorbar(row.scale, cax=bar).ax.tick_params(labelsize=9)

    def add_scale_bar(self, length_m: float, px_per_m: float) -> None:
        width, height = self._size
        end = LEFT_PX + length_m * px_per_m
        x, y = (LEFT_PX / width, end / width), 0.5 * FOOT_PX / height
        self._figure.add_artist(Line2D(x, (y, y), color=INK, linewidth=3, solid_capstyle="butt"))
        self.write(end + 8, height - 0.5 * FOOT_PX, f"{1e3 * length_m:g} mm", size=10)

    def png(self) -> bytes:
        content = io.BytesIO()
        self._figure.savefig(content, format="png", dpi=DPI)
        return content.getvalue()

    def _axes(self, left_px: float, top_px: float, width_px: float) -> Axes:
        """Of the height of a tile."""
        width, height = self._size
        bottom = height - top_px - TILE_PX
        return self._figure.add_axes((left_px / width, bottom / height, width_px / width, TILE_PX / height))


def _rows(surface: SurfaceModel) -> tuple[_Row, ...]:
    sigma_mm = 1e3 * surface.sigma_m
    known = np.isfinite(sigma_mm)
    top_mm = max(float(np.quantile(sigma_mm[known], 0.95)) if known.any() else 1.0, 1e-6)
    most = max(float(np.quantile(surface.views, 0.99)), 2.0)
    brightness = stretched(vertex_rgb(surface.mesh)) / 255.0
    return (
        _Row("colours of the vertices, shaded; pink: the inner side, seen through holes", brightness, 0.45),
        _Row(
            "standard deviation [mm]; the scale ends at the 95th percentile",
            np.where(known, sigma_mm, top_mm),
            *(0.8, ScalarMappable(Normalize(0.0, top_mm), SIGMA_MAP)),
        ),
        _Row(
            "number of frames that saw it; the scale ends at the 99th percentile",
            surface.views.astype(np.float64),
            *(0.8, ScalarMappable(Normalize(0.0, most), "viridis")),
        ),
    )


def _light(view: MeshView, normal_A: Array, direction: Direction) -> Array:
    """(H, W) cosine between the surface and the light, 0 on the side that is turned away."""
    axes = np.stack([direction.right, direction.up, direction.eye])
    normal = view.values(normal_A @ axes.T)
    length = np.linalg.norm(normal, axis=2)
    cosine = normal @ (LIGHT / np.linalg.norm(LIGHT)) / np.where(length > 0.0, length, 1.0)
    return np.asarray(cosine.clip(0.0, 1.0))


def _tile(view: MeshView, light: Array, row: _Row) -> Array:
    values = view.values(row.values)
    colours = values if row.scale is None else np.asarray(row.scale.to_rgba(values))[..., :3]
    shaded = colours * (row.ambient + (1.0 - row.ambient) * light)[..., None]
    tile = np.where(view.hit[..., None], shaded.clip(0.0, 1.0), GROUND)
    tile[view.hit] = np.where(view.front[:, None], tile[view.hit], INNER)
    return tile
