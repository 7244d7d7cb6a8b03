"""A spent upper stage: tanks, interstage ring, engine, pressure bottles, cable tunnel, payload adapter."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.bodies import equipment
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import (
    ellipsoid_cap,
    frame,
    pose,
    prism,
    radial,
    revolve,
    ring,
    strut,
    tube,
)
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

SECTIONS = 72


def upper_stage_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a stage size_m [m] long from the nozzle's exit (-z) to the adapter's rim (+z)."""
    rng = builder.rng
    radius = size_m * float(rng.uniform(0.13, 0.22))
    nozzle = size_m * float(rng.uniform(0.14, 0.24))
    adapter = size_m * float(rng.uniform(0.05, 0.1))
    throat = -0.5 * size_m + nozzle
    bottom = throat + 0.5 * nozzle + 0.35 * radius
    top = 0.5 * size_m - adapter
    two_tanks = bool(rng.random() < 0.4)
    middle = bottom + (top - bottom) * float(rng.uniform(0.3, 0.42)) if two_tanks else bottom
    lower_radius = radius * (float(rng.uniform(0.62, 0.8)) if two_tanks else 1.0)
    parts = _tank(builder, radius, middle, top)
    if two_tanks:
        parts += _second_tank(builder, lower_radius, radius, bottom, middle)
    else:
        parts += _aft_skirt(builder, radius, bottom)
    parts += _thrust_section(builder, lower_radius, nozzle, throat, bottom)
    parts += _front(builder, radius, top, adapter)
    parts += _sides(builder, radius, middle, top)
    return parts


def _tank(builder: PartBuilder, radius: float, bottom: float, top: float) -> list[Part]:
    """The main tank: a wall with one chart around it, a dome at either end."""
    rng = builder.rng
    length = top - bottom
    solid = revolve([(0, bottom), (radius, bottom), (radius, top), (0, top)], SECTIONS)
    look = rng.random()
    if look < 0.62:
        base, material = float(rng.choice([0.78, 0.78, 0.5, 0.3])), mat.PAINT_WHITE
        wall = builder.textures.tank_wall(base)
    elif look < 0.8:
        base, material = 0.12, mat.BRUSHED_METAL
        wall = builder.textures.tank_wall(base)
    else:
        material = mat.FOIL_GOLD if rng.random() < 0.6 else mat.FOIL_SILVER
        wall = builder.textures.blanket(material)
    parts = [builder.revolved_part(solid, [(1, 2, wall)], material, "tank")]
    parts += _dome(builder, radius, bottom, -0.4 * radius) + _dome(builder, radius, top, 0.36 * radius)
    # Raised rings at the welds of the domes.
    for z in (bottom + 0.03 * length, top - 0.03 * length):
        weld = ring(0.97 * radius, 1.015 * radius, z - 0.012 * length, z + 0.012 * length, SECTIONS)
        parts.append(Part(weld.mesh, mat.BRUSHED_METAL, name="ring"))
    return parts


def _dome(builder: PartBuilder, radius: float, z: float, height: float) -> list[Part]:
    """An elliptic dome of height [m] (downwards when negative) with a manhole and radial seams."""
    rng = builder.rng
    cap = ellipsoid_cap(0.985 * radius, abs(height))[::-1]
    solid = revolve(np.vstack([[(0, -0.1 * radius)], [(0.985 * radius, -0.1 * radius)], cap]), 48)
    material = [mat.FOIL_GOLD, mat.FOIL_SILVER, mat.FOIL_BLACK, mat.PAINT_GREY, mat.BRUSHED_METAL][
        int(rng.integers(5))
    ]
    r, h = 0.2 * radius, abs(height)
    cover = revolve([(0, 0.9 * h), (r, 0.9 * h), (r, 1.03 * h), (0, 1.03 * h)], 28)
    X = pose([0, 0, np.sign(height)], [0, 0, z])
    return moved(named("dome", (solid.mesh, material), (cover.mesh, mat.ANODISED)), X)


def _second_tank(
    builder: PartBuilder, radius: float, upper_radius: float, bottom: float, top: float
) -> list[Part]:
    """A smaller tank below the main one, hung in an open truss."""
    rng = builder.rng
    gap = 0.16 * (top - bottom) + 0.3 * upper_radius
    upper = top - gap
    solid = revolve([(0, bottom), (radius, bottom), (radius, upper), (0, upper)], SECTIONS)
    foil = mat.FOIL_GOLD if rng.random() < 0.5 else mat.FOIL_SILVER
    wrapped, base = bool(rng.random() < 0.5), float(rng.choice([0.1, 0.6]))
    wall = builder.textures.blanket(foil) if wrapped else builder.textures.tank_wall(base)
    material = foil if wrapped else mat.PAINT_WHITE
    parts = [builder.revolved_part(solid, [(1, 2, wall)], material, "tank")]
    parts += _dome(builder, radius, bottom, -0.4 * radius) + _dome(builder, radius, upper, 0.4 * radius)
    count = int(rng.integers(8, 13))
    for k in range(count):
        for step in (-0.5, 0.5):
            low, high = 2 * np.pi * k / count, 2 * np.pi * (k + step) / count
            a = [0.99 * radius * np.cos(low), 0.99 * radius * np.sin(low), upper - 0.04 * gap]
            b = [0.96 * upper_radius * np.cos(high), 0.96 * upper_radius * np.sin(high), top + 0.01 * gap]
            parts.append(Part(strut(a, b, 0.022 * radius), mat.COMPOSITE, name="truss"))
    return parts


def _aft_skirt(builder: PartBuilder, radius: float, bottom: float) -> list[Part]:
    """A ring below the tank, open at its lower end, with stringers outside."""
    low = bottom - 0.32 * radius
    skirt = ring(0.94 * radius, 1.005 * radius, low, bottom + 0.06 * radius, SECTIONS)
    base = float(builder.rng.choice([0.08, 0.3, 0.6]))
    wall = builder.textures.ring_wall(base)
    return [builder.revolved_part(skirt, [(1, 2, wall)], mat.PAINT_GREY, "skirt")]


def _thrust_section(
    builder: PartBuilder, radius: float, nozzle: float, throat: float, bottom: float
) -> list[Part]:
    """Engines, the struts that carry them, bottles and pipes around."""
    rng = builder.rng
    exit_m = nozzle * float(rng.uniform(0.34, 0.48))
    pair = bool(rng.random() < 0.25 and exit_m < 0.48 * radius)
    places = [np.array([0.52 * radius, 0.0]), np.array([-0.52 * radius, 0.0])] if pair else [np.zeros(2)]
    if not pair:
        exit_m = min(exit_m, 0.95 * radius)
    parts: list[Part] = []
    for place in places:
        X = pose([0.0, 0.0, -1.0], [*place, throat], float(rng.uniform(0, 6)))
        parts += moved(equipment.engine(builder, exit_m, nozzle), X)
    frame = throat + 0.5 * nozzle
    plate = revolve([(0, frame - 0.02 * radius), (0.42 * radius, frame - 0.02 * radius),
                     (0.86 * radius, bottom + 0.02 * radius), (0, bottom + 0.02 * radius)], 40)  # fmt: skip
    parts.append(Part(plate.mesh, mat.DARK_METAL, name="thrust_frame"))
    for k in range(10):
        angle = 2 * np.pi * k / 10
        out = radial(angle)
        a, b = 0.43 * radius * out + [0, 0, frame], 0.93 * radius * out + [0, 0, bottom]
        parts.append(Part(strut(a, b, 0.02 * radius), mat.BRUSHED_METAL, name="thrust_frame"))
    count = int(rng.integers(2, 6))
    size = radius * float(rng.uniform(0.14, 0.2))
    for k in range(count):
        angle = 2 * np.pi * (k + 0.5) / count + 0.4
        at = np.array([0.74 * radius * np.cos(angle), 0.74 * radius * np.sin(angle), frame + 0.02 * radius])
        parts += moved(equipment.bottle(size, rng), pose([0, 0, 1.0], at))
        inwards, up = np.array([[1, 1, 1], [1, 1, 1], [0.7, 0.7, 1]]), np.array([0, 1.4, 1.6])
        pipe = at * inwards + size * np.outer(up, [0, 0, 1])
        parts.append(Part(tube(pipe, 0.07 * size, 8), mat.BRUSHED_METAL, name="pipe"))
    return parts


def _front(builder: PartBuilder, radius: float, top: float, adapter: float) -> list[Part]:
    """Forward ring with avionics inside, and the payload adapter: an open cone with a bright rim."""
    rng = builder.rng
    upper = radius * float(rng.uniform(0.55, 0.92))
    wall_m = 0.03 * radius
    foot, rim = top - 0.08 * radius, top + adapter
    profile = [(1.004 * radius, foot), (1.004 * radius, top + 0.1 * adapter), (upper, rim - 0.12 * adapter),
               (upper - wall_m, rim - 0.12 * adapter), (0.95 * radius, top + 0.1 * adapter),
               (0.95 * radius, foot)]  # fmt: skip
    cone = revolve(profile, SECTIONS, closed=True)
    base = float(rng.choice([0.05, 0.35, 0.7]))
    material = mat.COMPOSITE if base < 0.1 else mat.PAINT_GREY
    parts = [builder.revolved_part(cone, [(0, 2, builder.textures.ring_wall(base))], material, "adapter")]
    inner, outer, foot = upper - 1.5 * wall_m, upper + 0.6 * wall_m, rim - 0.14 * adapter
    flange = ring(inner, outer, foot, rim, SECTIONS)
    parts.append(Part(flange.mesh, mat.BRUSHED_METAL, name="adapter"))
    for k in range(int(rng.integers(3, 6))):
        angle = 2 * np.pi * k / 6 + rng.uniform(0, 0.4)
        at = [0.5 * radius * np.cos(angle), 0.5 * radius * np.sin(angle), top + 0.2 * radius]
        things = equipment.electronics_box(builder, 0.22 * radius, 0.16 * radius, 0.1 * radius)
        parts += moved(things, pose([0, 0, 1.0], at, angle))
    return parts


def _sides(builder: PartBuilder, radius: float, bottom: float, top: float) -> list[Part]:
    """Equipment along the wall: cable tunnels, a feed line, thruster blocks, hatches, antennas."""
    rng = builder.rng
    length = top - bottom
    parts = []
    for angle in rng.uniform(0, 2 * np.pi) + np.array([0.0, np.pi])[: int(rng.integers(1, 3))]:
        parts += _tunnel(builder, radius, bottom + 0.06 * length, top - 0.02 * length, float(angle))
    if rng.random() < 0.6:
        angle = float(rng.uniform(0, 2 * np.pi))
        out = radial(angle)
        z = np.linspace(bottom - 0.05 * length, top - 0.12 * length, 9)
        offset = np.r_[0.92, np.full(7, 1.035), 0.98]
        parts += equipment.cable(radius * offset[:, None] * out + z[:, None] * [0, 0, 1.0], 0.022 * radius)
    for angle in rng.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2:
        at = _on_wall(radius, angle, bottom + 0.05 * length)
        parts += moved(equipment.thruster_block(builder, 0.16 * radius), at)
    for _ in range(5):
        angle = rng.uniform(0, 2 * np.pi)
        at = _on_wall(radius, angle, rng.uniform(bottom + 0.15 * length, top - 0.1 * length))
        kind = rng.integers(3)
        if kind == 0:
            things = equipment.patch(builder, 0.16 * radius)
        elif kind == 1:
            things = equipment.umbilical(builder, 0.24 * radius)
        else:
            things = equipment.electronics_box(builder, 0.3 * radius, 0.22 * radius, 0.08 * radius)
        parts += moved(things, at)
    return parts


def _tunnel(builder: PartBuilder, radius: float, low: float, high: float, angle: float) -> list[Part]:
    """A long cover with slanted ends along the wall."""
    rng = builder.rng
    wide, tall = 0.16 * radius, 0.09 * radius
    half = 0.5 * (high - low)
    outline = [(-0.5 * wide, -half), (0.5 * wide, -half), (0.5 * wide, half), (-0.5 * wide, half)]
    cover = prism(outline, 1.6 * tall, taper=0.9, at=[0, 0, -0.6 * tall])
    base = float(rng.choice([0.08, 0.4, 0.75]))
    material: Material = mat.PAINT_WHITE if base > 0.5 else mat.PAINT_BLACK if base < 0.1 else mat.PAINT_GREY
    part = builder.flat_part(cover, material, builder.textures.panel(base, 0.4), "tunnel")
    return [part.moved(_on_wall(radius, angle, 0.5 * (low + high)))]


def _on_wall(radius: float, angle: float, z: float) -> Array:
    """Frame on a cylinder: z outward, y along the cylinder's axis."""
    out = radial(angle)
    return frame([-np.sin(angle), np.cos(angle), 0.0], out, radius * out + np.array([0.0, 0.0, z]))
