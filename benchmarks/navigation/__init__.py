"""A navigation filter that weighs tracked poses by the observability metric, against others.

In: simulated flights, poses drawn from a model or tracked in images. Out: errors and consistency.

    compare_filters      the comparison: tables and figure
    recorded_flights     filters on recorded poses: weights, tuning, errors
    flights              the target, the inspector and the first state of a run
    error_state_filter   the filter
    found_poses          poses from the linear model of a tracker, and from rendered images
"""
