"""Dense surface of the target from depth maps and their poses.

In: depth maps with standard deviations, poses X_RG with covariances. Out: a ``SurfaceModel``, the triangle
mesh in G [m] with colour, sigma, views and coverage per vertex.

fusion/           depth maps into a signed distance field, and the mesh of its zero level
finishing/        holes, albedo and lighter versions of the finished mesh
visibility.py     what a camera sees of a mesh, and what the Sun lights; rendered views
mesh_geometry.py  connected pieces, neighbours, moments
mesh_files.py     the mesh as PLY and GLB
uniform_solid.py  the body that a mesh encloses, at uniform density
"""
