"""Writers of the formats of other programs.

In: records of a run in the frame F that the user chose. Out: bytes or text of a file. The command, which
reads the run, is ``polhode/planning/export``.

    formats         names of the formats; where a new one begins
    records         shape, state, mass properties and frame that the files are written from
    cad_alignment   pose of the target in a CAD model
    convex_pieces   collision geometry: convex pieces that contain the surface
    robot_xml       URDF, MJCF, SDF
    mesh_files      PLY, STL, OBJ
    glb             binary glTF, at rest or tumbling
    ccsds           OEM, AEM and TUM
"""
