"""A big dish on a small bus: reflector with ribs behind, feed on struts, a solar wing."""

import numpy as np

from polhode.simulation.bodies.equipment import decks_of_box, fit_out, paraboloid, solar_wing
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import box, drum, frame, pose, radial, revolve, ring, strut, tube
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat

SECTIONS, STEPS = 72, 10


def dish_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a dish of diameter size_m [m] that opens towards +z, the bus behind it; G at the vertex."""
    rng = builder.rng
    focal = size_m * float(rng.uniform(0.32, 0.46))
    gores = int(rng.integers(8, 19))
    parts = _reflector(builder, size_m, focal, gores) + _feed(builder, size_m, focal)
    # A drum behind the vertex and six struts that carry the dish.
    hub = 0.10 * size_m
    parts += named("hub", (drum(0.13 * size_m, hub, 40, at=[0, 0, -hub - 0.004 * size_m]), mat.PAINT_GREY))
    for k in range(6):
        out = radial(2 * np.pi * (k + 0.25) / 6)
        a, b = 0.15 * size_m * out + [0, 0, -1.1 * hub], 0.3 * size_m * out + [0, 0, 0.03 * size_m]
        parts += named("hub", (strut(a, b, 0.008 * size_m), mat.COMPOSITE))
    return parts + _bus(builder, size_m, hub)


def _reflector(builder: PartBuilder, size_m: float, focal: float, gores: int) -> list[Part]:
    rng, textures = builder.rng, builder.textures
    wall_m = 0.006 * size_m
    solid = paraboloid(size_m, focal, wall_m, SECTIONS, STEPS)
    last = len(solid.profile) - 1
    base = float(rng.choice([0.78, 0.78, 0.6, 0.3]))
    front = textures.reflector(base, gores)
    back = textures.blanket(mat.FOIL_BLACK) if rng.random() < 0.4 else textures.reflector(0.08, gores)
    material = mat.PAINT_WHITE if base > 0.2 else mat.COMPOSITE
    walls = [(last - STEPS, last - 1, front), (1, STEPS, back)]
    parts = [builder.revolved_part(solid, walls, material, "reflector", 0.5)]
    r = np.linspace(0.13, 0.5, 7) * size_m
    for k in range(gores):
        angle = 2 * np.pi * k / gores
        spine = np.column_stack([r * np.cos(angle), r * np.sin(angle), r**2 / (4 * focal) - 1.6 * wall_m])
        parts += named("rib", (tube(spine, 1.1 * wall_m, 6), mat.COMPOSITE))
    for share in (0.22, 0.36):
        radius = share * size_m
        z = radius * radius / (4.0 * focal) - 1.8 * wall_m
        stiffener = ring(radius - wall_m, radius + wall_m, z - wall_m, z + 0.6 * wall_m, SECTIONS)
        parts += named("rib", (stiffener.mesh, mat.COMPOSITE))
    return parts


def _feed(builder: PartBuilder, size_m: float, focal: float) -> list[Part]:
    """Struts that hold a horn at the focus, or a secondary mirror before a horn at the vertex."""
    rng, textures, d = builder.rng, builder.textures, size_m
    legs = int(rng.integers(3, 5))
    start = float(rng.uniform(0, 2))
    foot = d * float(rng.uniform(0.26, 0.44))
    top = 0.93 * focal
    parts = []
    for k in range(legs):
        out = radial(start + 2 * np.pi * k / legs)
        a, b = foot * out + [0, 0, foot * foot / (4.0 * focal)], 0.05 * d * out + [0, 0, top]
        shoe = drum(0.016 * d, 0.02 * d, 12)
        shoe.apply_transform(pose(b - a, a - 0.004 * (b - a)))
        leg = strut(a, b, 0.007 * d, 10)
        parts += named("feed", (leg, mat.PAINT_WHITE), (shoe, mat.BRUSHED_METAL))
    if rng.random() < 0.5:
        r = 0.085 * d
        mirror = revolve([(0, top - 0.035 * d), (0.6 * r, top - 0.02 * d), (r, top + 0.012 * d),
                          (r, top + 0.025 * d), (0, top + 0.045 * d)], 40)  # fmt: skip
        horn = revolve([(0, -0.02 * d), (0.04 * d, -0.02 * d), (0.045 * d, 0.1 * d), (0.065 * d, 0.17 * d),
                        (0.06 * d, 0.17 * d), (0.035 * d, 0.1 * d), (0, 0.1 * d)], 36)  # fmt: skip
        return parts + named("feed", (mirror.mesh, mat.PAINT_WHITE), (horn.mesh, mat.ANODISED))
    can = box([0.1 * d, 0.1 * d, 0.09 * d], bevel=0.08, at=[0, 0, top + 0.03 * d])
    draw = textures.panel(0.6, 0.8) if rng.random() < 0.5 else textures.blanket(mat.FOIL_GOLD)
    horn = revolve([(0, top), (0.02 * d, top), (0.045 * d, top - 0.06 * d), (0.04 * d, top - 0.06 * d),
                    (0, top - 0.02 * d)], 28)  # fmt: skip
    parts.append(builder.flat_part(can, mat.FOIL_GOLD, draw, "feed"))
    return parts + named("feed", (horn.mesh, mat.ANODISED))


def _bus(builder: PartBuilder, size_m: float, hub: float) -> list[Part]:
    """The bus behind the hub with its wing and equipment."""
    rng, textures = builder.rng, builder.textures
    sides = size_m * rng.uniform((0.24, 0.24, 0.2), (0.36, 0.36, 0.42))
    middle = np.array([0.0, 0.0, -hub - 0.5 * sides[2]])
    foil = [mat.FOIL_GOLD, mat.FOIL_SILVER, mat.FOIL_BLACK][int(rng.integers(3))]
    sheets = [textures.blanket(foil), textures.panel(0.35, 0.8), textures.radiator(), textures.blanket(foil)]
    chosen = [sheets[k] for k in rng.permutation(6) % 4]
    parts = [builder.flat_part(box(sides, bevel=0.025, at=middle), foil, chosen, "box", 1.5)]
    decks = decks_of_box(sides, middle)
    wings = [1.0] if rng.random() < 0.55 else [1.0, -1.0]
    tilt, cell = float(rng.uniform(-1.2, 1.2)), int(rng.integers(34, 56))
    panels = int(rng.integers(1, 3))
    length = size_m * float(rng.uniform(0.34, 0.5)) * (0.5 + 0.5 * panels)
    width = size_m * float(rng.uniform(0.24, 0.36))
    for side in wings:
        root = middle + np.array([0.5 * side * sides[0], 0, -0.1 * sides[2]])
        wing = solar_wing(builder, length, width, 0.008 * size_m, panels, 0.1 * size_m, cell)
        parts += moved(wing, frame([side, 0, 0], [0, np.sin(tilt), np.cos(tilt)], root))
        decks["+x" if side > 0 else "-x"].reserve(0, 0, 0.1 * size_m)
    for name, deck in decks.items():
        if name != "+z":
            parts += fit_out(deck, 0.5 * size_m, builder, 1, int(rng.integers(1, 5)))
    return parts
