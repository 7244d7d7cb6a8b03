"""Meshes of others (PLY, STL, OBJ, GLB): the file's structure is checked, then trimesh reads it.

What a header states is compared with what the file holds, and other files are opened only where a mesh names
its colours, and only beside it. Nothing is fetched from a network.

- mesh_file: opening a file and the files beside it, the call of trimesh, what every mesh must satisfy
- structure: headers, lines and chunks of each format, and how large they may be
- textures: images of materials, decoded once
"""

from polhode.files.foreign_meshes.mesh_file import MeshFile, open_mesh
from polhode.files.foreign_meshes.structure import OF_A_RUN

__all__ = ["OF_A_RUN", "MeshFile", "open_mesh"]
