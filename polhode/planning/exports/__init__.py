"""Writers of the formats of other programs.

In: records of a run in the frame F that the user chose. Out: bytes or text of a file.

    formats         names of the formats; where a new one begins
    export_run      the command: reads the run, writes the file; job, options: what it was asked for
    placement       the frame F: G, P, or that of a CAD model
    own_files       which files of an earlier export may be replaced
    json_document   the JSON document; export.schema.json is its schema
    records         shape, state, mass properties and frame that the files are written from
    cad_alignment   pose of the target in a CAD model
    convex_pieces   collision geometry: convex pieces that contain the surface
    robot_xml       URDF, MJCF, SDF
    mesh_files      PLY, STL, OBJ
    glb             binary glTF, at rest or tumbling
    ccsds           OEM, AEM and TUM
"""
