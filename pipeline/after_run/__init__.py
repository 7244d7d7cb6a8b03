"""What follows from a finished run, one command each.

In: a run directory. Out: files for planners, simulators and other programs.

- predict: the target's motion after the last pair, with covariances
- plan: keep-out volume, surface speeds and docking corridor; plan_files writes them, with pictures
- keep_out_truth: whether the true body of a simulated sequence stays inside the keep-out volume
- export/: the run in the formats of other programs
- observability/: how well edges determine the pose along a camera trajectory
"""
