"""A box bus wrapped in foil and radiators, with solar wings, a dish, a nozzle and equipment on its walls."""

from functools import partial

import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.bodies.equipment import (
    Deck,
    decks_of_box,
    engine,
    fit_out,
    horn,
    small_dish,
    solar_wing,
    thruster,
)
from polhode.simulation.bodies.part import Part, moved
from polhode.simulation.bodies.solids import box, frame, pose, revolve
from polhode.simulation.bodies.textures.canvas import Draw
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import ANODISED, FOIL_BLACK, FOIL_GOLD, FOIL_SILVER


def bus_parts(size_m: float, builder: PartBuilder) -> list[Part]:
    """Parts of a bus size_m [m] long (x); wings along +-y; G near the middle of the box."""
    rng, textures = builder.rng, builder.textures
    box_m = size_m * np.array([1.0, rng.uniform(0.6, 0.9), rng.uniform(0.65, 1.0)])
    decks = decks_of_box(box_m, np.zeros(3))
    foil = [FOIL_GOLD, FOIL_GOLD, FOIL_SILVER, FOIL_BLACK][int(rng.integers(4))]
    # Foil, a radiator on one or two walls, bare structure on the others.
    sheets: list[Draw] = [
        textures.blanket(foil), textures.blanket(foil), textures.blanket(foil), textures.radiator(),
        textures.panel(float(rng.choice([0.3, 0.65])), 0.7), textures.machined_plate(),
    ]  # fmt: skip
    rng.shuffle(sheets)
    parts = [builder.flat_part(box(box_m, bevel=0.02), foil, sheets, "box", 1.5)]
    panels = int(rng.integers(1, 4))
    length, width = size_m * (0.45 + 0.42 * panels), size_m * rng.uniform(0.55, 0.8)
    tilt, cell = rng.uniform(-0.9, 0.9), int(rng.integers(34, 62))
    for side in (-1.0, 1.0) if rng.random() < 0.85 else (1.0,):
        wing = solar_wing(builder, length, width, 0.014 * size_m, panels, 0.22 * size_m, cell)
        root = [0.0, side * 0.5 * box_m[1], 0.0]
        parts += moved(wing, frame([0.0, side, 0.0], [np.sin(tilt), 0.0, np.cos(tilt)], root))
    parts += _aft(size_m, box_m, decks["-x"], builder)
    parts += _front(size_m, decks, builder)
    for name in ("+y", "-y"):
        # The wing's drive sits in the middle of this wall.
        decks[name].reserve(0.0, 0.0, 0.16 * size_m)
    for deck in decks.values():
        parts += fit_out(deck, size_m, builder, int(rng.integers(1, 3)), int(rng.integers(3, 7)))
    return parts


def _aft(size_m: float, box_m: Array, deck: Deck, builder: PartBuilder) -> list[Part]:
    """Launch adapter ring, main engine inside it, four thrusters in the corners."""
    radius = 0.36 * float(box_m[1:].min())
    ring = revolve([(0.9 * radius, -0.01 * size_m), (radius, -0.01 * size_m), (radius, 0.05 * size_m),
                    (1.06 * radius, 0.055 * size_m), (1.06 * radius, 0.075 * size_m),
                    (0.9 * radius, 0.075 * size_m)], 64, closed=True)  # fmt: skip
    wall = builder.textures.ring_wall(0.3)
    parts = deck.put([builder.revolved_part(ring, [(1, 2, wall)], ANODISED, "adapter")], 0, 0)
    deck.reserve(0, 0, 1.1 * radius)
    if builder.rng.random() < 0.8:
        raised = pose([0, 0, 1.0], [0, 0, 0.4 * radius])
        parts += deck.put(moved(engine(builder, 0.5 * radius, 0.9 * radius), raised), 0, 0)
    for x in (-0.42, 0.42):
        for y in (-0.42, 0.42):
            parts += deck.put(thruster(0.045 * size_m), x * deck.width_m, y * deck.height_m)
            deck.reserve(x * deck.width_m, y * deck.height_m, 0.04 * size_m)
    return parts


def _front(size_m: float, decks: dict[str, Deck], builder: PartBuilder) -> list[Part]:
    """The payload: a dish, a horn farm or a telescope's ring on one of the free walls."""
    rng = builder.rng
    deck = decks[str(rng.choice(["+x", "+z"]))]
    kind = rng.integers(3)
    if kind == 0:
        deck.reserve(0, 0, 0.3 * size_m)
        return deck.put(small_dish(builder, size_m * float(rng.uniform(0.45, 0.65))), 0, 0)
    if kind == 1:
        parts = []
        for _ in range(int(rng.integers(3, 7))):
            size = size_m * float(rng.uniform(0.1, 0.2))
            parts += deck.place(partial(horn, size), 0.45 * size, rng)
        return parts
    radius = 0.3 * size_m * float(rng.uniform(0.7, 1.0))
    height = size_m * float(rng.uniform(0.2, 0.45))
    tube = revolve([(0, -0.02 * size_m), (radius, -0.02 * size_m), (radius, height), (0.9 * radius, height),
                    (0.86 * radius, 0.1 * height), (0, 0.1 * height)], 64)  # fmt: skip
    deck.reserve(0, 0, 1.1 * radius)
    material = FOIL_BLACK if rng.random() < 0.5 else FOIL_GOLD
    wall = builder.textures.blanket(material) if rng.random() < 0.6 else builder.textures.ring_wall(0.1)
    return deck.put([builder.revolved_part(tube, [(1, 2, wall)], material, "telescope", 0.4)], 0, 0)
