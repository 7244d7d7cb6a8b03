"""Observability of a pose from the edges of a known body: the accuracy that an edge tracker can reach.

In: a mesh, a camera, poses. Out: information and covariance of the pose, per view and per edge.

    model/       the edges of a mesh, and which of them a camera sees
    metric/      information that the visible edges give about the pose
    selection/   which edges to use when their number is limited
"""
