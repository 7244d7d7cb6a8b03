"""Target bodies: shape, surface and mass, in the geometric frame G."""

from polhode.simulation.bodies.build import build_body
from polhode.simulation.bodies.describe import describe
from polhode.simulation.bodies.parts.mass import PartMass
from polhode.simulation.bodies.parts.part import Body

__all__ = ["Body", "PartMass", "build_body", "describe"]
