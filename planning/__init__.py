"""What a run is good for: prediction of the motion, safe approach, pose from edges, files for other programs.

In: the last state with its covariance and the surface of a run. Out: predicted states, keep-out volumes,
approach corridors, observability of the pose from edges, export files.

    prediction/   the tumble ahead, with its covariance or as an ensemble
    keep_out/     the volume where nothing may be over the predicted tumble
    approach/     rates, corridor, surface speed and a trajectory around the volume
    edges/        how well the edges in an image determine the pose
    exports/      GLB, PLY, STL, OBJ, URDF, MJCF, SDF, CCSDS messages, TUM, JSON
"""
