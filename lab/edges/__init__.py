"""Edges of a known body: what is expected of a tracker, and what it finds on rendered images.

In: bodies, poses, Suns. Out: tables. README.md beside this file has what they gave.

    expected_errors       errors of tracked poses against those that were expected before there was an image
    observability_of_run  the metric from a run's mesh against that from the true mesh
    trials, views         bodies, images, poses and starts
"""
