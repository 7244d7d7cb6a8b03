"""Target bodies: shape, surface and mass in the geometric frame G. In: ``scene.body``. Out: a ``Body``.

build.py      the body that a scene describes
families/     spacecraft and a rock, one family a file
mesh_file.py  bodies from mesh files
equipment.py  equipment that families share, and its places on walls
textures/     texture generators, and how charts are laid onto parts
part.py       parts, their mass, and the body that they are assembled to
solids.py     boxes, solids of revolution, bars; plane and smooth regions of a mesh
"""

from polhode.simulation.bodies.build import build_body, texture_seed
from polhode.simulation.bodies.part import Body, PartMass, describe

__all__ = ["Body", "PartMass", "build_body", "describe", "texture_seed"]
