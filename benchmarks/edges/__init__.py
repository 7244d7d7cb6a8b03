"""What the observability metric of edges predicts, against what an edge tracker does on rendered images.

In: bodies, rendered views. Out: correlations, calibrated covariances, chosen edges and trajectories.

    observability          the metric against the errors of the tracker
    observability_tables   its tables and figure
    observability_of_run   the metric from a run's mesh and from the true one
    observability_speed    seconds a view
    selection              sets of edges and their bounds
    best_trajectory        trajectories and sets of edges, tried on images
    visp_tracker           ViSP's edge tracker on the same images
    visp_settings          the settings that serve ViSP best
    planar                 the simplified problem of Eaton and Naasz
    planar_metric          its equations
    views                  rendered views of a body
    bodies                 solids and bodies of the simulator
    tracking/              the edge tracker
    trajectory/            trajectories of best observability
"""
