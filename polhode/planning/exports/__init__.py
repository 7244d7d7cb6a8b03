"""Writers of the formats of other programs.

In: a run, in the frame F that the user chose. Out: bytes or text of a file.

    formats          names of the formats; where a new one begins
    export_run       the command: reads the run, writes the files; which of an earlier export may be replaced
    options          what was asked for, checked
    job              the run as far as it got, in F: shape, states, what is left out and why
    mass_properties  mass and inertia, their origin, and whether they fit the mesh
    json_document    the JSON document; export.schema.json is its schema
    convex_pieces    collision geometry: convex pieces that contain the surface
    robot_xml        URDF, MJCF, SDF
    mesh_files       PLY, STL, OBJ, binary glTF
    ccsds            OEM, AEM and TUM
"""
