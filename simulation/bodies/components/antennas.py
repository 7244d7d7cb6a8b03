"""Antennas. Each is mounted on z = 0 of its own frame, z away from the wall."""

import numpy as np

from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import (
    Revolved,
    ball,
    box,
    drum,
    pose,
    radial,
    revolve,
    strut,
    tube,
)
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import (
    ANODISED,
    BRUSHED_METAL,
    COMPOSITE,
    PAINT_BLACK,
    PAINT_GREY,
    PAINT_WHITE,
)


def patch(builder: PartBuilder, size_m: float) -> list[Part]:
    """A flat square antenna: a ceramic tile on a plate, four screws."""
    plate = box([size_m, size_m, 0.12 * size_m], bevel=0.2)
    tile = box([0.72 * size_m, 0.72 * size_m, 0.12 * size_m], bevel=0.15, at=[0, 0, 0.1 * size_m])
    feed = drum(0.04 * size_m, 0.05 * size_m, 10, at=[0.1 * size_m, 0.06 * size_m, 0.14 * size_m])
    base = float(builder.rng.choice([0.3, 0.7]))
    return [
        Part(plate, ANODISED, name="antenna"),
        builder.flat_part(tile, PAINT_GREY, builder.textures.plain(base), "antenna"),
        Part(feed, BRUSHED_METAL, name="antenna"),
    ]


def helix(length_m: float, radius_m: float) -> list[Part]:
    """A helix around a post on a round ground plate."""
    turns = max(3, int(length_m / (0.9 * radius_m)))
    angle = np.linspace(0, 2 * np.pi * turns, 10 * turns)
    path = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle),
                            0.06 * length_m + 0.92 * length_m * angle / angle[-1]])  # fmt: skip
    plate = drum(1.8 * radius_m, 0.14 * length_m, 28, at=[0, 0, -0.1 * length_m])
    return [
        Part(plate, BRUSHED_METAL, name="antenna"),
        Part(tube(path, 0.1 * radius_m, 6), BRUSHED_METAL, name="antenna"),
        Part(strut([0, 0, -0.02 * length_m], [0, 0, length_m], 0.16 * radius_m), PAINT_WHITE, name="antenna"),
    ]


def whip(length_m: float, radius_m: float) -> list[Part]:
    """A rod on an insulator."""
    foot = drum(4.0 * radius_m, 8.0 * radius_m, 12, bevel=0.2, at=[0, 0, -2.0 * radius_m])
    return [
        Part(foot, PAINT_BLACK, name="antenna"),
        Part(strut([0, 0, -0.9 * radius_m], [0, 0, length_m], radius_m, 6), BRUSHED_METAL, name="antenna"),
    ]


def horn(size_m: float) -> list[Part]:
    """A conical horn with corrugations; size_m is its height."""
    s = size_m
    outer = [(0, -0.05 * s), (0.16 * s, -0.05 * s), (0.16 * s, 0.2 * s), (0.32 * s, 0.7 * s),
             (0.35 * s, 0.72 * s), (0.35 * s, 0.78 * s), (0.4 * s, s)]  # fmt: skip
    inner = [(0.375 * s, s), (0.28 * s, 0.66 * s), (0.12 * s, 0.25 * s), (0, 0.25 * s)]
    return [Part(revolve([*outer, *inner], 32).mesh, ANODISED, name="antenna")]


def paraboloid(diameter_m: float, focal_m: float, wall_m: float, sections: int, steps: int) -> Revolved:
    """A dish about z that opens towards +z, the vertex of its front at the origin, its rim folded back.

    Points 0 .. steps of the profile are the back from the axis to the rim, the last steps + 1 the front.
    """
    r = np.linspace(0.0, 0.5 * diameter_m, steps + 1)
    front = np.column_stack([r, r * r / (4.0 * focal_m)])
    back = np.column_stack([r, front[:, 1] - wall_m])
    rim = [(0.5 * diameter_m + wall_m, back[-1, 1] - wall_m), (0.5 * diameter_m + wall_m, front[-1, 1])]
    return revolve(np.vstack([back, rim, front[::-1]]), sections)


def small_dish(builder: PartBuilder, diameter_m: float) -> list[Part]:
    """A high-gain antenna on a gimballed mast: reflector with gores, feed on three struts."""
    rng = builder.rng
    focal, mast = 0.38 * diameter_m, 0.32 * diameter_m
    steps = 6
    solid = paraboloid(diameter_m, focal, 0.012 * diameter_m, 40, steps)
    base = float(rng.choice([0.75, 0.75, 0.3]))
    last = len(solid.profile) - 1
    draw = builder.textures.reflector(base, int(rng.integers(6, 13)))
    reflector = builder.revolved_part(solid, [(last - steps, last - 1, draw)], PAINT_WHITE, "dish")
    parts = [reflector]
    for angle in np.arange(3) * 2 * np.pi / 3 + rng.uniform(0, 2):
        edge = 0.42 * diameter_m * radial(angle)
        edge[2] = 0.42**2 * diameter_m**2 / (4 * focal)
        parts.append(Part(strut(edge, [0, 0, focal], 0.008 * diameter_m), PAINT_WHITE, name="dish"))
    feed = drum(0.05 * diameter_m, 0.12 * diameter_m, 16, bevel=0.2, at=[0, 0, focal - 0.06 * diameter_m])
    hub = ball(0.07 * diameter_m, 16, 8, at=[0, 0, -0.07 * diameter_m])
    parts += [Part(feed, COMPOSITE, name="dish"), Part(hub, ANODISED, name="dish")]
    X = pose([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), 1.0], [0, 0, mast + 0.07 * diameter_m])
    post = strut([0, 0, -0.04 * diameter_m], [0, 0, mast], 0.03 * diameter_m, 14)
    return [*(part.moved(X) for part in parts), Part(post, BRUSHED_METAL, name="mast")]
