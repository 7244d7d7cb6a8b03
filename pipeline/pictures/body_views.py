"""The directions that map and mesh are drawn from: along the principal axes, or those of G."""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.records import MassProperties


@dataclass(frozen=True)
class BodyFrame:
    """The frame A that is drawn, at the centre of mass."""

    name: str
    """P or G: whose axes these are"""
    words: str
    """the same in a sentence"""
    R_GA: Array
    """(3, 3)"""
    com_G: Array
    """(3,) [m]"""

    def points(self, p_G: Array) -> Array:
        """p_A (n, 3) of points in G [m]."""
        return np.asarray((p_G - self.com_G) @ self.R_GA)


@dataclass(frozen=True)
class Direction:
    """Where the eye stands, and what is to its right and above; axes of A."""

    name: str
    right: Array
    up: Array

    @property
    def eye(self) -> Array:
        """(3,) from the body to the eye."""
        return np.cross(self.right, self.up)


def body_frame(mass: MassProperties) -> BodyFrame:
    """P where the motion determines it, else the axes of G, always at the centre of mass."""
    known = mass.identifiable
    place = "centre of mass" if known.com else "centre of mass, which is not fully determined"
    if known.axes:
        return BodyFrame("P", f"Principal axes x, y, z at the {place}.", mass.R_GP, mass.com_G)
    words = f"Axes of G at the {place}: the motion does not determine the principal axes."
    return BodyFrame("G", words, np.eye(3), mass.com_G)


def _direction(name: str, right: tuple[float, ...], up: tuple[float, ...]) -> Direction:
    x, y = (np.array(each) / np.linalg.norm(each) for each in (right, up))
    return Direction(name, x, y)


ALONG_AXES: tuple[Direction, ...] = (
    _direction("+x", (0, 1, 0), (0, 0, 1)),
    _direction("+y", (-1, 0, 0), (0, 0, 1)),
    _direction("+z", (1, 0, 0), (0, 1, 0)),
    _direction("\u2212x", (0, -1, 0), (0, 0, 1)),
    _direction("\u2212y", (1, 0, 0), (0, 0, 1)),
    _direction("\u2212z", (-1, 0, 0), (0, 1, 0)),
)
"""From the six sides; the first three face the last three."""
OBLIQUE: tuple[Direction, ...] = (
    _direction("+x +y +z", (-1, 1, 0), (-1, -1, 2)),
    _direction("\u2212x \u2212y \u2212z", (1, -1, 0), (-1, -1, 2)),
)
"""From two opposite corners, between the axes."""


def round_length_mm(size_mm: float) -> float:
    """A length for a scale bar: 1, 2 or 5 times a power of ten, at most a third of the size."""
    power = 10.0 ** np.floor(np.log10(size_mm / 3.0))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= size_mm / 3.0))
