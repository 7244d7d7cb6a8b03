"""The volume that the tumbling target may occupy, at a confidence.

In: the measured surface with its sigmas, the predicted motion with its covariance. Out: the swept volume over
a horizon, and the volume at each instant.

    volumes          both volumes, with the confidence that they hold
    measured_body    the surface grown by its own uncertainty, as a signed distance
    swept_distance   compiled loops: the distance field swept over time, and how far draws leave it
    nearest_points   nearest point of each cell of a grid
"""
