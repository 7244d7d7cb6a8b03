"""Trajectories of a camera from which the pose of a tumbling target is best observable.

In: an edge model, a camera, the predicted tumble and limits; out: the trajectory of least expected error.

    trajectory_optimization   the optimal-control problem and its solution with IPOPT
    camera_path               a camera path's limits, and the metric along it
    view_table                the metric from all directions, smooth for the optimizer
"""
