"""Edges of a known body: what is expected of a tracker, and what it finds on rendered images.

In: bodies, poses, Suns. Out: tables. README.md beside this file has what they gave.

    expected_errors       errors of tracked poses against those that were expected before there was an image
    planned_approaches    approaches from which the pose is best observable, against straight ones
    observable_paths      the program that plans them
    view_table            its smooth table of the metric
    observability_of_run  the metric from a run's mesh against that from the true mesh
    observability_speed   milliseconds a view
    trials, views         bodies, images, poses and starts
"""
