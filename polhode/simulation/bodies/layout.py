"""Equipment on flat walls: positions that do not overlap, and a fully equipped wall.

Electronics boxes are placed first, then smaller items wherever there is room.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from polhode.geometry.lie import Array
from polhode.simulation.bodies import equipment
from polhode.simulation.bodies.part import Part, moved
from polhode.simulation.bodies.solids import box, frame, pose
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import BRUSHED_METAL


@dataclass
class Deck:
    """A rectangular wall in the frame X_G (4, 4): origin at its centre, z outward."""

    X_G: Array
    width_m: float
    height_m: float
    _taken: list[tuple[float, float, float]] = field(default_factory=list)

    def reserve(self, x_m: float, y_m: float, radius_m: float) -> None:
        """Reserve a disc."""
        self._taken.append((x_m, y_m, radius_m))

    def find(self, radius_m: float, rng: np.random.Generator, tries: int = 24) -> tuple[float, float] | None:
        """A free position (x, y) for an item of a radius [m], now reserved; or None."""
        reach = 0.5 * np.array([self.width_m, self.height_m]) - radius_m
        if (reach <= 0).any():
            return None
        for _ in range(tries):
            x, y = rng.uniform(-reach, reach).tolist()
            if all(np.hypot(x - a, y - b) > radius_m + r for a, b, r in self._taken):
                self.reserve(x, y, radius_m)
                return x, y
        return None

    def put(self, parts: list[Part], x_m: float, y_m: float, turn: float = 0.0) -> list[Part]:
        """The parts at a position on the wall, rotated about its normal [rad]."""
        X = self.X_G @ pose([0, 0, 1.0], [x_m, y_m, 0.0], turn)
        return moved(parts, X)

    def place(self, make: Callable[[], list[Part]], radius_m: float, rng: np.random.Generator) -> list[Part]:
        """The parts of ``make`` at a free position, rotated by multiples of 90 degrees; none without room."""
        at = self.find(radius_m, rng)
        return [] if at is None else self.put(make(), *at, turn=float(rng.integers(4)) * np.pi / 2)


def decks_of_box(size_m: Array, centre_G: Array) -> dict[str, Deck]:
    """The six walls of a box by the names +x, -x, +y, -y, +z, -z."""
    decks = {}
    for axis in range(3):
        for sign in (1.0, -1.0):
            z = sign * np.eye(3)[axis]
            x = np.eye(3)[(axis + 1) % 3]
            X = frame(x, z, centre_G + 0.5 * size_m[axis] * z)
            name = ("+" if sign > 0 else "-") + "xyz"[axis]
            decks[name] = Deck(X, float(size_m[(axis + 1) % 3]), float(size_m[(axis + 2) % 3]))
    return decks


def fit_out(deck: Deck, size_m: float, builder: PartBuilder, boxes: int, small: int) -> list[Part]:
    """At most that many boxes and small items on a wall, sized relative to the body, size_m [m]."""
    rng, s = builder.rng, size_m
    parts = []
    for _ in range(boxes):
        w, d, h = s * rng.uniform((0.12, 0.12, 0.05), (0.26, 0.26, 0.1))
        boxed = partial(equipment.electronics_box, builder, w, d, h)
        parts += deck.place(boxed, 0.6 * float(np.hypot(w, d)), rng)
    for _ in range(small):
        make, radius = _small_thing(s, builder)
        parts += deck.place(make, radius, rng)
    for _ in range(2 * small):
        parts += deck.place(partial(_clamp, s), 0.03 * s, rng)
    return parts


def _small_thing(s: float, builder: PartBuilder) -> tuple[Callable[[], list[Part]], float]:
    """A function that makes a random small item, and the radius [m] that it needs."""
    catalogue: list[tuple[Callable[[], list[Part]], float]] = [
        (partial(equipment.star_tracker, builder, 0.17 * s), 0.12 * s),
        (partial(equipment.thruster_block, builder, 0.08 * s), 0.1 * s),
        (partial(equipment.sun_sensor, 0.05 * s), 0.04 * s),
        (partial(equipment.patch, builder, 0.11 * s), 0.08 * s),
        (partial(equipment.handrail, 0.2 * s, 0.006 * s), 0.12 * s),
        (partial(equipment.hexagonal_can, builder, 0.12 * s), 0.08 * s),
        (partial(equipment.umbilical, builder, 0.14 * s), 0.1 * s),
        (partial(equipment.helix, 0.16 * s, 0.03 * s), 0.06 * s),
        (partial(equipment.whip, 0.3 * s, 0.004 * s), 0.03 * s),
        (partial(equipment.grapple_pin, 0.12 * s), 0.08 * s),
    ]
    return catalogue[int(builder.rng.integers(len(catalogue)))]


def _clamp(s: float) -> list[Part]:
    """A tie point for cables."""
    return [Part(box([0.03 * s, 0.012 * s, 0.02 * s], bevel=0.2), BRUSHED_METAL, name="fitting")]
