"""Solvers of the back end: time, growth, agreement.

In: generated measurements or stored runs. Out: tables and figures.

    backend_size     time of each part of the back end, and how it grows
    compare          tables of ``polhode compare``
    runs_by_solver   both solvers on stored runs
    conditioning     condition numbers of the process covariance
    lie_rank         rank test of observability
    pose_graph       the pose graph of the cold start against GTSAM
"""
