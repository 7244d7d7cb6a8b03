"""A free flyer similar to SPHERES: 18 faces, 12 thrusters, a gas tank, stickers (thesis 6.1)."""

import numpy as np
from scipy.spatial import HalfspaceIntersection

from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import ball, box, drum, flat_facets, hull, pose, revolve
from polhode.simulation.bodies.textures.canvas import chart_of_facet
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat


def free_flyer_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a free flyer, size_m [m] across flats, G at the middle of the shell, tank along -z."""
    rng, scale = builder.rng, size_m / 0.22
    parts = [_shell(size_m, builder)]
    # An open bell, narrow at the shell, on a hexagonal nut.
    profile = np.array([[0.0, -2.0], [4.5, -2.0], [4.5, 1.5], [6.5, 7.0], [5.6, 7.0], [3.0, 1.5], [0.0, 1.5]])
    nozzle = revolve(profile * 1e-3 * scale, 20).mesh
    nut = drum(8.5e-3 * scale, 3.2e-3 * scale, 6, bevel=0.15, at=[0, 0, -1.6e-3 * scale])
    thruster = named("thruster", (nozzle, mat.BRUSHED_METAL), (nut, mat.ANODISED))
    sides = [(axis, sign, sign * np.eye(3)[axis]) for axis in range(3) for sign in (-1.0, 1.0)]
    for axis, _, direction in sides:
        # Twelve, off the axes so that they form couples.
        for side in (-1.0, 1.0):
            offset = side * 0.27 * size_m * np.eye(3)[(axis + 1) % 3]
            parts += moved(thruster, pose(direction, 0.5 * size_m * direction + offset))
    parts += _tank(size_m, scale, builder)
    # Battery doors on +-x and an expansion port on +y, each with its own labels.
    for normal, size_mm, offset_mm in [
        ((1.0, 0.0, 0.0), (60, 40, 8), (0, 22, -14)),
        ((-1.0, 0.0, 0.0), (52, 44, 8), (0, -18, 20)),
        ((0.0, 1.0, 0.0), (44, 70, 14), (4, 0, 8)),
    ]:
        n = np.array(normal)
        mesh = box(np.array(size_mm) * 1e-3 * scale, bevel=0.1)
        mesh.apply_transform(pose(n, 0.5 * size_m * n + np.array(offset_mm) * 1e-3 * scale * (1 - np.abs(n))))
        draw = builder.textures.panel(float(rng.uniform(0.12, 0.5)), 2.2)
        parts.append(builder.flat_part(mesh, mat.PAINT_GREY, draw, "box"))
    # Ultrasonic receivers: small discs on the faces, with a grille in the middle.
    for axis, _, normal in sides:
        side = rng.choice([-1.0, 1.0]) * 0.17 * size_m * np.eye(3)[(axis + 2) % 3]
        disc, middle = drum(0.007 * scale, 0.006 * scale, 20), drum(0.0042 * scale, 0.0038 * scale, 16)
        colours = (mat.BRUSHED_METAL, mat.PAINT_BLACK)
        if rng.random() >= 0.5:
            colours = colours[::-1]
        for mesh, colour, lift in zip((disc, middle), colours, (0.4865, 0.4995), strict=True):
            X = pose(normal, lift * size_m * normal + side)
            parts += moved(named("receiver", (mesh, colour)), X)
    # Two small lamps on the upper face that show its state.
    for y in (-0.03, 0.03):
        lamp = ball(0.005 * scale, 14, 8, at=[-0.03 * scale, y * scale, 0.5 * size_m])
        parts += named("lamp", (lamp, mat.GLASS))
    return parts


def _shell(size_m: float, builder: PartBuilder) -> Part:
    """A cube with chamfered edges: 6 + 12 faces."""
    rng = builder.rng
    axes = np.vstack([np.eye(3), -np.eye(3)])
    edges = np.array([[a, b, 0.0] for a in (-1, 1) for b in (-1, 1)]) / np.sqrt(2)
    edges = np.vstack([edges, np.roll(edges, 1, axis=1), np.roll(edges, 2, axis=1)])
    reach = np.r_[np.full(6, -0.5 * size_m), np.full(12, -0.545 * size_m)]
    planes = np.column_stack([np.vstack([axes, edges]), reach])
    vertices = HalfspaceIntersection(planes, np.zeros(3)).intersections
    mesh = hull(np.unique(np.round(vertices, 9), axis=0))
    charts, facets = [], flat_facets(mesh)
    # Three of the 18 faces have no stickers.
    plain = rng.choice(len(facets), 3, replace=False)
    for index, faces in enumerate(facets):
        base = float(rng.choice([0.26, 0.32, 0.4]))
        draw = builder.textures.plain(base) if index in plain else builder.textures.panel(base, 1.5)
        charts.append(chart_of_facet(mesh, faces, builder.texel_m, draw, builder.texture_rng))
    return Part(mesh, mat.PLASTIC, tuple(charts), name="shell")


def _tank(size_m: float, scale: float, builder: PartBuilder) -> list[Part]:
    """The gas tank under the shell in its collar, and the regulator knob above it."""
    radius, length = 0.034 * scale, 0.042 * scale
    angle = np.linspace(-np.pi / 2, 0, 13)
    dome = np.column_stack([radius * np.cos(angle), -length + radius * (np.sin(angle))])
    profile = np.vstack([dome, [[radius, 0.01 * scale], [0.0, 0.01 * scale]]])
    profile[0, 0] = 0.0
    profile[:, 1] += 0.6 * radius
    # The wall above the dome carries a label of its own.
    label = [(12, 13, builder.textures.panel(0.36, 0.7))]
    wall = builder.revolved_part(revolve(profile, 56), label, mat.PAINT_GREY, "tank", 2.0)
    section = np.array([[0.033, -0.004], [0.041, -0.004], [0.041, 0.006], [0.033, 0.008]])
    collar = named("collar", (revolve(section * scale, 56, closed=True).mesh, mat.PAINT_BLACK))
    knob = drum(0.016 * scale, 0.021 * scale, 24, at=[0.01 * scale, 0, 0.5 * size_m - 0.003 * scale])
    cap = drum(0.010 * scale, 0.004 * scale, 20, at=[0.01 * scale, 0, 0.5 * size_m + 0.0165 * scale])
    return [
        wall.moved(pose([0, 0, 1.0], [0, 0, -0.5 * size_m])),
        *moved(collar, pose([0, 0, -1.0], [0, 0, -0.5 * size_m])),
        *named("knob", (knob, mat.PAINT_BLACK), (cap, mat.BRUSHED_METAL)),
    ]
