"""Equipment bolted onto spacecraft. Each item is mounted on z = 0 of its own frame, z away from the wall.

Feet extend slightly below z = 0, so that no two faces of a body are coplanar.
"""

import numpy as np

from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import (
    ball,
    box,
    drum,
    pose,
    prism,
    revolve,
    ring,
    strut,
    tube,
)
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import (
    ANODISED,
    BRUSHED_METAL,
    COMPOSITE,
    GLASS,
    PAINT_BLACK,
    PAINT_GREY,
    PAINT_WHITE,
)

SINK = 0.08
"""Share of an item's height that lies below the wall."""


def electronics_box(builder: PartBuilder, width_m: float, depth_m: float, height_m: float) -> list[Part]:
    """A box on a flange, with a labelled face and a row of connectors on one side."""
    rng = builder.rng
    base = float(rng.choice([0.06, 0.2, 0.35, 0.6]))
    body = box([width_m, depth_m, height_m * (1 + SINK)], bevel=0.05, at=[0, 0, 0.5 * height_m * (1 - SINK)])
    draw = builder.textures.panel(base, 0.8) if rng.random() < 0.75 else builder.textures.machined_plate()
    parts = [builder.flat_part(body, PAINT_GREY if base > 0.1 else PAINT_BLACK, draw, "equipment")]
    flange = box([1.14 * width_m, 1.14 * depth_m, 0.14 * height_m], bevel=0.1)
    parts.append(Part(flange, ANODISED, name="equipment"))
    count = int(rng.integers(2, 5))
    size = min(0.2 * height_m, 0.5 * width_m / count)
    for k in range(count):
        socket = drum(0.5 * size, 0.6 * size, 12)
        x = (k + 0.5) / count * 0.8 * width_m - 0.4 * width_m
        socket.apply_transform(pose([0, 1, 0], [x, 0.5 * depth_m - 0.1 * size, 0.5 * height_m]))
        parts.append(Part(socket, BRUSHED_METAL, name="equipment"))
    return parts


def star_tracker(builder: PartBuilder, size_m: float) -> list[Part]:
    """A tilted, hollow baffle on a small box; size_m is the baffle's length."""
    s = size_m
    block = box([0.62 * s, 0.5 * s, 0.4 * s], bevel=0.08, at=[0, 0, 0.15 * s])
    lean = pose([builder.rng.uniform(-0.5, 0.5), builder.rng.uniform(-0.5, 0.5), 1.0], [0, 0, 0.28 * s])
    outer, wall = 0.34 * s, 0.025 * s
    profile = [(0, 0), (0.2 * s, 0), (0.2 * s, 0.15 * s), (outer, 0.75 * s), (outer, s),
               (outer - wall, s), (outer - wall, 0.74 * s), (0.15 * s, 0.2 * s), (0, 0.2 * s)]  # fmt: skip
    baffle = revolve(profile, 24).mesh
    inside = revolve([(0.149 * s, 0.21 * s), (outer - 1.2 * wall, 0.735 * s), (outer - 1.2 * wall, 0.97 * s),
                      (outer - 2 * wall, 0.97 * s), (outer - 2 * wall, 0.74 * s), (0.12 * s, 0.22 * s)],
                     24, closed=True).mesh  # fmt: skip
    lens = ball(0.13 * s, 16, 8, at=[0, 0, 0.13 * s])
    return [
        builder.flat_part(block, PAINT_BLACK, builder.textures.panel(0.1, 0.5), "star_tracker"),
        *(
            Part(mesh, material, name="star_tracker").moved(lean)
            for mesh, material in ((baffle, PAINT_WHITE), (inside, PAINT_BLACK), (lens, GLASS))
        ),
    ]


def sun_sensor(size_m: float) -> list[Part]:
    """A small box with a glass window."""
    body = box([size_m, size_m, 0.5 * size_m], bevel=0.12, at=[0, 0, 0.2 * size_m])
    window = drum(0.3 * size_m, 0.1 * size_m, 16, at=[0, 0, 0.4 * size_m])
    return [Part(body, BRUSHED_METAL, name="sensor"), Part(window, GLASS, name="sensor")]


def camera_lens(size_m: float) -> list[Part]:
    """A barrel with a hood and a lens deep inside; size_m is the diameter."""
    s = 0.5 * size_m
    profile = [(0, -0.2 * s), (s, -0.2 * s), (s, 0.9 * s), (1.12 * s, 0.95 * s), (1.12 * s, 1.7 * s),
               (1.04 * s, 1.7 * s), (0.82 * s, 0.6 * s), (0, 0.6 * s)]  # fmt: skip
    barrel = revolve(profile, 32).mesh
    lens = revolve([(0, 0.5 * s), (0.8 * s, 0.58 * s), (0.6 * s, 0.74 * s), (0.3 * s, 0.82 * s),
                    (0, 0.85 * s)], 32).mesh  # fmt: skip
    ring = revolve([(0.98 * s, 0.3 * s), (1.06 * s, 0.32 * s), (1.06 * s, 0.5 * s), (0.98 * s, 0.52 * s)],
                   32, closed=True).mesh  # fmt: skip
    return [
        Part(barrel, PAINT_BLACK, name="lens"),
        Part(lens, GLASS, name="lens"),
        Part(ring, BRUSHED_METAL, name="lens"),
    ]


def handrail(length_m: float, radius_m: float) -> list[Part]:
    """A bar on two posts, along x."""
    h = 0.5 * length_m
    up = 5.0 * radius_m
    path = [[-h, 0, -radius_m], [-h, 0, 0.8 * up], [-h + 0.2 * up, 0, up], [h - 0.2 * up, 0, up],
            [h, 0, 0.8 * up], [h, 0, -radius_m]]  # fmt: skip
    return [Part(tube(path, radius_m, 10), PAINT_WHITE, name="handrail")]


def grapple_pin(size_m: float) -> list[Part]:
    """A grapple fixture for a robot arm: a round base with a pin on three legs."""
    base = drum(0.5 * size_m, 0.12 * size_m, 28, bevel=0.2, at=[0, 0, -0.03 * size_m])
    parts = [Part(base, BRUSHED_METAL, name="grapple")]
    top = np.array([0, 0, 0.45 * size_m])
    for angle in (0.3, 2.4, 4.5):
        foot = np.array([0.32 * np.cos(angle), 0.32 * np.sin(angle), 0.05]) * size_m
        parts.append(Part(strut(foot, top, 0.03 * size_m), ANODISED, name="grapple"))
    pin = drum(0.06 * size_m, 0.35 * size_m, 14, at=[0, 0, 0.4 * size_m])
    knob = ball(0.09 * size_m, 14, 8, at=[0, 0, 0.77 * size_m])
    return [*parts, Part(pin, ANODISED, name="grapple"), Part(knob, PAINT_WHITE, name="grapple")]


def umbilical(builder: PartBuilder, size_m: float) -> list[Part]:
    """A plate with two round connectors and a few sockets."""
    plate = box([size_m, 0.7 * size_m, 0.12 * size_m], bevel=0.2)
    parts = [builder.flat_part(plate, ANODISED, builder.textures.machined_plate(), "connector")]
    for x in (-0.24, 0.24):
        shell = ring(0.1 * size_m, 0.17 * size_m, 0.0, 0.16 * size_m, 20).mesh
        core = drum(0.09 * size_m, 0.12 * size_m, 16)
        for mesh, material in ((shell, BRUSHED_METAL), (core, PAINT_BLACK)):
            mesh.apply_translation([x * size_m, 0, -0.01 * size_m])
            parts.append(Part(mesh, material, name="connector"))
    return parts


def cable(points: np.ndarray[tuple[int, ...], np.dtype[np.float64]], radius_m: float) -> list[Part]:
    """A harness along points (n, 3) with clamps at every other one."""
    parts = [Part(tube(points, radius_m, 8), PAINT_BLACK, name="harness")]
    for point, ahead in zip(points[1:-1:2], points[2::2], strict=False):
        clamp = box([3.4 * radius_m, 3.4 * radius_m, 1.6 * radius_m], bevel=0.1)
        clamp.apply_transform(pose(ahead - point, point))
        parts.append(Part(clamp, BRUSHED_METAL, name="harness"))
    return parts


def hexagonal_can(builder: PartBuilder, size_m: float) -> list[Part]:
    """A six-sided canister with a lid."""
    angle = np.arange(6) * np.pi / 3
    outline = 0.5 * size_m * np.column_stack([np.cos(angle), np.sin(angle)])
    height = size_m * float(builder.rng.uniform(0.4, 0.8))
    can = prism(outline, 1.06 * height, taper=0.92, at=[0, 0, -0.06 * height])
    lid = drum(0.3 * size_m, 0.14 * size_m, 20, at=[0, 0, 0.96 * height])
    base = float(builder.rng.choice([0.08, 0.4, 0.7]))
    return [
        builder.flat_part(can, PAINT_GREY, builder.textures.panel(base, 1.0), "equipment"),
        Part(lid, COMPOSITE if base > 0.3 else BRUSHED_METAL, name="equipment"),
    ]
