"""Target bodies: shape, surface and mass in the geometric frame G. In: ``scene.body``. Out: a ``Body``.

build.py     the body that a scene describes
families/    spacecraft and a rock, one family a file
imported/    bodies from mesh files
components/  equipment that families share
textures/    texture generators and how charts are laid onto parts
parts/       solids, parts, their mass
"""

from polhode.simulation.bodies.build import build_body
from polhode.simulation.bodies.parts.mass import PartMass
from polhode.simulation.bodies.parts.part import Body, describe

__all__ = ["Body", "PartMass", "build_body", "describe"]
