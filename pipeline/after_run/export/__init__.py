"""``polhode export``: a run in the formats of other programs.

In: a run directory and the options. Out: mesh, robot description, ephemeris or JSON; what the run lacks is
left out with a warning.

- export_run: one writer for each format
- options: the options, checked
- job: what the run has, in the frame of the file, and what is left out
- placement: the frame of the file, also that of a CAD model
- inertial: mass and inertia, and where each number comes from
- robot_files: URDF, MJCF and SDF with their meshes
"""
