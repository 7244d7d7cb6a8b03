"""An edge tracker, with which the observability metric is tried on images.

In: an edge model, a camera and an image; out: the pose, its residuals and its calibrated covariance.

    tracker                 pose from the edges of one image
    stripe_tracker          the same where edges lie side by side: bevels, rims, thin panels
    stripe_fit              profiles of grey levels across control points
    edge_search             edges of the image along the normals of control points
    residual                whether the tracker converged to the right pose
    calibrated_covariance   covariance of the pose, with errors that whole edges share
"""
