"""Observability of a pose from the edges of a known body: what an edge tracker can find, and how well.

In: a mesh, a camera, poses. Out: information and covariance of the pose, per view and per edge.

    model/       the edges of a mesh, and which of them a camera sees
    metric/      information of the visible edges about the pose
    selection/   which edges to use when there is room for few
"""
