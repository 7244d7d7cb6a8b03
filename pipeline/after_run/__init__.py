"""What follows from a finished run, one command each.

In: a run directory. Out: files for planners, simulators and other programs.

- predict: the target's motion after the last pair, with covariances
- plan: keep-out volume, surface speeds and docking corridor; plan_files and plan_pictures write them
- export/: the run in the formats of other programs
- observability/: how well edges determine the pose along a camera trajectory
- mesh_input: reads a mesh file that the user names
"""
