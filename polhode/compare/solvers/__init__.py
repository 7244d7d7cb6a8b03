"""The adapters: each solves the frozen problem by one library or in one formulation.

In: the problem, a start and a monitor. Out: where the solver stopped, in the common unknowns.

    ours                  Gauss-Newton of the back end
    casadi_solvers        IPOPT as the back end calls it and in other formulations; CasADi's SQP method
    casadi_program        the common cost as a CasADi program in several formulations
    condensed             IPOPT on states and constants, landmarks eliminated at every point
    scipy_least_squares   SciPy's trust region
    ceres                 Ceres
    gtsam_solvers         GTSAM: Levenberg-Marquardt and iSAM2
    belief_propagation    Gaussian belief propagation
    thesis_methods        the incremental method of the thesis; odometry, then the inertia
"""
