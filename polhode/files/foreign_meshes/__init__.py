"""Meshes of others (PLY, STL, OBJ, GLB): the file's structure is checked, then trimesh reads it.

What a header states is compared with what the file holds, and other files are opened only where a mesh names
its colours, and only beside it. Nothing is fetched from a network.

mesh_file.py   opening a file, its limits, the call of trimesh, what every mesh must satisfy
ply.py         the header of a PLY against the size of the file
stl.py         solids of an STL
obj.py         lines of an OBJ; the files beside it
glb.py         chunks, views, accessors and nodes of a binary glTF
textures.py    images of materials, decoded once
unsound.py     the reason why a file is not read, and how large one may be
"""

from polhode.files.foreign_meshes.mesh_file import MeshFile, open_mesh
from polhode.files.foreign_meshes.unsound import OF_A_RUN

__all__ = ["OF_A_RUN", "MeshFile", "open_mesh"]
