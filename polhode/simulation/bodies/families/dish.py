"""A big dish on a small bus: reflector with ribs behind, feed on struts, a solar wing."""

import numpy as np

from polhode.simulation.bodies.equipment import paraboloid, solar_wing
from polhode.simulation.bodies.layout import decks_of_box, fit_out
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import box, drum, frame, pose, radial, revolve, ring, strut, tube
from polhode.simulation.bodies.textures.part_builder import PartBuilder, sheet_by_side
from polhode.simulation.surface import materials as mat

SECTIONS, STEPS = 72, 10


def dish_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a dish of diameter size_m [m] that opens towards +z, the bus behind it; G at the vertex."""
    rng = builder.rng
    focal = size_m * float(rng.uniform(0.32, 0.46))
    gores = int(rng.integers(8, 19))
    hub = 0.10 * size_m
    parts = _reflector(builder, size_m, focal, gores) + _feed(builder, size_m, focal)
    return parts + _hub(size_m, hub) + _bus(builder, size_m, hub)


def _depth(r: float, focal: float) -> float:
    return r * r / (4.0 * focal)


def _reflector(builder: PartBuilder, size_m: float, focal: float, gores: int) -> list[Part]:
    rng = builder.rng
    wall_m = 0.006 * size_m
    solid = paraboloid(size_m, focal, wall_m, SECTIONS, STEPS)
    last = len(solid.profile) - 1
    base = float(rng.choice([0.78, 0.78, 0.6, 0.3]))
    front = builder.textures.reflector(base, gores)
    wrapped = rng.random() < 0.4
    back = builder.textures.blanket(mat.FOIL_BLACK) if wrapped else builder.textures.reflector(0.08, gores)
    material = mat.PAINT_WHITE if base > 0.2 else mat.COMPOSITE
    walls = [(last - STEPS, last - 1, front), (1, STEPS, back)]
    parts = [builder.revolved_part(solid, walls, material, "reflector", 0.5)]
    radii = np.linspace(0.13, 0.5, 7) * size_m
    for k in range(gores):
        angle = 2 * np.pi * k / gores
        spine = np.column_stack([
            radii * np.cos(angle), radii * np.sin(angle), radii**2 / (4 * focal) - 1.6 * wall_m,
        ])  # fmt: skip
        parts.append(Part(tube(spine, 1.1 * wall_m, 6), mat.COMPOSITE, name="rib"))
    for share in (0.22, 0.36):
        r = share * size_m
        z = _depth(r, focal) - 1.8 * wall_m
        stiffener = ring(r - wall_m, r + wall_m, z - wall_m, z + 0.6 * wall_m, SECTIONS)
        parts.append(Part(stiffener.mesh, mat.COMPOSITE, name="rib"))
    return parts


def _feed(builder: PartBuilder, size_m: float, focal: float) -> list[Part]:
    """Struts that hold a horn at the focus, or a secondary mirror before a horn at the vertex."""
    rng = builder.rng
    legs = int(rng.integers(3, 5))
    start = float(rng.uniform(0, 2))
    foot = size_m * float(rng.uniform(0.26, 0.44))
    top = 0.93 * focal
    parts = []
    for k in range(legs):
        angle = start + 2 * np.pi * k / legs
        out = radial(angle)
        a, b = foot * out + [0, 0, _depth(foot, focal)], 0.05 * size_m * out + [0, 0, top]
        shoe = drum(0.016 * size_m, 0.02 * size_m, 12)
        shoe.apply_transform(pose(b - a, a - 0.004 * (b - a)))
        leg = strut(a, b, 0.007 * size_m, 10)
        parts += named("feed", (leg, mat.PAINT_WHITE), (shoe, mat.BRUSHED_METAL))
    if rng.random() < 0.5:
        d, r = size_m, 0.085 * size_m
        mirror = revolve([(0, top - 0.035 * d), (0.6 * r, top - 0.02 * d), (r, top + 0.012 * d),
                          (r, top + 0.025 * d), (0, top + 0.045 * d)], 40)  # fmt: skip
        horn = revolve([(0, -0.02 * d), (0.04 * d, -0.02 * d), (0.045 * d, 0.1 * d), (0.065 * d, 0.17 * d),
                        (0.06 * d, 0.17 * d), (0.035 * d, 0.1 * d), (0, 0.1 * d)], 36)  # fmt: skip
        return parts + named("feed", (mirror.mesh, mat.PAINT_WHITE), (horn.mesh, mat.ANODISED))
    can = box([0.1 * size_m, 0.1 * size_m, 0.09 * size_m], bevel=0.08, at=[0, 0, top + 0.03 * size_m])
    draw = builder.textures.panel(0.6, 0.8) if rng.random() < 0.5 else builder.textures.blanket(mat.FOIL_GOLD)
    horn = revolve([(0, top), (0.02 * size_m, top), (0.045 * size_m, top - 0.06 * size_m),
                    (0.04 * size_m, top - 0.06 * size_m), (0, top - 0.02 * size_m)], 28)  # fmt: skip
    parts.append(builder.flat_part(can, mat.FOIL_GOLD, draw, "feed"))
    return parts + named("feed", (horn.mesh, mat.ANODISED))


def _hub(size_m: float, depth_m: float) -> list[Part]:
    """A drum behind the vertex and six struts that carry the dish."""
    can = drum(0.13 * size_m, depth_m, 40, at=[0, 0, -depth_m - 0.004 * size_m])
    parts = [Part(can, mat.PAINT_GREY, name="hub")]
    for k in range(6):
        angle = 2 * np.pi * (k + 0.25) / 6
        out = radial(angle)
        a, b = 0.15 * size_m * out + [0, 0, -1.1 * depth_m], 0.3 * size_m * out + [0, 0, 0.03 * size_m]
        parts.append(Part(strut(a, b, 0.008 * size_m), mat.COMPOSITE, name="hub"))
    return parts


def _bus(builder: PartBuilder, size_m: float, hub: float) -> list[Part]:
    """The bus behind the hub with its wing and equipment."""
    rng, textures = builder.rng, builder.textures
    sides = size_m * rng.uniform((0.24, 0.24, 0.2), (0.36, 0.36, 0.42))
    middle = np.array([0.0, 0.0, -hub - 0.5 * sides[2]])
    foil = [mat.FOIL_GOLD, mat.FOIL_SILVER, mat.FOIL_BLACK][int(rng.integers(3))]
    sheets = [textures.blanket(foil), textures.panel(0.35, 0.8), textures.radiator(), textures.blanket(foil)]
    order = rng.permutation(6) % 4
    hull = box(sides, bevel=0.025, at=middle)
    parts = [builder.flat_part_by_side(hull, foil, sheet_by_side([sheets[k] for k in order]), "box", 1.5)]
    decks = decks_of_box(sides, middle)
    wings = [1.0] if rng.random() < 0.55 else [1.0, -1.0]
    tilt, cell = float(rng.uniform(-1.2, 1.2)), int(rng.integers(34, 56))
    panels = int(rng.integers(1, 3))
    length = size_m * float(rng.uniform(0.34, 0.5)) * (0.5 + 0.5 * panels)
    width = size_m * float(rng.uniform(0.24, 0.36))
    for side in wings:
        root = middle + np.array([0.5 * side * sides[0], 0, -0.1 * sides[2]])
        X = frame([side, 0, 0], [0, np.sin(tilt), np.cos(tilt)], root)
        wing = solar_wing(builder, length, width, 0.008 * size_m, panels, 0.1 * size_m, cell)
        parts += moved(wing, X)
        decks["+x" if side > 0 else "-x"].reserve(0, 0, 0.1 * size_m)
    for name, deck in decks.items():
        if name != "+z":
            parts += fit_out(deck, 0.5 * size_m, builder, 1, int(rng.integers(1, 5)))
    return parts
