"""Bodies for trials of edge trackers: plain solids, and the simulator's own in matte grey or as they are."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from polhode.config import scene as config
from polhode.errors import InputError
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.part import Part, assemble, join
from polhode.simulation.bodies.solids import SMOOTH_BELOW_DEG, hull, prism
from polhode.simulation.surface.materials import Material


def block() -> trimesh.Trimesh:
    """A box of three different sides with one corner cut off."""
    half = np.array([0.45, 0.3, 0.21])
    corners = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    kept = corners[~(corners > 0).all(axis=1)]
    cut = half - np.diag([0.3, 0.22, 0.2])
    return hull(np.vstack([kept, cut]))


def wedge() -> trimesh.Trimesh:
    """A tapered prism on an uneven quadrangle: few edges are parallel."""
    return _middled(prism([[-0.5, -0.3], [0.5, -0.35], [0.4, 0.3], [-0.35, 0.36]], 0.55, taper=0.62))


def house() -> trimesh.Trimesh:
    """A pentagonal prism with an uneven roof."""
    return _middled(prism([[-0.45, -0.25], [0.45, -0.25], [0.45, 0.1], [0.1, 0.34], [-0.45, 0.16]], 0.6))


def ell() -> trimesh.Trimesh:
    """An L with unequal arms."""
    outline = [[-0.5, -0.3], [0.5, -0.3], [0.5, -0.02], [-0.15, -0.02], [-0.15, 0.4], [-0.5, 0.4]]
    return extruded(outline, [-0.3, -0.15], 0.36)


def tee() -> trimesh.Trimesh:
    """A T whose stem stands aside of its middle."""
    outline = [[-0.5, 0.1], [0.55, 0.1], [0.55, 0.34], [-0.5, 0.34]]
    stem = [[0.05, 0.1], [0.05, -0.42], [-0.2, -0.42], [-0.2, 0.1]]
    return extruded([outline[0], *stem[::-1], *outline[1:]], [-0.1, 0.2], 0.3)


def steps() -> trimesh.Trimesh:
    """A staircase of three unequal steps."""
    outline = [[-0.5, -0.3], [0.5, -0.3], [0.5, -0.14], [0.12, -0.14], [0.12, 0.1], [-0.2, 0.1], [-0.2, 0.3],
               [-0.5, 0.3]]  # fmt: skip
    return extruded(outline, [-0.35, -0.22], 0.5)


def drum() -> trimesh.Trimesh:
    """A tapered drum of seven unequal sides."""
    angle = np.deg2rad([0, 48, 102, 150, 205, 262, 310])
    return _middled(prism(0.38 * np.column_stack([np.cos(angle), np.sin(angle)]), 0.6, taper=0.75))


def satellite() -> trimesh.Trimesh:
    """A box with an instrument on it and two thin panels of unequal length on bars."""
    parts = [
        ([0.5, 0.42, 0.6], [0, 0, 0]),
        ([0.2, 0.16, 0.14], [0.1, 0.05, 0.36]),
        ([0.36, 0.5, 0.012], [0, 0.56, 0.06]),
        ([0.36, 0.36, 0.012], [0, -0.49, 0.06]),
        ([0.03, 0.24, 0.03], [0, 0.27, 0.06]),
        ([0.03, 0.24, 0.03], [0, -0.27, 0.06]),
    ]
    boxes = [trimesh.creation.box(extents) for extents, _ in parts]
    for box, (_, place) in zip(boxes, parts, strict=True):
        box.apply_translation(place)
    return join(boxes)


SOLIDS: dict[str, Callable[[], trimesh.Trimesh]] = {
    solid.__name__: solid for solid in (block, wedge, house, ell, tee, steps, drum, satellite)
}


def extruded(outline: ArrayLike, inside: ArrayLike, height: float) -> trimesh.Trimesh:
    """An outline (n, 2), counter-clockwise, all of it visible from the point ``inside`` (2,), made a solid.

    z from -height / 2 to height / 2; each end is a fan around the point.
    """
    flat = np.vstack([np.asarray(outline, dtype=np.float64), np.asarray(inside, dtype=np.float64)])
    n = len(flat) - 1
    vertices = np.vstack([np.column_stack([flat, np.full(n + 1, z)]) for z in (-0.5 * height, 0.5 * height)])
    faces = []
    for a in range(n):
        b = (a + 1) % n
        up_a, up_b = a + n + 1, b + n + 1
        faces += [[b, a, n], [up_a, up_b, 2 * n + 1], [a, b, up_b], [a, up_b, up_a]]
    return trimesh.Trimesh(vertices, faces, process=False)


def _middled(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_translation(-np.asarray(mesh.bounds).mean(axis=0))
    return mesh


CREASE_DEG = SMOOTH_BELOW_DEG
"""Faces that share vertices and meet at less than this look like one curved surface."""
MATTE = Material(0.5, 0.0, 1.0)
"""A diffuse grey without any texture: only shape makes edges."""


@dataclass(frozen=True)
class Kind:
    """A body of the simulator as trials use it."""

    family: str
    size_m: float
    seed: int


KINDS = {
    "bus": Kind("bus", 0.42, 1),
    "cubesat": Kind("cubesat", 0.5, 4),
    "truss": Kind("truss", 1.0, 3),
    "upper_stage": Kind("upper_stage", 1.2, 3),
    "free_flyer": Kind("free_flyer", 0.5, 1),
    "dish": Kind("dish", 0.6, 2),
}
"""Bodies of simulation/bodies, 0.6 to 1.2 m over all."""


@dataclass(frozen=True)
class EdgeBody:
    """A body to be seen."""

    name: str
    body: Body
    config: config.TargetBody

    @property
    def mesh(self) -> trimesh.Trimesh:
        """What the rays meet, in G [m]."""
        return self.body.mesh


def edge_body(source: str | Path | trimesh.Trimesh, plain: bool = True, name: str = "mesh") -> EdgeBody:
    """A body by its name (``NAMES``), from a mesh file in metres, or from a mesh in G.

    plain: one matte grey without any texture, so that shape alone makes edges; else the body's own surface
    (paint, cells, foil, stickers), which solids have not. Raises InputError (files).
    """
    described = config.TargetBody(contrast=0.0)
    if isinstance(source, trimesh.Trimesh):
        body = assemble([Part(source, MATTE)])
    elif isinstance(source, str) and source in SOLIDS:
        name, body = source, assemble([Part(SOLIDS[source](), MATTE)])
    elif isinstance(source, str) and source in KINDS:
        kind, name = KINDS[source], source
        described = config.TargetBody.model_validate(
            {"family": kind.family, "size_m": kind.size_m, "seed": kind.seed}
        )
        body = build_body(described, kind.seed)
    elif isinstance(source, Path):
        described, name = (
            config.TargetBody(family="mesh", path=str(source), metres_per_unit=1.0),
            source.stem,
        )
        body = build_body(described, 0)
    else:
        raise InputError(f"{source}: no such body; choose from {', '.join(NAMES)}, or give a mesh file")
    return EdgeBody(name, in_matte(body) if plain else body, described)


def in_matte(body: Body) -> Body:
    """The same shape, of one material."""
    faces = len(body.mesh.faces)
    return replace(
        body,
        face_material=np.zeros(faces, dtype=np.int64),
        materials=(MATTE,),
        face_chart=np.full(faces, -1),
        charts=(),
        chart_layers=np.zeros((0, 0), dtype=np.int64),
        colours=None,
    )


NAMES = (*SOLIDS, *KINDS)
