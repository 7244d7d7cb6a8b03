"""The adapters: each solves the frozen problem by one library or in one formulation.

In: the problem, a start and a monitor. Out: where the solver stopped, in the common unknowns.

    ours                  Gauss-Newton of the back end
    casadi_solvers        IPOPT as the back end calls it; CasADi's SQP method
    condensed             IPOPT on states and constants, landmarks eliminated at every point
    scipy_least_squares   SciPy's trust region
    ceres                 Ceres
    gtsam_solvers         GTSAM: Levenberg-Marquardt and iSAM2
    thesis_methods        the incremental method of the thesis; odometry, then the inertia
"""
