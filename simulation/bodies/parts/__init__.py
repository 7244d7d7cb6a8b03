"""What bodies are made of. In: dimensions. Out: closed meshes with a material, charts and mass.

part.py          parts, charts, and the body that they are assembled to
solids.py        boxes, solids of revolution, bars
facets.py        plane and smooth regions of a mesh
mass.py          mass properties of closed and open meshes
file_colours.py  colours of a mesh file at a point
"""
