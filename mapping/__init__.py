"""Dense surface of the target from depth maps and their poses.

In: depth maps with standard deviations, poses X_RG with covariances. Out: a ``SurfaceModel``, the triangle
mesh in G [m] with colour, sigma, views and coverage per vertex.

    fusion/        depth maps into a signed distance field, and the mesh of its zero level
    finishing/     holes, albedo and lighter versions of the finished mesh
    visibility     what a camera sees of a mesh, and what the Sun lights
    mesh_viewer    depth images of a mesh with values of its vertices
    mesh_geometry  connected pieces, neighbours, moments: compiled loops over faces
    mesh_files     the mesh as PLY
    uniform_solid  the body that a mesh encloses, at uniform density
"""
