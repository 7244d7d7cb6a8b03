"""A wall fitted out: electronics boxes first, then smaller things wherever there is room."""

from collections.abc import Callable
from functools import partial

import numpy as np

from polhode.simulation.bodies.components.antennas import helix, patch, whip
from polhode.simulation.bodies.components.deck import Deck
from polhode.simulation.bodies.components.equipment import (
    electronics_box,
    grapple_pin,
    handrail,
    hexagonal_can,
    star_tracker,
    sun_sensor,
    umbilical,
)
from polhode.simulation.bodies.components.propulsion import thruster_block
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import box
from polhode.simulation.bodies.textures.studio import Studio
from polhode.simulation.surface.materials import BRUSHED_METAL


def fit_out(deck: Deck, size_m: float, studio: Studio, boxes: int, small: int) -> list[Part]:
    """At most so many boxes and small things on a wall; size_m [m] is the body's, which sets theirs."""
    rng, s = studio.rng, size_m
    parts = []
    for _ in range(boxes):
        w, d, h = s * rng.uniform((0.12, 0.12, 0.05), (0.26, 0.26, 0.1))
        boxed = partial(electronics_box, studio, w, d, h)
        parts += deck.place(boxed, 0.6 * float(np.hypot(w, d)), rng)
    for _ in range(small):
        make, radius = _small_thing(s, studio)
        parts += deck.place(make, radius, rng)
    for _ in range(2 * small):
        parts += deck.place(partial(_clamp, s), 0.03 * s, rng)
    return parts


def _small_thing(s: float, studio: Studio) -> tuple[Callable[[], list[Part]], float]:
    """How to make one, and the radius [m] that it takes."""
    catalogue: list[tuple[Callable[[], list[Part]], float]] = [
        (partial(star_tracker, studio, 0.17 * s), 0.12 * s),
        (partial(thruster_block, studio, 0.08 * s), 0.1 * s),
        (partial(sun_sensor, 0.05 * s), 0.04 * s),
        (partial(patch, studio, 0.11 * s), 0.08 * s),
        (partial(handrail, 0.2 * s, 0.006 * s), 0.12 * s),
        (partial(hexagonal_can, studio, 0.12 * s), 0.08 * s),
        (partial(umbilical, studio, 0.14 * s), 0.1 * s),
        (partial(helix, 0.16 * s, 0.03 * s), 0.06 * s),
        (partial(whip, 0.3 * s, 0.004 * s), 0.03 * s),
        (partial(grapple_pin, 0.12 * s), 0.08 * s),
    ]
    return catalogue[int(studio.rng.integers(len(catalogue)))]


def _clamp(s: float) -> list[Part]:
    """A tie point for cables."""
    return [Part(box([0.03 * s, 0.012 * s, 0.02 * s], bevel=0.2), BRUSHED_METAL, name="fitting")]
