"""The volume that the tumbling target may occupy, at a confidence.

In: the measured surface with its sigmas, the predicted motion with its covariance. Out: the swept volume over
a horizon, and the volume at each instant.

    volumes          both volumes, and the confidence with which they contain the target
    measured_body    the surface grown by its own uncertainty, as a signed distance
    keep_out_truth   whether the true body left a volume, in simulation
    distance_fields  compiled loops: nearest points, the distance field swept over time, protrusions
    small_triangles  distances to the surface of a grid
"""
