"""A navigation filter that weighs tracked poses by the observability metric, against others.

In: simulated flights, poses drawn from a model or tracked in images. Out: errors and consistency.

With all that the target's body is known:

    compare_filters      the comparison: tables and figure
    recorded_flights     filters on recorded poses: weights, tuning, errors
    flights              the target, the inspector and the first state of a run
    error_state_filter   the filter
    found_poses          poses from the linear model of a tracker, and from rendered images

With what an inspection of rendered pairs gives, its motion and its mesh:

    inspect_and_approach  the whole loop: tables of errors on arrival against what was promised
    inspections           rendered pairs and their run, kept
    approach_flights      plan, images, tracked poses
    arrivals              sizes of errors from other bodies; filters on recorded poses
    body_filter           the filter: motion, inertia, centre of mass and errors of the mesh
    edge_refinement       edges of the mesh, moved to where the images have them
    refined_edges         how far they are from the true ones, before and after
    mesh_errors           what errors of the edges do to a pose
"""
