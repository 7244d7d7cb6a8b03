"""What a run is good for: prediction of the motion, safe approach, pose from edges, files for other programs.

In: the last state with its covariance and the surface of a run. Out: predicted states, keep-out volumes,
approach corridors, observability of the pose from edges, export files.

- predict: the command's prediction; prediction: the predicted tumble, with its covariance or as an ensemble
- plan: the keep-out volumes and the approach of a run; plan_files writes them
- keep_out/: the volume that the target may occupy over the prediction
- approach/: rates, corridor, surface speed and a trajectory around the volume
- edges/: how well the edges in an image determine the pose
- observability/: the same for a run's mesh or a model, as a command
- exports/: GLB, PLY, STL, OBJ, URDF, MJCF, SDF, CCSDS messages, TUM, JSON
"""
