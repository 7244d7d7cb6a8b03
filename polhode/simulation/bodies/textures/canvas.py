"""Sheets to draw on, and their mapping onto flat faces and around solids of revolution."""

from collections.abc import Callable
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


class Canvas:
    """A texture that is being drawn; all lengths in texels, points are (column, row)."""

    def __init__(self, shape: tuple[int, int], rng: np.random.Generator) -> None:
        self.shape, self.rng = shape, rng
        self.code: Code = np.zeros(shape, np.uint8)
        """(h, w) 255 times the root of the reflectance: fine steps in the dark; OpenCV smooths 8 bits only"""
        self.layer: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        """(h, w) 0: the part's material; k: materials[k - 1]"""
        self.relief: NDArray[np.float32] = np.zeros(shape, np.float32)
        """(h, w) height"""
        self.tilt: NDArray[np.float32] = np.zeros((*shape, 2), np.float32)
        """(h, w, 2) slope to the right and down, in addition to the relief: tilted tiles"""
        self.materials: list[Material] = []
        self.taken: list[tuple[float, float, float]] = []
        """Discs (column, row, radius) that are occupied by marks"""

    def layer_of(self, material: Material) -> int:
        """Number of a material's layer."""
        if material not in self.materials:
            self.materials.append(material)
        return self.materials.index(material) + 1

    def ground(self, reflectance: float, material: Material | None = None) -> None:
        """Cover the whole sheet; without a material, that of the part remains."""
        self.code[:] = code(reflectance)
        if material is not None:
            self.layer[:] = self.layer_of(material)

    def count(self, per_texel: float) -> int:
        """A random number of marks of that mean density."""
        return int(self.rng.poisson(per_texel * self.code.size))

    def anywhere(self) -> Array:
        """A random point (2,)."""
        return self.rng.uniform((0, 0), self.shape[::-1])

    def disc(self, at: tuple[int, int], radius: int, reflectance: float, layer: int | None = None) -> None:
        """Fill a disc."""
        cv2.circle(self.code, at, radius, code(reflectance), -1, cv2.LINE_AA)
        if layer is not None:
            cv2.circle(self.layer, at, radius, layer, -1)


Draw = Callable[[Canvas], None]
"""Fills a blank canvas."""
Parameters = ParamSpec("Parameters")


def drawing(draw: Callable[Concatenate[Canvas, Parameters], None]) -> Callable[Parameters, Draw]:
    """Decorator: ``draw(canvas, ...)`` becomes a function of its other parameters; it returns a Draw."""

    @wraps(draw)
    def with_parameters(*args: Parameters.args, **named: Parameters.kwargs) -> Draw:
        return lambda canvas: draw(canvas, *args, **named)

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
    across = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    right = across if down_G is None else np.cross(normal, down_G)
    right /= np.linalg.norm(right)
    # Down is such that the texture is not mirrored as seen from outside.
    down = np.cross(right, normal)
    corners = mesh.triangles[faces].reshape(-1, 3)
    along = corners @ np.stack([right, down], axis=1)
    low, high = along.min(axis=0) - texel_m, along.max(axis=0) + texel_m
    width, height = (np.ceil((high - low) / texel_m).astype(int) + 1).tolist()
    origin = low[0] * right + low[1] * down + (corners[0] @ normal) * normal
    canvas = Canvas((height, width), rng)
    draw(canvas)
    return Chart(origin, right, down, texel_m, *_finished(canvas), tuple(canvas.materials)), faces


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
    canvas = Canvas((max(2, round(float(lengths.sum()) / texel_m)), across * sections), rng)
    draw(canvas)
    image, slope, layer = _finished(canvas)
    # OpenCV cannot remap signed bytes.
    sheets: list[NDArray[Any] | None] = [image, None if slope is None else slope.astype(np.float32), layer]
    sheets = [s if s is None else np.concatenate([s[:, -MARGIN:], s, s[:, :MARGIN]], axis=1) for s in sheets]
    charts = []
    covered = 0.0
    for s, length in reversed(list(enumerate(lengths))):
        top, bottom = covered / lengths.sum(), (covered + length) / lengths.sum()
        covered += float(length)
        if length < 1e-9:
            continue
        lower, upper = profile[s], profile[s + 1]
        u, v = _unrolled(lower, upper, (top, bottom), canvas.shape, sections, texel_m)
        for k in range(sections):
            faces = solid.panels[first + s, k]
            angle = 2.0 * np.pi * (k + 0.5) / sections
            outward, flat = np.array([np.cos(angle), np.sin(angle), 0.0]), np.cos(np.pi / sections)
            high = upper[0] * flat * outward + [0.0, 0.0, upper[1]]
            low = lower[0] * flat * outward + [0.0, 0.0, lower[1]]
            right = np.array([-np.sin(angle), np.cos(angle), 0.0])
            down = (low - high) / np.linalg.norm(low - high)
            origin = high - 0.5 * (u.shape[1] - 1) * texel_m * right - 0.5 * texel_m * down
            remapped: list[Any] = [
                None if sheet is None else np.asarray(cv2.remap(sheet, u + np.float32(k * across), v, how))
                for sheet, how in zip(
                    sheets, (cv2.INTER_LINEAR, cv2.INTER_LINEAR, cv2.INTER_NEAREST), strict=True
                )
            ]
            painted, steep, layers = remapped
            own = None if steep is None else np.rint(steep).astype(np.int8)
            chart = Chart(origin, right, down, texel_m, painted, own, layers, tuple(canvas.materials))
            charts.append((chart, faces[faces >= 0]))
    return tuple(charts)


def _finished(
    canvas: Canvas,
) -> tuple[NDArray[np.float32], NDArray[np.int8] | None, NDArray[np.uint8] | None]:
    """Reflectance, slope and layer of a canvas; None where empty."""
    smooth = cv2.GaussianBlur(canvas.code, (3, 3), 0.5).astype(np.float32) / np.float32(255)
    image = np.clip(smooth * smooth, 0.01, 0.95).astype(np.float32)
    down, right = np.gradient(canvas.relief)
    slope = np.stack([right, down], axis=-1).astype(np.float32) + canvas.tilt
    steps = np.clip(np.rint(slope / SLOPE_STEP), -127, 127).astype(np.int8)
    return image, steps if steps.any() else None, canvas.layer if canvas.layer.any() else None


def _unrolled(
    lower: Array,
    upper: Array,
    rows: tuple[float, float],
    shape: tuple[int, int],
    sections: int,
    texel_m: float,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions (columns, rows) of a panel's texels in the unrolled texture, for the panel at angle zero."""
    length = float(np.linalg.norm(upper - lower))
    chords = 2.0 * np.sin(np.pi / sections) * np.array([upper[0], lower[0]])
    height, width = int(np.ceil(length / texel_m)) + 2, int(np.ceil(chords.max() / texel_m)) + 2
    i, j = np.mgrid[:height, :width]
    share = (i - 0.5) * texel_m / length
    chord = np.maximum(chords[0] + np.clip(share, 0, 1) * (chords[1] - chords[0]), 0.2 * chords.max())
    aside = np.clip((j - 0.5 * (width - 1)) * texel_m / chord, -0.5, 0.5)
    u = (0.5 + aside) * (shape[1] / sections) - 0.5 + MARGIN
    v = np.clip((rows[0] + share * (rows[1] - rows[0])) * shape[0] - 0.5, 0, shape[0] - 1)
    return u.astype(np.float32), v.astype(np.float32)
