"""Sheets to draw on, and their mapping onto flat faces and around solids of revolution."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, Concatenate, ParamSpec

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Ints
from polhode.simulation.bodies.part import SLOPE_STEP, Chart
from polhode.simulation.bodies.solids import Revolved
from polhode.simulation.surface.materials import Material

Code = NDArray[np.uint8]


MARGIN = 4
"""Texels that an unrolled texture repeats beyond its ends."""


@dataclass
class Canvas:
    """A texture that is being drawn; all lengths in texels."""

    code: Code
    """(h, w) 255 times the root of the reflectance: fine steps in the dark; OpenCV antialiases 8 bits only"""
    layer: NDArray[np.uint8]
    """(h, w) 0: the part's material; k: materials[k - 1]"""
    height: NDArray[np.float32]
    """(h, w) relief"""
    tilt: NDArray[np.float32]
    """(h, w, 2) slope to the right and down, in addition to the relief: tilted tiles"""
    materials: list[Material] = field(default_factory=list)
    taken: list[tuple[float, float, float]] = field(default_factory=list)
    """Discs (column, row, radius) that are occupied by marks"""

    @staticmethod
    def blank(height: int, width: int) -> "Canvas":
        """An empty sheet."""
        return Canvas(
            np.zeros((height, width), np.uint8),
            np.zeros((height, width), np.uint8),
            np.zeros((height, width), np.float32),
            np.zeros((height, width, 2), np.float32),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.code.shape[0], self.code.shape[1]

    @property
    def area(self) -> int:
        """Number of texels."""
        return self.code.size

    def layer_of(self, material: Material) -> int:
        """Number of a material's layer."""
        if material not in self.materials:
            self.materials.append(material)
        return self.materials.index(material) + 1

    def free_place(self, radius: float, rng: np.random.Generator, tries: int = 8) -> Array | None:
        """Column and row (2,) of a free position for a mark of a radius, now occupied; or None."""
        size = np.array([self.code.shape[1], self.code.shape[0]])
        for _ in range(tries):
            at = rng.uniform(0.04 * size, 0.96 * size)
            if all((at[0] - u) ** 2 + (at[1] - v) ** 2 > (radius + r) ** 2 for u, v, r in self.taken):
                self.taken.append((float(at[0]), float(at[1]), radius))
                return np.asarray(at)
        return None

    def slope(self) -> NDArray[np.float32]:
        """(h, w, 2) of the relief and the tilts, to the right and down."""
        down, right = np.gradient(self.height)
        return np.stack([right, down], axis=-1).astype(np.float32) + self.tilt


Draw = Callable[[Canvas, np.random.Generator], None]
"""Fills a blank canvas."""
Parameters = ParamSpec("Parameters")


def drawing(
    draw: Callable[Concatenate[Canvas, np.random.Generator, Parameters], None],
) -> Callable[Parameters, Draw]:
    """Decorator: ``draw(canvas, rng, ...)`` becomes a function of its other parameters; it returns a Draw."""

    @wraps(draw)
    def with_parameters(*args: Parameters.args, **named: Parameters.kwargs) -> Draw:
        return lambda canvas, rng: draw(canvas, rng, *args, **named)

    return with_parameters


def code(reflectance: float) -> int:
    """Code of a reflectance on the canvas."""
    return int(np.clip(round(255.0 * np.sqrt(max(reflectance, 0.0))), 0, 255))


def chart_of_facet(
    mesh: trimesh.Trimesh,
    faces: Ints,
    texel_m: float,
    draw: Draw,
    rng: np.random.Generator,
    down_G: Array | None = None,
) -> tuple[Chart, Ints]:
    """Draw a chart for a plane facet of a mesh; its rows run along ``down_G`` (3,) if given."""
    normal = np.asarray(mesh.face_normals[faces[0]])
    right, down = _in_plane_axes(normal, down_G)
    corners = mesh.triangles[faces].reshape(-1, 3)
    along = corners @ np.stack([right, down], axis=1)
    low, high = along.min(axis=0) - texel_m, along.max(axis=0) + texel_m
    width, height = (np.ceil((high - low) / texel_m).astype(int) + 1).tolist()
    origin = low[0] * right + low[1] * down + (corners[0] @ normal) * normal
    canvas = Canvas.blank(height, width)
    draw(canvas, rng)
    image, slope, layer = _finished(canvas)
    return Chart(origin, right, down, texel_m, image, slope, layer, tuple(canvas.materials)), faces


def charts_around(
    solid: Revolved, first: int, last: int, texel_m: float, draw: Draw, rng: np.random.Generator
) -> tuple[tuple[Chart, Ints], ...]:
    """One texture around the wall between two profile points, cut into a chart for each planar panel.

    The top of the texture is the end of the profile (``last``); its columns run with the angle about z.
    """
    profile = solid.profile[first : last + 1]
    lengths = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    sections = solid.panels.shape[1]
    # An integer number of texels per panel, so that slices differ only in content.
    across = max(2, round(2.0 * profile[:, 0].max() * np.sin(np.pi / sections) / texel_m))
    canvas = Canvas.blank(max(2, round(float(lengths.sum()) / texel_m)), across * sections)
    draw(canvas, rng)
    image, slope, layer = _finished(canvas)
    # OpenCV cannot remap signed bytes.
    painted, steep = _wrapped(image), None if slope is None else _wrapped(slope.astype(np.float32))
    layers = None if layer is None else _wrapped(layer)
    materials = tuple(canvas.materials)
    charts = []
    covered = 0.0
    for s, length in reversed(list(enumerate(lengths))):
        top, bottom = covered / lengths.sum(), (covered + length) / lengths.sum()
        covered += float(length)
        if length < 1e-9:
            continue
        lower_m, upper_m = profile[s], profile[s + 1]
        u, v, size = _unrolled(lower_m, upper_m, (top, bottom), canvas.shape, sections, texel_m)
        for k in range(sections):
            faces = solid.panels[first + s, k]
            place = _panel_axes(lower_m, upper_m, k, sections)
            origin = place[0] - 0.5 * (size[1] - 1) * texel_m * place[1] - 0.5 * texel_m * place[2]
            where = (u + np.float32(k * across), v)
            flat = _sliced(painted, where, cv2.INTER_LINEAR)
            own_slope = None if steep is None else np.rint(_sliced(steep, where, cv2.INTER_LINEAR))
            own_layer = None if layers is None else _sliced(layers, where, cv2.INTER_NEAREST)
            if own_slope is not None:
                own_slope = own_slope.astype(np.int8)
            chart = Chart(origin, place[1], place[2], texel_m, flat, own_slope, own_layer, materials)
            charts.append((chart, faces[faces >= 0]))
    return tuple(charts)


def _in_plane_axes(normal: Array, down_G: Array | None) -> tuple[Array, Array]:
    if down_G is None:
        right = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    else:
        right = np.cross(normal, down_G)
    right /= np.linalg.norm(right)
    # Down is such that the texture is not mirrored as seen from outside.
    return right, np.cross(right, normal)


def _finished(
    canvas: Canvas,
) -> tuple[NDArray[np.float32], NDArray[np.int8] | None, NDArray[np.uint8] | None]:
    """Reflectance, slope and layer of a canvas; None where empty."""
    smooth = cv2.GaussianBlur(canvas.code, (3, 3), 0.5).astype(np.float32) / np.float32(255)
    image = np.clip(smooth * smooth, 0.01, 0.95).astype(np.float32)
    steps = np.clip(np.rint(canvas.slope() / SLOPE_STEP), -127, 127).astype(np.int8)
    return image, steps if steps.any() else None, canvas.layer if canvas.layer.any() else None


def _wrapped(sheet: NDArray[Any]) -> NDArray[Any]:
    """The sheet extended on either side by columns of its other end."""
    return np.concatenate([sheet[:, -MARGIN:], sheet, sheet[:, :MARGIN]], axis=1)


def _sliced(sheet: NDArray[Any], where: tuple[NDArray[Any], NDArray[Any]], how: int) -> NDArray[Any]:
    """The sheet at columns and rows (h, w) each."""
    return np.asarray(cv2.remap(sheet, *where, how))


def _unrolled(
    lower: Array,
    upper: Array,
    rows: tuple[float, float],
    shape: tuple[int, int],
    sections: int,
    texel_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32], tuple[int, int]]:
    """Positions (columns, rows) of a panel's texels in the unrolled texture, for the panel at angle zero."""
    length = float(np.linalg.norm(upper - lower))
    chords = 2.0 * np.sin(np.pi / sections) * np.array([upper[0], lower[0]])
    height, width = int(np.ceil(length / texel_m)) + 2, int(np.ceil(chords.max() / texel_m)) + 2
    i, j = np.mgrid[:height, :width]
    share = (i - 0.5) * texel_m / length
    chord = np.maximum(chords[0] + np.clip(share, 0, 1) * (chords[1] - chords[0]), 0.2 * chords.max())
    aside = np.clip((j - 0.5 * (width - 1)) * texel_m / chord, -0.5, 0.5)
    across = shape[1] / sections
    u = (0.5 + aside) * across - 0.5 + MARGIN
    v = np.clip((rows[0] + share * (rows[1] - rows[0])) * shape[0] - 0.5, 0, shape[0] - 1)
    return u.astype(np.float32), v.astype(np.float32), (height, width)


def _panel_axes(lower: Array, upper: Array, k: int, sections: int) -> tuple[Array, Array, Array]:
    """Centre of a panel's upper edge [m], and its axes to the right and down as seen from outside."""
    angle = 2.0 * np.pi * (k + 0.5) / sections
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    flat = np.cos(np.pi / sections)
    top = upper[0] * flat * outward + [0.0, 0.0, upper[1]]
    bottom = lower[0] * flat * outward + [0.0, 0.0, lower[1]]
    right = np.array([-np.sin(angle), np.cos(angle), 0.0])
    return top, right, (bottom - top) / np.linalg.norm(bottom - top)
