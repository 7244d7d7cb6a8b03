"""Edges of a known body: how accurately they determine its pose, and the tracker that finds it from them.

In: a mesh in G, a camera, poses; images for the tracker and for the refinement of a run's edges. Out:
information and covariance of the pose, per view and per edge; tracked poses; refined edges.

    orientation            faces of a mesh that agree, with normals outward; whether a point is inside
    edge_model             creases and rims as straight segments, smooth parts, occlusion by the body
    measured_edges         the edge model of a run's mesh, simplified as far as its errors allow
    edge_refinement        the same edges, moved to where the run's images have them
    visible_edges          control points on the edges that a camera sees; outlines, contrast in sunlight
    stripes                edges side by side in the image, and what it can tell of them
    stripe_profiles        how far the edges across a control point are displaced in a profile of grey levels
    image_profiles         profiles and edges of an image across control points
    tracking               the pose of a body from the edges of one image, with its covariance
    expected_tracking      what a tracker will find at a view, and how accurate its pose will be
    tracked_covariance     what the tracker does not know, added to its covariance
    observability_metric   image motion across the edges, C = sum of f f^T, C^-1, unobservable directions
    information            C along a trajectory, per view and per feature; contribution of each edge
    selection              the best edges under a budget, with an upper bound
    smallest_set           the smallest set that determines the pose nearly as well as all edges
"""
