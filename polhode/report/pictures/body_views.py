"""The mesh from all sides, along the principal axes or those of G: thesis figure 6-28."""

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from polhode.geometry.lie import Array
from polhode.mapping.visibility import MeshView, MeshViewer
from polhode.records.estimate import MassProperties
from polhode.records.surface import SurfaceModel
from polhode.report.plot_style import INK, SIGMA_SCALE
from polhode.report.shape_figures import stretch_contrast, vertex_rgb
from polhode.runtime.drawing_style import default_style

DPI = 100
SIGMA_MAP = LinearSegmentedColormap.from_list(
    "sigma", [(float(str(place)), str(colour)) for place, colour in SIGMA_SCALE]
)
TILE_PX = 216
GROUND = np.array((0.925, 0.94, 0.95))
INNER = np.array((0.86, 0.66, 0.64))
LIGHT = np.array((-0.35, 0.45, 0.82))
"""Direction of the light in a view: left, above, towards the eye."""


@dataclass(frozen=True)
class BodyFrame:
    """The frame A that is drawn, at the centre of mass."""

    name: str
    """P or G: whose axes these are"""
    description: str
    R_GA: Array
    """(3, 3)"""
    com_G: Array
    """(3,) [m]"""

    def points(self, p_G: Array) -> Array:
        """p_A (n, 3) of points in G [m]."""
        return np.asarray((p_G - self.com_G) @ self.R_GA)


@dataclass(frozen=True)
class Direction:
    """A direction of view: the unit vectors to the right and up in the picture, in axes of A."""

    name: str
    right: Array
    up: Array

    @property
    def eye(self) -> Array:
        """(3,) from the body to the eye."""
        return np.cross(self.right, self.up)


def body_frame(mass: MassProperties) -> BodyFrame:
    """P where the motion determines it, else the axes of G, always at the centre of mass."""
    known = mass.identifiable
    origin = "centre of mass" if known.com else "centre of mass, which is not fully determined"
    if known.axes:
        return BodyFrame("P", f"Principal axes x, y, z at the {origin}.", mass.R_GP, mass.com_G)
    description = f"Axes of G at the {origin}: the motion does not determine the principal axes."
    return BodyFrame("G", description, np.eye(3), mass.com_G)


DIRECTIONS: tuple[Direction, ...] = tuple(
    Direction(name, *(np.array(each) / np.linalg.norm(each) for each in (right, up)))
    for name, right, up in (
        ("+x", (0, 1, 0), (0, 0, 1)),
        ("+y", (-1, 0, 0), (0, 0, 1)),
        ("+z", (1, 0, 0), (0, 1, 0)),
        ("\u2212x", (0, -1, 0), (0, 0, 1)),
        ("\u2212y", (1, 0, 0), (0, 0, 1)),
        ("\u2212z", (-1, 0, 0), (0, 1, 0)),
        ("+x +y +z", (-1, 1, 0), (-1, -1, 2)),
        ("\u2212x \u2212y \u2212z", (1, -1, 0), (-1, -1, 2)),
    )
)
ALONG_AXES, OBLIQUE = DIRECTIONS[:6], DIRECTIONS[6:]
"""From the six sides, of which the first three face the last three, and from two opposite corners."""


def round_length_mm(size_mm: float) -> float:
    """A length for a scale bar: 1, 2 or 5 times a power of ten, at most a third of the size."""
    power = 10.0 ** np.floor(np.log10(size_mm / 3.0))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= size_mm / 3.0))


def add_scale_bar(axes: Axes, width_mm: float, width: float) -> None:
    """A round length at the lower left of axes that show ``width_mm`` over ``width`` of their units."""
    length = round_length_mm(width_mm)
    style = {"frameon": False, "color": INK, "pad": 0.4, "sep": 4}
    size = length * width / width_mm
    axes.add_artist(AnchoredSizeBar(axes.transData, size, f"{length:g} mm", "lower left", **style))


def cosine_to_light(view: MeshView, normals: Array, direction: Direction) -> Array:
    """(H, W) between surface normal and light; normals (V, 3) in the axes of the direction."""
    axes = np.stack([direction.right, direction.up, direction.eye])
    normal = view.values(normals @ axes.T)
    length = np.linalg.norm(normal, axis=2)
    return np.asarray(normal @ (LIGHT / np.linalg.norm(LIGHT)) / np.where(length > 0.0, length, 1.0))


def png(figure: Figure) -> bytes:
    """The file; the same bytes for the same figure."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    return content.getvalue()


@default_style
def draw_mesh(surface: SurfaceModel, viewer: MeshViewer, frame: BodyFrame) -> bytes:
    """A PNG: a column for each direction, a row for each quantity. ``viewer`` looks at the mesh."""
    mesh, directions = surface.mesh, DIRECTIONS
    p_A, normal_A = frame.points(np.asarray(mesh.vertices)), np.asarray(mesh.vertex_normals) @ frame.R_GA
    middle_A = 0.5 * (p_A.min(axis=0) + p_A.max(axis=0))
    middle_G, screens = frame.com_G + frame.R_GA @ middle_A, [(each.right, each.up) for each in directions]
    half_m = 1.05 * float(np.abs((p_A - middle_A) @ np.concatenate(screens).T).max())
    views = [
        viewer.orthographic(middle_G, frame.R_GA @ right, frame.R_GA @ up, half_m, TILE_PX)
        for right, up in screens
    ]
    lights = [
        cosine_to_light(view, normal_A, each).clip(0.0, 1.0)
        for view, each in zip(views, directions, strict=True)
    ]
    sigma_mm = 1e3 * surface.sigma_m
    known = np.isfinite(sigma_mm)
    top_mm = max(float(np.quantile(sigma_mm[known], 0.95)) if known.any() else 1.0, 1e-6)
    most = max(float(np.quantile(surface.views, 0.99)), 2.0)
    # title, colours (V, 3) or numbers (V,), the share of the light that falls on every side, scale of numbers
    rows: tuple[tuple[str, Array, float, ScalarMappable | None], ...] = (
        (
            "colours of the vertices, shaded; pink: inner side, seen through holes",
            stretch_contrast(vertex_rgb(mesh)) / 255.0,
            *(0.45, None),
        ),
        (
            "standard deviation [mm]; the scale ends at the 95th percentile",
            np.where(known, sigma_mm, top_mm),
            *(0.8, ScalarMappable(Normalize(0.0, top_mm), SIGMA_MAP)),
        ),
        (
            "number of frames that saw it; the scale ends at the 99th percentile",
            surface.views.astype(np.float64),
            *(0.8, ScalarMappable(Normalize(0.0, most), "viridis")),
        ),
    )
    pitch_px, row_px = TILE_PX + 8, TILE_PX + 48
    # Placed by the pixel: a layout of some forty axes takes longer than the rays.
    width_px, height_px = len(directions) * pitch_px + 78, len(rows) * row_px + 44
    figure = Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI, facecolor="white")

    def write(x_px: float, y_px: float, words: str, **style: Any) -> None:
        figure.text(x_px / width_px, y_px / height_px, words, color=INK, **style)

    def part(x_px: float, y_px: float, wide_px: float) -> Axes:
        """Axes as high as a tile."""
        size = (x_px / width_px, y_px / height_px, wide_px / width_px, TILE_PX / height_px)
        return figure.add_axes(size)

    title = f"Mesh: {len(mesh.faces)} triangles, orthographic. {frame.description}"
    write(8, height_px - 22, title, size=13, weight="bold", va="center")
    for row, (title, quantity, ambient, scale) in enumerate(rows):
        bottom_px = height_px - 44 - (row + 1) * row_px + 8
        write(8, bottom_px + TILE_PX + 24, title, size=10, weight="bold")
        for column, (view, light, direction) in enumerate(zip(views, lights, directions, strict=True)):
            left_px = 8 + column * pitch_px
            values = view.values(quantity)
            colours = values if scale is None else np.asarray(scale.to_rgba(values))[..., :3]
            shaded = colours * (ambient + (1.0 - ambient) * light)[..., None]
            tile = np.where(view.hit[..., None], shaded.clip(0.0, 1.0), GROUND)
            tile[view.hit] = np.where(view.front[:, None], tile[view.hit], INNER)
            figure.figimage(tile, left_px, bottom_px, origin="upper")
            words = f"from {direction.name}"
            write(left_px + TILE_PX / 2, bottom_px + TILE_PX + 6, words, size=10, ha="center")
        if scale is not None:
            bar = figure.colorbar(scale, cax=part(8 + len(directions) * pitch_px, bottom_px, 16))
            bar.ax.tick_params(labelsize=9)
    lowest = part(8, bottom_px, TILE_PX)
    lowest.set(xlim=(0.0, TILE_PX), ylim=(0.0, TILE_PX), zorder=1)
    lowest.set_axis_off()
    add_scale_bar(lowest, 2e3 * half_m, TILE_PX)
    return png(figure)
