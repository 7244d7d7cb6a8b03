"""Intervals of what the motion does not determine, from bounds that hold for every body.

In: the surface and the landmarks, and the estimate with its covariance. Out: ``Intervals`` of the summary.

- ``find_intervals``: the intervals of a run, and the sentences about them
- ``inertia_ratios``: k1 and k2 of the densities that the hull admits (a moment problem)
- ``hull_and_limits``: a convex body that contains the target; what the motion determines, as linear
  inequalities, and the centres of mass inside the hull that it admits
"""
