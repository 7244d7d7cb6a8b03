"""The adapters: each solves the frozen problem by one library or in one formulation.

In: the problem, a start and a monitor. Out: where the solver stopped, in the common unknowns.

    ours      Gauss-Newton of the back end; odometry, then the inertia
    ipopt     IPOPT as the back end calls it
    ceres     Ceres
    gtsam_lm  Levenberg-Marquardt of GTSAM
"""
