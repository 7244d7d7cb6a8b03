"""Parts with a material, charts and mass, and the body that they are assembled to."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from polhode.geometry.lie import Array, Ints
from polhode.runtime.compiled import compiled
from polhode.simulation.bodies.solids import smooth_corner_normals
from polhode.simulation.surface.materials import Material

SHEET_THICKNESS = 0.01
"""Thickness of a flat open piece, relative to the root of its area."""


@dataclass(frozen=True)
class PartMass:
    """Mass properties of the parts of one name, at density 1 kg/m^3 (``density_factor`` not included)."""

    name: str
    volume_m3: float
    com_G: Array
    """(3,) [m]"""
    inertia_per_density: Array
    """(3, 3) about com_G, axes of G [m^5]"""
    density_factor: float
    """Density relative to the scene's"""


def masses_by_name(parts: list[tuple[str, trimesh.Trimesh, float]]) -> list[PartMass]:
    """Mass properties of each name, from (name, mesh, density factor) of parts in any number.

    A closed mesh counts as a whole; an open one by pieces: closed ones, convex hulls of open ones, sheets.
    """
    named: dict[str, list[PartMass]] = {}
    for name, mesh, factor in parts:
        pieces = [mesh] if _is_solid(mesh) else list(mesh.split(only_watertight=False)) or [mesh]
        named.setdefault(name, []).extend(_piece_mass(name, piece, factor) for piece in pieces)
    joined = []
    for name, masses in named.items():
        weight, com, inertia = combined_mass(masses)
        factor = weight / sum(mass.volume_m3 for mass in masses)
        joined.append(PartMass(name, weight / factor, com, inertia / factor, factor))
    return joined


def _is_solid(mesh: trimesh.Trimesh) -> bool:
    """Closed, of consistent winding, and not a folded sheet without volume."""
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        return False
    # trimesh's volume divides by zero on a folded sheet.
    a, b, c = (mesh.triangles[:, k] for k in range(3))
    volume = float(np.einsum("fk,fk->", np.cross(a, b), c)) / 6.0
    return bool(abs(volume) > 1e-9 * mesh.area**1.5)


def _piece_mass(name: str, piece: trimesh.Trimesh, factor: float) -> PartMass:
    """Mass of a closed piece, of the convex hull of an open one, or of a thin sheet."""
    solid: trimesh.Trimesh | None = piece if _is_solid(piece) else None
    if solid is None:
        with suppress(QhullError):
            if float(ConvexHull(piece.vertices).volume) >= SHEET_THICKNESS * piece.area**1.5:
                solid = piece.convex_hull
    if solid is not None:
        own = solid.mass_properties
        # A closed piece with inverted winding has volume and inertia of the opposite sign.
        sign = -1.0 if own.volume < 0 else 1.0
        volume, com = sign * float(own.volume), np.asarray(own.center_mass)
        return PartMass(name, volume, com, sign * np.asarray(own.inertia), factor)
    # Each face of a sheet is weighted by its area.
    area = np.asarray(piece.area_faces)
    thickness = SHEET_THICKNESS * np.sqrt(area.sum())
    com = area @ piece.triangles_center / area.sum()
    corners = piece.triangles - com
    # Second moment of a triangle about a point: area / 12 (sum of the corners' + that of the sum).
    total = corners.sum(axis=1)
    second = np.einsum("f,fci,fcj->ij", area, corners, corners) + np.einsum("f,fi,fj->ij", area, total, total)
    second = thickness * second / 12.0
    across = np.linalg.eigh(second)[1][:, 0]
    second += area.sum() * thickness**3 / 12.0 * np.outer(across, across)
    inertia = np.trace(second) * np.eye(3) - second
    return PartMass(name, float(area.sum() * thickness), com, inertia, factor)


def combined_mass(masses: Sequence[PartMass]) -> tuple[float, Array, Array]:
    """Weighted volume [m^3], centre of mass (3,) [m] and inertia about it (3, 3) [m^5] of several masses,
    each times its density factor."""
    weights = np.array([mass.volume_m3 * mass.density_factor for mass in masses])
    com = weights @ np.stack([mass.com_G for mass in masses]) / weights.sum()
    inertia = np.zeros((3, 3))
    for mass, weight in zip(masses, weights, strict=True):
        d = mass.com_G - com
        factor = mass.density_factor
        inertia += factor * mass.inertia_per_density + weight * (d @ d * np.eye(3) - np.outer(d, d))
    return float(weights.sum()), np.asarray(com), inertia


@dataclass(frozen=True)
class FileColours:
    """Reflectances of F faces. A face has an image, or values at its corners, or nothing (NaN)."""

    corner_reflectance: Array
    """(F, 3) at the corners; with an image, a factor on it; NaN: no colour"""
    face_image: Ints
    """(F,) index into images, -1: none"""
    corner_uv: Array
    """(F, 3, 2) texture coordinates, v upwards; repeats outside [0, 1]"""
    images: tuple[NDArray[np.float32], ...] = ()
    """(h, w) reflectance each"""

    def look_up(self, face: Ints, weights: Array) -> Array:
        """Reflectance (n,) at faces (n,) with weights (n, 3) of the corners; NaN without a colour."""
        tables = (self.corner_reflectance, self.face_image, self.corner_uv)
        return np.asarray(_look_up(face, np.ascontiguousarray(weights), *tables, *self._packed))

    @cached_property
    def _packed(self) -> tuple[Ints, Ints, NDArray[np.float32]]:
        return packed_images(self.images)

    @staticmethod
    def joined(pieces: "list[tuple[FileColours | None, int]]") -> "FileColours":
        """Colours of several parts, given with their numbers of faces; None: a part without colours."""
        images: list[NDArray[np.float32]] = []
        rows = []
        for colours, count in pieces:
            colours = colours or FileColours.absent(count)
            image = np.where(colours.face_image >= 0, colours.face_image + len(images), -1)
            rows.append((colours.corner_reflectance, image, colours.corner_uv))
            images += colours.images
        corners, face_image, uv = (np.concatenate(column) for column in zip(*rows, strict=True))
        return FileColours(corners, face_image, uv, tuple(images))

    @staticmethod
    def absent(faces: int) -> "FileColours":
        """No colour on any face."""
        none = np.full(faces, -1, dtype=np.int64)
        return FileColours(np.full((faces, 3), np.nan), none, np.zeros((faces, 3, 2)))


def packed_images(images: Sequence[NDArray[np.float32]]) -> tuple[Ints, Ints, NDArray[np.float32]]:
    """Start of each image (n + 1,) in a common buffer, the images' shapes (n, 2), and the buffer."""
    start = np.cumsum([0, *(image.size for image in images)], dtype=np.int64)
    shape = np.array([image.shape for image in images], dtype=np.int64).reshape(-1, 2)
    return start, shape, np.concatenate([np.zeros(0, np.float32), *(image.ravel() for image in images)])


@compiled
def _look_up(
    face: Ints,
    weights: Array,
    corners: Array,
    face_image: Ints,
    corner_uv: Array,
    start: Ints,
    shape: Ints,
    texels: NDArray[np.float32],
) -> Array:
    out = np.empty(len(face))
    for n in range(len(face)):
        f = face[n]
        value = 0.0
        for c in range(3):
            value += weights[n, c] * corners[f, c]
        image = face_image[f]
        if image >= 0:
            height, width = shape[image]
            u, v = 0.0, 0.0
            for c in range(3):
                u += weights[n, c] * corner_uv[f, c, 0]
                v += weights[n, c] * corner_uv[f, c, 1]
            # Texel centres are at half integers; rows increase downwards, v upwards; the image repeats.
            column, row = u * width - 0.5, (1.0 - v) * height - 0.5
            j, i = int(np.floor(column)), int(np.floor(row))
            b, a = column - j, row - i
            left, right = j % width, (j + 1) % width
            top, bottom = start[image] + (i % height) * width, start[image] + ((i + 1) % height) * width
            above = (1 - b) * texels[top + left] + b * texels[top + right]
            below = (1 - b) * texels[bottom + left] + b * texels[bottom + right]
            value *= (1 - a) * above + a * below
        out[n] = value
    return out


SLOPE_STEP = 0.01
"""Slope of a chart's relief for one count of ``Chart.slope``."""


@dataclass(frozen=True)
class Chart:
    """A texture on a flat face: ``image[row, column]`` is the reflectance at
    ``origin_G + column * texel_m * right_G + row * texel_m * down_G``."""

    origin_G: Array
    """(3,) centre of the first texel [m]"""
    right_G: Array
    """(3,) unit"""
    down_G: Array
    """(3,) unit"""
    texel_m: float
    image: NDArray[np.float32]
    """(h, w) reflectance"""
    slope: NDArray[np.int8] | None = None
    """(h, w, 2) slope of the relief to the right and down, in SLOPE_STEP; flat when absent"""
    layer: NDArray[np.uint8] | None = None
    """(h, w) 0: the part's material; k: materials[k - 1]"""
    materials: tuple[Material, ...] = ()

    def moved(self, X: Array) -> "Chart":
        """The chart after the rigid transform (4, 4) of its part."""
        R = X[:3, :3]
        return replace(
            self, origin_G=R @ self.origin_G + X[:3, 3], right_G=R @ self.right_G, down_G=R @ self.down_G
        )


@dataclass(frozen=True)
class Part:
    """A closed mesh of one material; ``charts`` lists charts with the faces that each covers."""

    mesh: trimesh.Trimesh
    material: Material
    charts: tuple[tuple[Chart, Ints], ...] = ()
    density_factor: float = 1.0
    """Density relative to the scene's."""
    name: str = "body"
    """Name by which a scene gives its density; parts of one name are one item."""
    colours: FileColours | None = None
    """Colours of a mesh file."""

    def moved(self, X: Array) -> "Part":
        """The part after the rigid transform (4, 4)."""
        mesh = self.mesh.copy()
        mesh.apply_transform(X)
        return replace(self, mesh=mesh, charts=tuple((chart.moved(X), faces) for chart, faces in self.charts))


def moved(parts: Iterable[Part], X: Array) -> list[Part]:
    """The parts after a rigid transform (4, 4)."""
    return [part.moved(X) for part in parts]


def named(name: str, *meshes: tuple[trimesh.Trimesh, Material], density_factor: float = 1.0) -> list[Part]:
    """Parts of one name without charts, of a mesh and a material each."""
    return [Part(mesh, material, density_factor=density_factor, name=name) for mesh, material in meshes]


@dataclass(frozen=True)
class Body:
    """A target in G: the union of its parts, ready to be rendered. F faces."""

    mesh: trimesh.Trimesh
    corner_normals: Array
    """(F, 3, 3) unit normal at each corner: averaged over smooth edges, flat over sharp ones"""
    face_material: Ints
    """(F,) index into materials"""
    materials: tuple[Material, ...]
    face_chart: Ints
    """(F,) index into charts, -1: none"""
    charts: tuple[Chart, ...]
    chart_layers: Ints
    """(charts, layers) index into materials of a chart's layers 1, 2, ..."""
    colours: FileColours | None
    """Colours from a mesh file, for all faces"""
    texture_scale: float
    """Factor on the lengths of the materials' textures"""
    volume_m3: float
    """Sum over the parts, each times its density factor"""
    com_G: Array
    """(3,) centre of mass [m], density factors included"""
    inertia_per_density: Array
    """(3, 3) inertia about com_G, axes of G, at a density of 1 kg/m^3 times the factors [m^5]"""
    parts: tuple[PartMass, ...]
    """One entry a name, in order of first appearance"""

    @property
    def radius_m(self) -> float:
        """Radius around G's origin that contains the whole body [m]."""
        return float(np.linalg.norm(self.mesh.vertices, axis=1).max())


def assemble(parts: list[Part], texture_scale: float = 1.0) -> Body:
    """Join parts into a body; the mass of overlapping parts is counted twice."""
    parts = merge_uniform_parts(parts)
    drawn = [(part, chart) for part in parts for chart, _ in part.charts]
    every = [part.material for part in parts] + [m for _, chart in drawn for m in chart.materials]
    materials = tuple(dict.fromkeys(every))
    index = {material: i for i, material in enumerate(materials)}
    layers = np.zeros((len(drawn), max((len(chart.materials) for _, chart in drawn), default=0)), np.int64)
    face_material, face_chart, count = [], [], 0
    for part in parts:
        face_material.append(np.full(len(part.mesh.faces), index[part.material]))
        of_part = np.full(len(part.mesh.faces), -1)
        for chart, faces in part.charts:
            of_part[faces] = count
            layers[count, : len(chart.materials)] = [index[m] for m in chart.materials]
            count += 1
        face_chart.append(of_part)
    masses = tuple(masses_by_name([(part.name, part.mesh, part.density_factor) for part in parts]))
    colours = None
    if any(part.colours is not None for part in parts):
        colours = FileColours.joined([(part.colours, len(part.mesh.faces)) for part in parts])
    return Body(
        join([part.mesh for part in parts]),
        np.concatenate([smooth_corner_normals(part.mesh) for part in parts]),
        np.concatenate(face_material),
        materials,
        np.concatenate(face_chart),
        tuple(chart for _, chart in drawn),
        layers,
        colours,
        texture_scale,
        *combined_mass(masses),
        masses,
    )


def merge_uniform_parts(parts: list[Part]) -> list[Part]:
    """The parts, with those that differ only in their meshes merged: few large meshes are fast."""
    alike: dict[tuple[str, Material, float], list[Part]] = {}
    kept = [part for part in parts if part.charts or part.colours is not None]
    for part in parts:
        if not (part.charts or part.colours is not None):
            alike.setdefault((part.name, part.material, part.density_factor), []).append(part)
    joined = [replace(group[0], mesh=join([part.mesh for part in group])) for group in alike.values()]
    return kept + joined


def join(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """One mesh of several, vertices unmerged, without colours."""
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return trimesh.Trimesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces), process=False
    )


def describe(body: Body) -> str:
    """Description in one line: extents [m], faces, charts, materials, and the parts by volume [m^3]."""
    sides = " x ".join(f"{side:.3g}" for side in np.ptp(np.asarray(body.mesh.vertices), axis=0))
    ordered = sorted(body.parts, key=lambda part: -part.volume_m3)
    listed = [f"{part.name} {part.volume_m3:.3g} m^3" for part in ordered[:6]]
    if len(ordered) > 6:
        listed.append(f"{len(ordered) - 6} more")
    return (
        f"body {sides} m along x, y, z; {len(body.mesh.faces)} faces, {len(body.charts)} drawings, "
        f"{len(body.materials)} materials; parts: {', '.join(listed)}"
    )
