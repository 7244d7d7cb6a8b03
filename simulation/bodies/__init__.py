"""Target bodies: shape, surface and mass, in the geometric frame G."""

from simulation.bodies.build import build_body
from simulation.bodies.describe import describe
from simulation.bodies.mass import PartMass
from simulation.bodies.part import Body

__all__ = ["Body", "PartMass", "build_body", "describe"]
