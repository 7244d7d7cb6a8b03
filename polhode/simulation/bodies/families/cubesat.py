"""A cubesat of one to six units: rails, body-mounted cells, a lens, antennas of tape, folding wings."""

from functools import partial

import numpy as np

from polhode.geometry.lie import Array, hat, make_pose
from polhode.simulation.bodies import equipment
from polhode.simulation.bodies.equipment import Catalogue, Deck, decks_of_box
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import box, drum, pose, tube
from polhode.simulation.bodies.textures.canvas import Draw
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat

FORMS = ((1, 1, 1.0), (1, 1, 1.5), (1, 1, 2.0), (1, 1, 3.0), (1, 1, 3.0), (2, 1, 3.0))
"""Units across x and y, and along z: 1U, 1.5U, 2U, 3U, 6U."""
UP, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])


def cubesat_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a cubesat size_m [m] long (z), without antennas and wings; G in the middle of the box.

    The functions below take the length of a unit u [m] and the outer size (3,) over the rails [m].
    """
    rng, textures = builder.rng, builder.textures
    across, deep, along = FORMS[int(rng.integers(len(FORMS)))]
    u = size_m / along
    size = u * np.array([across, deep, along])
    # The box between the rails: cells on most sides, boards and plates on the others.
    cell = max(8, round(0.72 * u / builder.texel_m))
    cells = textures.cells(cell if rng.random() < 0.6 else cell // 2)
    sheets: list[Draw] = [cells, cells, cells, textures.panel(float(rng.choice([0.06, 0.3, 0.6])), 1.2)]
    order = rng.permutation(4)
    end = textures.machined_plate() if rng.random() < 0.5 else textures.panel(0.12, 1.3)
    core, sides = box(size - 0.05 * u, bevel=0.01), [*(sheets[k] for k in order), end, end]
    parts = [builder.flat_part(core, mat.SOLAR_CELL, sides, "core", down_G=DOWN), *_rails(u, size)]
    decks = decks_of_box(size - 0.05 * u, np.zeros(3))
    parts += _ends(u, size, decks, builder) + _tapes(u, size, builder) + _wings(u, size, builder)
    catalogue: Catalogue = [
        (partial(equipment.umbilical, builder, 0.26 * u), 0.2 * u),
        (partial(equipment.sun_sensor, 0.1 * u), 0.08 * u),
        (partial(equipment.patch, builder, 0.3 * u), 0.22 * u),
        (partial(equipment.camera_lens, 0.2 * u), 0.14 * u),
    ]
    for name in ("+x", "-x", "+y", "-y"):
        for _ in range(int(rng.integers(0, 3))):
            parts += decks[name].place(*catalogue[int(rng.integers(4))], rng)
    return parts


def _rails(u: float, size: Array) -> list[Part]:
    """Four square rails with feet, and frames around both ends."""
    sx, sy, sz = size
    wide = 0.085 * u
    rail = [wide, wide, sz + 0.13 * u]
    along_x, along_y = [sx - 1.4 * wide, 0.8 * wide, 0.6 * wide], [0.8 * wide, sy - 1.4 * wide, 0.62 * wide]
    bars = [(rail, [x * 0.5 * (sx - wide), y * 0.5 * (sy - wide), 0]) for x in (-1, 1) for y in (-1, 1)]
    for z in (-1, 1):
        bars += [(along_x, [0, y * 0.5 * (sy - 0.9 * wide), z * 0.5 * (sz - 0.7 * wide)]) for y in (-1, 1)]
        bars += [(along_y, [x * 0.5 * (sx - 0.94 * wide), 0, z * 0.5 * (sz - 0.72 * wide)]) for x in (-1, 1)]
    return named("rail", *((box(extents, bevel=0.1, at=at), mat.ANODISED) for extents, at in bars))


def _ends(u: float, size: Array, decks: dict[str, Deck], builder: PartBuilder) -> list[Part]:
    """A lens or an antenna at one end, thruster and plungers at the other."""
    rng = builder.rng
    top, bottom = decks["+z"], decks["-z"]
    x = 0.0 if size[0] < 1.5 * u else -0.5 * u
    kind = rng.integers(3)
    top.reserve(x, 0, (0.36, 0.4, 0.3)[kind] * u)
    if kind == 0:
        parts = top.put(equipment.camera_lens(0.5 * u), x, 0)
    elif kind == 1:
        parts = top.put(equipment.patch(builder, 0.6 * u), x, 0)
    else:
        parts = top.put(equipment.camera_lens(0.34 * u), x + 0.14 * u, 0.1 * u)
        parts += top.put(equipment.sun_sensor(0.16 * u), x - 0.24 * u, -0.2 * u)
    thruster = rng.random() < 0.5
    parts += bottom.put(equipment.thruster(0.3 * u) if thruster else equipment.patch(builder, 0.5 * u), 0, 0)
    bottom.reserve(0, 0, (0.2 if thruster else 0.36) * u)
    for deck in (top, bottom):
        parts += deck.place(partial(equipment.star_tracker, builder, 0.32 * u), 0.24 * u, rng)
        parts += deck.place(partial(equipment.sun_sensor, 0.13 * u), 0.09 * u, rng)
        boxed = partial(equipment.electronics_box, builder, 0.26 * u, 0.18 * u, 0.07 * u)
        parts += deck.place(boxed, 0.18 * u, rng)
    plunger = named("plunger", (drum(0.02 * u, 0.12 * u, 10), mat.BRUSHED_METAL))
    corner = 0.5 * (size - 0.085 * u)
    for sign in (-1.0, 1.0):
        at = [sign * corner[0], sign * corner[1], -0.5 * size[2] - 0.04 * u]
        parts += moved(plunger, pose([0, 0, -1.0], at))
    return parts


def _tapes(u: float, size: Array, builder: PartBuilder) -> list[Part]:
    """Two or four tape antennas that bend slightly, near one end."""
    rng = builder.rng
    z = 0.5 * size[2] - 0.12 * u
    length = u * float(rng.uniform(1.4, 2.2))
    directions = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    count = int(rng.choice([2, 4, 4]))
    droop = float(rng.uniform(-0.25, 0.25))
    parts = []
    for out in directions[:count] if rng.random() < 0.5 else directions[4 - count :]:
        start = 0.48 * float(np.abs(out) @ size) * out + [0, 0, z]
        t = np.linspace(0, 1, 7)[:, None]
        path = start + length * t * out + UP * (droop * length * t**2)
        wide = np.cross(out, UP)
        tape = tube(path, 0.012 * u, 6)
        # A tape is flat: its round section is widened along one direction.
        offset = (np.asarray(tape.vertices) - start) @ wide
        tape.vertices = np.asarray(tape.vertices) + 1.2 * offset[:, None] * wide
        foot = box([0.1 * u, 0.1 * u, 0.1 * u], bevel=0.15, at=start + 0.01 * u * out)
        parts += named("antenna", (tape, mat.BRUSHED_METAL), (foot, mat.PAINT_BLACK))
    return parts


def _wings(u: float, size: Array, builder: PartBuilder) -> list[Part]:
    """None, two or four panels that fold out at one end, cells on one side."""
    rng = builder.rng
    count = int(rng.choice([0, 2, 2, 4]))
    if count == 0:
        return []
    opened = float(rng.choice([np.pi / 2, np.pi / 2, 2.2]))
    cell = max(8, round(0.72 * u / builder.texel_m))
    cells, back = builder.textures.cells(cell), builder.textures.panel(float(rng.choice([0.08, 0.2])), 0.8)
    parts = []
    for side in np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])[:count]:
        wide = np.cross(UP, side)
        width, length = 0.83 * float(np.abs(wide) @ size), 0.96 * size[2]
        if abs(side[1]) > 0:
            length = min(length, 2.0 * u)
        board = box([width, 0.022 * u, length], bevel=0.2)
        sheets = [None, None, cells, back, None, None]
        sheet = builder.flat_part(board, mat.COMPOSITE, sheets, "wing", 0.6, DOWN)
        # The hinge lies at the lower end of the box; folded, the board stands along +z, its cells outward.
        fold = make_pose(np.column_stack([wide, -side, UP]), 0.5 * length * UP)
        c, s = np.cos(opened), np.sin(opened)
        turn = np.outer(wide, wide) * (1 - c) + c * np.eye(3) + s * hat(wide)
        root = (0.5 * float(np.abs(side) @ size) + 0.05 * u) * side - [0, 0, 0.5 * size[2]]
        parts.append(sheet.moved(make_pose(turn, root) @ fold))
        for end in (-0.36, 0.36):
            hinge = named("hinge", (drum(0.035 * u, 0.16 * u, 12), mat.PAINT_GREY))
            at = root + end * width * wide - 0.03 * u * side
            parts += moved(hinge, pose(wide, at - 0.08 * u * wide))
    return parts
