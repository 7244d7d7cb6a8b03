"""Predictions of the observability metric of edges against an edge tracker on rendered images.

In: bodies, rendered views. Out: correlations, calibrated covariances, chosen edges and trajectories.

    observability             the metric against the errors of the tracker
    observability_tables      its tables and figure
    thin_parts                edges side by side: both trackers on the same images
    expected_errors           errors of the tracker of stripes against those that were expected
    lit_errors                what the Sun and the body's own surface do to the errors of the tracker
    planned_approaches        planned against straight approaches: errors on images
    observability_of_run      the metric from a run's mesh and from the true one
    observability_speed       seconds per view
    selection                 sets of edges and their bounds
    best_trajectory           trajectories and sets of edges, tried on images
    trajectory_optimization   the camera trajectory of best observability, by IPOPT
    view_table                the metric from all directions, smooth for the optimizer
    visp_tracker              ViSP's edge tracker on the same images
    planar                    the simplified problem of Eaton and Naasz
    views                     solids, bodies of the simulator and their rendered views
    tracking/                 the edge tracker
"""
