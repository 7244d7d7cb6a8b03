"""The observability metric.

In: control points of views. Out: information C and covariance C^-1 of the pose.

    edge_motion     image motion across the edges per degree of freedom
    observability_metric   C, C^-1 and the unobservable directions
    information     both along a trajectory, per view and per feature
    contributions   share of each feature in each degree of freedom
    pictures        values of edges as colours on the body
"""
