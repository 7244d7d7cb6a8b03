"""An open lattice boom with equipment boxes, a radiator and a solar wing: thin structure, deep shadows."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.bodies import equipment
from polhode.simulation.bodies.equipment import decks_of_box, fit_out
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import ball, box, drum, frame, pose, strut
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material


def truss_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a truss size_m [m] long (x); G on its axis near the middle."""
    rng = builder.rng
    corners = int(rng.choice([3, 4, 4]))
    radius = size_m * float(rng.uniform(0.09, 0.13))
    angle = 2 * np.pi * (np.arange(corners) + 0.5) / corners
    section = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    module = 0.16 * size_m
    start, end = -0.5 * size_m + module, 0.5 * size_m - 0.3 * module
    bays = max(4, round((end - start) / (1.25 * radius)))
    stations = np.linspace(start, end, bays + 1)
    tubes = [mat.PAINT_WHITE, mat.COMPOSITE, mat.ANODISED][int(rng.integers(3))]
    parts = _lattice(stations, section, tubes, size_m, builder)
    parts += _end_module(builder, start, module, radius, size_m)
    # A plate at the far end with an antenna or a grapple fixture.
    plate = box([0.03 * size_m, 2.2 * radius, 2.2 * radius], bevel=0.15, at=[end + 0.012 * size_m, 0, 0])
    parts.append(builder.flat_part(plate, mat.ANODISED, builder.textures.machined_plate(), "plate"))
    dish = rng.random() < 0.5
    held = equipment.small_dish(builder, 0.3 * size_m) if dish else equipment.grapple_pin(0.12 * size_m)
    parts += moved(held, pose([1.0, 0, 0], [end + 0.026 * size_m, 0, 0]))
    for y in (-0.8, 0.8):
        foot = pose([1.0, 0.3 * y, 0.3], [end + 0.02 * size_m, y * radius, 0.6 * radius])
        parts += moved(equipment.whip(0.16 * size_m, 0.002 * size_m), foot)
    parts += _payloads(builder, stations, radius, size_m)
    n = 2 * bays + 1
    sag = [np.full(n, c) + 0.004 * size_m * rng.normal(0, 1, n) for c in section[0] * [0.93, 0.9]]
    return parts + equipment.cable(np.column_stack([np.linspace(start, end, n), *sag]), 0.006 * size_m)


def _lattice(
    stations: Array, section: Array, material: Material, size_m: float, builder: PartBuilder
) -> list[Part]:
    """Longerons, battens and diagonals with a ball at each node."""
    rng = builder.rng
    thick, thin = 0.0085 * size_m, 0.0055 * size_m
    nodes = np.stack([np.column_stack([np.full(len(section), x), section]) for x in stations])
    crossed = bool(rng.random() < 0.4)
    items = [(strut(*ends, thick), material) for ends in zip(nodes[0], nodes[-1], strict=True)]
    for k, ring in enumerate(nodes):
        for c, node in enumerate(ring):
            n = (c + 1) % len(ring)
            items.append((ball(1.7 * thick, 10, 6, at=node), mat.BRUSHED_METAL))
            items.append((strut(node, ring[n], thin), material))
            if k + 1 == len(nodes):
                continue
            ahead = nodes[k + 1]
            both = [(node, ahead[n], thin), (ring[n], ahead[c], 0.9 * thin)]
            for a, b, radius in both if crossed else both[(k + c) % 2 :][:1]:
                items.append((strut(a, b, radius), material))
            if rng.random() < 0.3:
                # Collars and labels of the assembly: no two struts look alike.
                collar = drum(1.35 * thick, 0.03 * size_m, 12)
                at = node + rng.uniform(0.25, 0.6) * (nodes[k + 1, c] - node)
                collar.apply_transform(pose([1.0, 0, 0], at))
                items.append((collar, mat.FOIL_GOLD if rng.random() < 0.5 else mat.PAINT_GREY))
    return named("truss", *items)


def _end_module(
    builder: PartBuilder, start: float, length: float, radius: float, size_m: float
) -> list[Part]:
    """The service module at the end of the boom."""
    rng, textures = builder.rng, builder.textures
    side = radius * float(rng.uniform(1.9, 2.5))
    sides = np.array([length, side, side])
    middle = np.array([start - 0.5 * length + 0.01 * size_m, 0, 0])
    foil = [mat.FOIL_GOLD, mat.FOIL_SILVER, mat.FOIL_BLACK][int(rng.integers(3))]
    painted = textures.panel(float(rng.choice([0.3, 0.7])), 0.8)
    sheets = [textures.blanket(foil), painted, textures.machined_plate()]
    chosen = [sheets[k] for k in rng.integers(3, size=6)]
    parts = [builder.flat_part(box(sides, bevel=0.04, at=middle), foil, chosen, "module", 1.5)]
    decks = decks_of_box(sides, middle)
    length, panels = size_m * float(rng.uniform(0.3, 0.45)), int(rng.integers(1, 4))
    cell = int(rng.integers(30, 50))
    wing = equipment.solar_wing(builder, length, 0.22 * size_m, 0.007 * size_m, panels, 0.06 * size_m, cell)
    tilt = float(rng.uniform(-0.8, 0.8))
    X = frame([0, 1.0, 0], [np.sin(tilt), 0, np.cos(tilt)], middle + np.array([0, 0.5 * side, 0]))
    parts += moved(wing, X)
    decks["+y"].reserve(0, 0, 0.06 * size_m)
    for name in ("-x", "-y", "+z", "-z"):
        parts += fit_out(decks[name], 0.4 * size_m, builder, 1, int(rng.integers(1, 4)))
    return parts


def _payloads(builder: PartBuilder, stations: Array, radius: float, size_m: float) -> list[Part]:
    """Boxes on the sides of the boom, bottles inside it, a radiator beside it."""
    rng = builder.rng
    parts: list[Part] = []
    free = list(rng.permutation(len(stations) - 1))
    middles = 0.5 * (stations[:-1] + stations[1:])
    for _ in range(min(4, len(free))):
        x = middles[int(free.pop())]
        out = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, -1.0, 0]])[int(rng.integers(3))]
        tray = named("tray", (box([0.13 * size_m, 0.11 * size_m, 0.014 * size_m], bevel=0.2), mat.ANODISED))
        parts += moved(tray, pose(out, radius * 0.78 * out + [x, 0, 0]))
        X = pose(out, (radius * 0.78 + 0.006 * size_m) * out + [x, 0, 0], float(rng.integers(2)) * np.pi / 2)
        w, d, h = size_m * rng.uniform((0.07, 0.05, 0.03), (0.11, 0.09, 0.07))
        parts += moved(equipment.electronics_box(builder, w, d, h), X)
    for bay in free[:2]:
        parts += moved(equipment.bottle(0.5 * radius, rng), pose([0, 0, 1.0], [middles[bay], 0, 0]))
    for bay in free[2:4]:
        X = pose([0, 0, 1.0], [stations[bay], 0, 0.78 * radius])
        parts += moved(equipment.handrail(0.1 * size_m, 0.004 * size_m), X)
    # A radiator: a thin panel on two arms along the -y side.
    length, height = size_m * float(rng.uniform(0.25, 0.4)), size_m * float(rng.uniform(0.16, 0.26))
    sheet = box([length, 0.009 * size_m, height], bevel=0.2)
    x = float(rng.uniform(stations[0] + 0.6 * length, stations[-1] - 0.6 * length))
    aside = -radius - 0.05 * size_m
    lean = float(rng.normal(0, 0.15))
    X = frame([1.0, 0, 0], [0, -np.sin(lean), np.cos(lean)], [x, aside, 0.2 * height])
    panel = builder.flat_part(sheet, mat.PAINT_WHITE, builder.textures.radiator(), "radiator", 0.6)
    parts.append(panel.moved(X))
    for side in (-0.35, 0.35):
        along = x + side * length
        arm = strut([along, -0.6 * radius, 0], [along, aside, 0.1 * height], 0.006 * size_m)
        parts += named("radiator", (arm, mat.BRUSHED_METAL))
    return parts
