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
from polhode.simulation.bodies.textures.canvas import Draw
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat
from polhode.simulation.surface.materials import Material

SECTIONS = 72
UP = np.array([0.0, 0.0, 1.0])


def upper_stage_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a stage size_m [m] long from the nozzle's exit (-z) to the adapter's rim (+z)."""
    rng, textures = builder.rng, builder.textures
    radius = size_m * float(rng.uniform(0.13, 0.22))
    nozzle = size_m * float(rng.uniform(0.14, 0.24))
    adapter = size_m * float(rng.uniform(0.05, 0.1))
    throat = -0.5 * size_m + nozzle
    bottom = throat + 0.5 * nozzle + 0.35 * radius
    top = 0.5 * size_m - adapter
    two_tanks = bool(rng.random() < 0.4)
    middle = bottom + (top - bottom) * float(rng.uniform(0.3, 0.42)) if two_tanks else bottom
    lower_radius = radius * (float(rng.uniform(0.62, 0.8)) if two_tanks else 1.0)
    # The main tank, with raised rings at the welds of the domes.
    look, length = rng.random(), top - middle
    if look < 0.62:
        material, wall = mat.PAINT_WHITE, textures.tank_wall(float(rng.choice([0.78, 0.78, 0.5, 0.3])))
    elif look < 0.8:
        material, wall = mat.BRUSHED_METAL, textures.tank_wall(0.12)
    else:
        material = mat.FOIL_GOLD if rng.random() < 0.6 else mat.FOIL_SILVER
        wall = textures.blanket(material)
    parts = _tank(builder, radius, middle, top, material, wall, 0.36)
    for z in (middle + 0.03 * length, top - 0.03 * length):
        weld = ring(0.97 * radius, 1.015 * radius, z - 0.012 * length, z + 0.012 * length, SECTIONS)
        parts += named("ring", (weld.mesh, mat.BRUSHED_METAL))
    if two_tanks:
        parts += _second_tank(builder, lower_radius, radius, bottom, middle)
    else:
        # A ring below the tank, open at its lower end, with stringers outside.
        skirt = ring(0.94 * radius, 1.005 * radius, bottom - 0.32 * radius, bottom + 0.06 * radius, SECTIONS)
        wall = textures.ring_wall(float(rng.choice([0.08, 0.3, 0.6])))
        parts.append(builder.revolved_part(skirt, [(1, 2, wall)], mat.PAINT_GREY, "skirt"))
    parts += _thrust_section(builder, lower_radius, nozzle, throat, bottom)
    parts += _front(builder, radius, top, adapter)
    return parts + _sides(builder, radius, middle, top)


def _tank(
    builder: PartBuilder,
    radius: float,
    bottom: float,
    top: float,
    material: Material,
    wall: Draw,
    dome: float,
) -> list[Part]:
    """A wall with one chart around it; at either end an elliptic dome with a manhole and radial seams, the
    upper one ``dome`` radii high."""
    solid = revolve([(0, bottom), (radius, bottom), (radius, top), (0, top)], SECTIONS)
    parts = [builder.revolved_part(solid, [(1, 2, wall)], material, "tank")]
    covers = (mat.FOIL_GOLD, mat.FOIL_SILVER, mat.FOIL_BLACK, mat.PAINT_GREY, mat.BRUSHED_METAL)
    for z, height in ((bottom, -0.4 * radius), (top, dome * radius)):
        cap = ellipsoid_cap(0.985 * radius, abs(height))[::-1]
        shell = revolve(np.vstack([[(0, -0.1 * radius)], [(0.985 * radius, -0.1 * radius)], cap]), 48)
        r, h = 0.2 * radius, abs(height)
        manhole = revolve([(0, 0.9 * h), (r, 0.9 * h), (r, 1.03 * h), (0, 1.03 * h)], 28)
        cover = covers[int(builder.rng.integers(5))]
        both = named("dome", (shell.mesh, cover), (manhole.mesh, mat.ANODISED))
        parts += moved(both, pose([0, 0, np.sign(height)], [0, 0, z]))
    return parts


def _second_tank(
    builder: PartBuilder, radius: float, upper_radius: float, bottom: float, top: float
) -> list[Part]:
    """A smaller tank below the main one, hung in an open truss."""
    rng = builder.rng
    gap = 0.16 * (top - bottom) + 0.3 * upper_radius
    upper = top - gap
    foil = mat.FOIL_GOLD if rng.random() < 0.5 else mat.FOIL_SILVER
    wrapped, base = bool(rng.random() < 0.5), float(rng.choice([0.1, 0.6]))
    wall = builder.textures.blanket(foil) if wrapped else builder.textures.tank_wall(base)
    parts = _tank(builder, radius, bottom, upper, foil if wrapped else mat.PAINT_WHITE, wall, 0.4)
    count = int(rng.integers(8, 13))
    for k in range(count):
        for step in (-0.5, 0.5):
            a = 0.99 * radius * radial(2 * np.pi * k / count) + (upper - 0.04 * gap) * UP
            b = 0.96 * upper_radius * radial(2 * np.pi * (k + step) / count) + (top + 0.01 * gap) * UP
            parts += named("truss", (strut(a, b, 0.022 * radius), mat.COMPOSITE))
    return parts


def _thrust_section(
    builder: PartBuilder, radius: float, nozzle: float, throat: float, bottom: float
) -> list[Part]:
    """Engines, the struts that carry them, bottles and pipes around."""
    rng = builder.rng
    exit_m = nozzle * float(rng.uniform(0.34, 0.48))
    pair = bool(rng.random() < 0.25 and exit_m < 0.48 * radius)
    exit_m = exit_m if pair else min(exit_m, 0.95 * radius)
    parts: list[Part] = []
    for x in (0.52 * radius, -0.52 * radius) if pair else (0.0,):
        X = pose([0.0, 0.0, -1.0], [x, 0.0, throat], float(rng.uniform(0, 6)))
        parts += moved(equipment.engine(builder, exit_m, nozzle), X)
    frame = throat + 0.5 * nozzle
    plate = revolve([(0, frame - 0.02 * radius), (0.42 * radius, frame - 0.02 * radius),
                     (0.86 * radius, bottom + 0.02 * radius), (0, bottom + 0.02 * radius)], 40)  # fmt: skip
    parts += named("thrust_frame", (plate.mesh, mat.DARK_METAL))
    for k in range(10):
        out = radial(2 * np.pi * k / 10)
        a, b = 0.43 * radius * out + [0, 0, frame], 0.93 * radius * out + [0, 0, bottom]
        parts += named("thrust_frame", (strut(a, b, 0.02 * radius), mat.BRUSHED_METAL))
    count = int(rng.integers(2, 6))
    size = radius * float(rng.uniform(0.14, 0.2))
    for k in range(count):
        at = 0.74 * radius * radial(2 * np.pi * (k + 0.5) / count + 0.4) + (frame + 0.02 * radius) * UP
        parts += moved(equipment.bottle(size, rng), pose(UP, at))
        inwards, up = np.array([[1, 1, 1], [1, 1, 1], [0.7, 0.7, 1]]), np.array([0, 1.4, 1.6])
        pipe = at * inwards + size * np.outer(up, [0, 0, 1])
        parts += named("pipe", (tube(pipe, 0.07 * size, 8), mat.BRUSHED_METAL))
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
    material, wall = mat.COMPOSITE if base < 0.1 else mat.PAINT_GREY, builder.textures.ring_wall(base)
    parts = [builder.revolved_part(cone, [(0, 2, wall)], material, "adapter")]
    flange = ring(upper - 1.5 * wall_m, upper + 0.6 * wall_m, rim - 0.14 * adapter, rim, SECTIONS)
    parts += named("adapter", (flange.mesh, mat.BRUSHED_METAL))
    for k in range(int(rng.integers(3, 6))):
        angle = 2 * np.pi * k / 6 + rng.uniform(0, 0.4)
        boxed = equipment.electronics_box(builder, 0.22 * radius, 0.16 * radius, 0.1 * radius)
        parts += moved(boxed, pose(UP, 0.5 * radius * radial(angle) + (top + 0.2 * radius) * UP, angle))
    return parts


def _sides(builder: PartBuilder, radius: float, bottom: float, top: float) -> list[Part]:
    """Equipment along the wall: cable tunnels, a feed line, thruster blocks, hatches, antennas."""
    rng = builder.rng
    length = top - bottom

    def on_wall(angle: float, z: float) -> Array:
        """Frame on the tank: z outward, y along its axis."""
        out = radial(angle)
        return frame([-np.sin(angle), np.cos(angle), 0.0], out, radius * out + np.array([0.0, 0.0, z]))

    parts = []
    for angle in rng.uniform(0, 2 * np.pi) + np.array([0.0, np.pi])[: int(rng.integers(1, 3))]:
        # A long cover with slanted ends.
        wide, tall = 0.16 * radius, 0.09 * radius
        low, high = bottom + 0.06 * length, top - 0.02 * length
        half = 0.5 * (high - low)
        outline = [(-0.5 * wide, -half), (0.5 * wide, -half), (0.5 * wide, half), (-0.5 * wide, half)]
        cover = prism(outline, 1.6 * tall, taper=0.9, at=[0, 0, -0.6 * tall])
        base = float(rng.choice([0.08, 0.4, 0.75]))
        material = {0.08: mat.PAINT_BLACK, 0.4: mat.PAINT_GREY, 0.75: mat.PAINT_WHITE}[base]
        part = builder.flat_part(cover, material, builder.textures.panel(base, 0.4), "tunnel")
        parts.append(part.moved(on_wall(float(angle), 0.5 * (low + high))))
    if rng.random() < 0.6:
        out = radial(float(rng.uniform(0, 2 * np.pi)))
        z = np.linspace(bottom - 0.05 * length, top - 0.12 * length, 9)
        offset = np.r_[0.92, np.full(7, 1.035), 0.98]
        parts += equipment.cable(radius * offset[:, None] * out + z[:, None] * UP, 0.022 * radius)
    for angle in rng.uniform(0, 2 * np.pi) + np.arange(4) * np.pi / 2:
        block = equipment.thruster_block(builder, 0.16 * radius)
        parts += moved(block, on_wall(angle, bottom + 0.05 * length))
    for _ in range(5):
        angle = rng.uniform(0, 2 * np.pi)
        at = on_wall(angle, rng.uniform(bottom + 0.15 * length, top - 0.1 * length))
        kind = rng.integers(3)
        if kind == 0:
            parts += moved(equipment.patch(builder, 0.16 * radius), at)
        elif kind == 1:
            parts += moved(equipment.umbilical(builder, 0.24 * radius), at)
        else:
            boxed = equipment.electronics_box(builder, 0.3 * radius, 0.22 * radius, 0.08 * radius)
            parts += moved(boxed, at)
    return parts
