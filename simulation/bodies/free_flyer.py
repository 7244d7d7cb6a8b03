"""A free flyer in the manner of SPHERES: 18 faces, 12 thrusters, a gas tank, stickers (thesis 6.1)."""

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, HalfspaceIntersection

from polhode.lie import Array
from simulation.bodies.drawing import chart_of_facet, draw_equipment_panel, draw_plain
from simulation.bodies.facets import flat_facets
from simulation.bodies.part import Part
from simulation.materials import BRUSHED_METAL, PAINT_BLACK, PAINT_GREY, PLASTIC

TEXEL_M = 0.0005
PLAIN_FACES = 3
"""Faces of 18 that carry no sticker."""


def free_flyer_parts(size_m: float, rng: np.random.Generator) -> list[Part]:
    """Parts of a free flyer, size_m [m] across flats, G at the middle of the shell, tank along -z."""
    scale = size_m / 0.22
    parts = [_shell(size_m, rng)]
    parts += [_thruster(position, direction, scale) for position, direction in _thruster_places(size_m)]
    parts += _tank(size_m, scale) + _boxes(size_m, scale, rng) + _sonar_buttons(size_m, scale, rng)
    return parts


def _shell(size_m: float, rng: np.random.Generator) -> Part:
    """A cube with chamfered edges: 6 + 12 faces."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    edges = np.array([[a, b, 0.0] for a in (-1, 1) for b in (-1, 1)]) / np.sqrt(2)
    edges = np.vstack([edges, np.roll(edges, 1, axis=1), np.roll(edges, 2, axis=1)])
    planes = np.vstack([
        np.column_stack([axes, np.full(6, -0.5 * size_m)]),
        np.column_stack([edges, np.full(12, -0.545 * size_m)]),
    ])  # fmt: skip
    vertices = HalfspaceIntersection(planes, np.zeros(3)).intersections
    hull = ConvexHull(np.unique(np.round(vertices, 9), axis=0))
    mesh = trimesh.Trimesh(hull.points, hull.simplices, process=True)
    mesh.fix_normals()
    charts, facets = [], flat_facets(mesh)
    plain = rng.choice(len(facets), PLAIN_FACES, replace=False)
    for index, faces in enumerate(facets):
        base = float(rng.choice([0.26, 0.32, 0.4]))
        draw = draw_plain(base) if index in plain else draw_equipment_panel(base)
        charts.append(chart_of_facet(mesh, faces, TEXEL_M * size_m / 0.22, draw, rng))
    return Part(mesh, PLASTIC, tuple(charts), name="shell")


def _thruster_places(size_m: float) -> list[tuple[Array, Array]]:
    """Twelve nozzles: four on each pair of opposite faces, off the axes so that they make couples."""
    places = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            direction = sign * np.eye(3)[axis]
            for side in (-1.0, 1.0):
                offset = side * 0.27 * size_m * np.eye(3)[(axis + 1) % 3]
                places.append((0.5 * size_m * direction + offset, direction))
    return places


def _thruster(position_G: Array, direction_G: Array, scale: float) -> Part:
    """A nozzle: an open bell, narrow at the shell."""
    profile = np.array([[0.0, -2.0], [4.5, -2.0], [4.5, 1.5], [6.5, 7.0], [5.6, 7.0], [3.0, 1.5], [0.0, 1.5]])
    mesh = trimesh.creation.revolve(profile * 1e-3 * scale, sections=20)
    mesh.apply_transform(_along(direction_G, position_G))
    return Part(mesh, BRUSHED_METAL, name="thruster")


def _tank(size_m: float, scale: float) -> list[Part]:
    """The gas tank under the shell, and the regulator knob above it."""
    radius, length = 0.034 * scale, 0.042 * scale
    angle = np.linspace(-np.pi / 2, 0, 9)
    dome = np.column_stack([radius * np.cos(angle), -length + radius * (np.sin(angle))])
    profile = np.vstack([dome, [[radius, 0.01 * scale], [0.0, 0.01 * scale]]])
    profile[0, 0] = 0.0
    profile[:, 1] += 0.6 * radius
    tank = trimesh.creation.revolve(profile, sections=40)
    tank.apply_translation([0, 0, -0.5 * size_m])
    knob = trimesh.creation.cylinder(0.016 * scale, 0.018 * scale, sections=24)
    knob.apply_translation([0.01 * scale, 0, 0.5 * size_m + 0.006 * scale])
    return [Part(tank, PAINT_GREY, density_factor=2.0, name="tank"), Part(knob, PAINT_BLACK, name="knob")]


def _boxes(size_m: float, scale: float, rng: np.random.Generator) -> list[Part]:
    """Battery doors on +-x and an expansion port on +y, each with its own labels."""
    parts = []
    for normal, size_mm, offset_mm in [
        ((1.0, 0.0, 0.0), (60, 40, 8), (0, 22, -14)),
        ((-1.0, 0.0, 0.0), (52, 44, 8), (0, -18, 20)),
        ((0.0, 1.0, 0.0), (44, 70, 14), (4, 0, 8)),
    ]:
        n = np.array(normal)
        mesh = trimesh.creation.box(np.array(size_mm) * 1e-3 * scale)
        place = 0.5 * size_m * n + np.array(offset_mm) * 1e-3 * scale * (1 - np.abs(n))
        mesh.apply_transform(_along(n, place))
        draw = draw_equipment_panel(float(rng.uniform(0.12, 0.5)), 1500.0)
        charts = tuple(chart_of_facet(mesh, f, TEXEL_M * scale, draw, rng) for f in flat_facets(mesh))
        parts.append(Part(mesh, PAINT_GREY, charts, name="box"))
    return parts


def _sonar_buttons(size_m: float, scale: float, rng: np.random.Generator) -> list[Part]:
    """Ultrasonic receivers: small discs on the chamfers and faces."""
    parts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * np.eye(3)[axis]
            side = rng.choice([-1.0, 1.0]) * 0.17 * size_m * np.eye(3)[(axis + 2) % 3]
            mesh = trimesh.creation.cylinder(0.007 * scale, 0.006 * scale, sections=20)
            mesh.apply_transform(_along(normal, 0.5 * size_m * normal + side))
            parts.append(Part(mesh, BRUSHED_METAL if rng.random() < 0.5 else PAINT_BLACK, name="receiver"))
    return parts


def _along(direction_G: Array, position_G: Array) -> Array:
    """Pose (4, 4) that turns z to a direction and moves to a position."""
    X = np.asarray(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], direction_G), dtype=np.float64)
    X[:3, 3] = position_G
    return X
