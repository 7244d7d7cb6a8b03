"""Thrusters, nozzles, tanks and bottles. z points out of the wall, along the exhaust."""

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
    ring,
    strut,
    tube,
)
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import (
    BRUSHED_METAL,
    COMPOSITE,
    DARK_METAL,
    FOIL_BLACK,
    FOIL_GOLD,
    PAINT_BLACK,
)


def bell(
    throat_m: float, exit_m: float, length_m: float, wall_m: float, sections: int, steps: int = 9
) -> Revolved:
    """A nozzle from its throat at z = 0 to its exit, with a wall of real thickness and a closed throat.

    Radii and length [m]. The contour is a parabola that leaves the throat steeply (Rao's approximation).
    """
    t = np.linspace(0.0, 1.0, steps)
    radius = throat_m + (exit_m - throat_m) * (1.55 * t - 0.55 * t * t)
    outer = np.column_stack([radius + wall_m, length_m * t])
    inner = np.column_stack([radius, length_m * t])[::-1]
    neck = [
        (0.0, -0.3 * length_m),
        (throat_m + 1.5 * wall_m, -0.3 * length_m),
        (throat_m + wall_m, -0.08 * length_m),
    ]
    return revolve(np.vstack([neck, outer, inner, [(0.0, 0.0)]]), sections)


def thruster(size_m: float) -> list[Part]:
    """A small thruster: valve, chamber, bell; size_m is the diameter of the exit."""
    r = 0.5 * size_m
    nozzle = bell(0.3 * r, r, 2.2 * r, 0.12 * r, 20, 6).mesh
    nozzle.apply_translation([0, 0, 1.4 * r])
    valve = drum(0.75 * r, 1.1 * r, 14, bevel=0.15, at=[0, 0, -0.2 * r])
    return [Part(nozzle, DARK_METAL, name="thruster"), Part(valve, BRUSHED_METAL, name="thruster")]


def thruster_block(builder: PartBuilder, size_m: float) -> list[Part]:
    """A block with thrusters on its sides and one on top; size_m is the block's width."""
    block = box([size_m, size_m, 0.85 * size_m], bevel=0.12, at=[0, 0, 0.34 * size_m])
    parts = [
        builder.flat_part(
            block, PAINT_BLACK, builder.textures.panel(float(builder.rng.choice([0.1, 0.6])), 0.6), "thruster"
        )
    ]
    directions = [np.array([1.0, 0, 0.15]), np.array([-1.0, 0, 0.15]), np.array([0, 1.0, 0.15])]
    for direction in directions[: int(builder.rng.integers(2, 4))]:
        at = np.array([0, 0, 0.42 * size_m]) + 0.48 * size_m * direction
        parts += [part.moved(pose(direction, at)) for part in thruster(0.42 * size_m)]
    return parts


def engine(builder: PartBuilder, exit_m: float, length_m: float) -> list[Part]:
    """A main engine with the throat at z = 0: bell, chamber, pumps, feed lines, gimbal struts.

    exit_m is the radius of the exit, length_m the length of the bell; all ends at z = -length_m / 2.
    """
    rng = builder.rng
    throat = 0.2 * exit_m
    solid = bell(throat, exit_m, length_m, 0.022 * exit_m, 56, 11)
    # Points 3 .. 13 of the profile are the outer skin from the throat down to the exit.
    parts = [
        builder.revolved_part(solid, [(3, 13, builder.textures.nozzle_wall())], DARK_METAL, "nozzle", 2.0)
    ]
    t, ell = throat, length_m
    chamber = revolve([(0, -0.5 * ell), (1.3 * t, -0.5 * ell), (1.9 * t, -0.42 * ell), (1.9 * t, -0.22 * ell),
                       (1.1 * t, -0.04 * ell), (0, -0.04 * ell)], 32).mesh  # fmt: skip
    parts.append(Part(chamber, DARK_METAL, name="engine", density_factor=2.0))
    for angle in rng.uniform(0, 2 * np.pi) + np.array([0.0, 2.2, 4.0]):
        out = radial(angle)
        pump = drum(0.9 * throat, 0.3 * length_m, 20, bevel=0.25)
        pump.apply_transform(pose([0, 0, 1.0], 2.6 * throat * out + [0, 0, -0.48 * length_m]))
        parts.append(Part(pump, BRUSHED_METAL if rng.random() < 0.6 else PAINT_BLACK, name="engine"))
        line = np.array([2.6, 2.7, 2.0, 1.0])[:, None] * t * out
        line[:, 2] = np.array([-0.2, -0.1, 0.02, 0.06]) * ell
        parts.append(Part(tube(line, 0.22 * throat, 10), BRUSHED_METAL, name="engine"))
        foot = 4.2 * throat * out + [0, 0, -0.5 * length_m]
        parts.append(
            Part(
                strut(foot, 1.8 * throat * out + [0, 0, -0.25 * length_m], 0.16 * throat),
                BRUSHED_METAL,
                name="engine",
            )
        )
    rim = ring(1.12 * exit_m, 1.17 * exit_m, 0.0, 0.035 * exit_m, 56).mesh
    rim.apply_scale([0.885, 0.885, 1.0])
    rim.apply_translation([0, 0, length_m - 0.036 * exit_m])
    parts.append(Part(rim, BRUSHED_METAL, name="nozzle", density_factor=2.0))
    return parts


def bottle(radius_m: float, rng: np.random.Generator) -> list[Part]:
    """A pressure bottle around the origin with a band and two bosses."""
    material = [COMPOSITE, FOIL_GOLD, FOIL_BLACK, BRUSHED_METAL][int(rng.integers(4))]
    sphere = ball(radius_m, 28, 16)
    band = ring(0.99 * radius_m, 1.03 * radius_m, -0.08 * radius_m, 0.08 * radius_m, 28).mesh
    boss = drum(0.16 * radius_m, 2.2 * radius_m, 12, at=[0, 0, -1.1 * radius_m])
    return [
        Part(sphere, material, name="bottle"),
        Part(band, BRUSHED_METAL, name="bottle"),
        Part(boss, BRUSHED_METAL, name="bottle"),
    ]
