"""A navigation filter that weighs tracked poses by the observability metric, against others.

In: simulated flights, poses that are drawn from a model or tracked in images. Out: errors and consistency.

    compare_filters      the comparison: tables and figure
    recorded_flights     filters on recorded poses: tuning, errors
    flights              the target, the inspector and the first state of a run
    error_state_filter   the filter
    pose_weights         how a filter weighs a pose
    found_pose           a pose as records keep it
    drawn_poses          poses from the linear model of a tracker
    tracked_poses        poses that the tracker finds in rendered images
"""
