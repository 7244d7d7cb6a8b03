"""Edges of a known body: how accurately they determine its pose, and the tracker that finds it from them.

In: a mesh in G, a camera, poses; images for the tracker and for the refinement of a run's edges. Out:
information and covariance of the pose, per view and per edge; tracked poses; refined edges.

    orientation            faces of a mesh that agree, with normals outward; whether a point is inside
    edge_model             creases and rims as straight segments, smooth parts, occlusion by the body
    visible_edges          control points on the edges that a camera sees; outlines
    observability_metric   image motion across the edges, C = sum of f f^T, C^-1, unobservable directions
    information            C along a trajectory, per view and per edge; contribution and selection of edges
    stripes                edges side by side in the image, and what it can tell of them
    profiles               grey levels across control points, and how far edges are displaced in them
    measured_edges         edges of a run's mesh, also moved to where the run's images have them
    tracking               the pose of a body from the edges of one image, with its covariance
    expected_tracking      what a tracker will find at a view, and how accurate its pose will be
"""
