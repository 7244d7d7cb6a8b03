"""Places for equipment on a flat wall, none on top of another."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from polhode.lie import Array
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import frame, pose


@dataclass
class Deck:
    """A rectangular wall in the frame X_G (4, 4): origin in its middle, z outward."""

    X_G: Array
    width_m: float
    height_m: float
    _taken: list[tuple[float, float, float]] = field(default_factory=list)

    def reserve(self, x_m: float, y_m: float, radius_m: float) -> None:
        """Keep a disc free of other things."""
        self._taken.append((x_m, y_m, radius_m))

    def find(self, radius_m: float, rng: np.random.Generator, tries: int = 24) -> tuple[float, float] | None:
        """A place (x, y) for a thing of a radius [m], or none; it is taken from then on."""
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
        """The parts at a place on the wall, turned about its normal [rad]."""
        X = self.X_G @ pose([0, 0, 1.0], [x_m, y_m, 0.0], turn)
        return [part.moved(X) for part in parts]

    def place(self, make: Callable[[], list[Part]], radius_m: float, rng: np.random.Generator) -> list[Part]:
        """What ``make`` gives, wherever there is room, turned by 0 to 270 degrees; else nothing."""
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
