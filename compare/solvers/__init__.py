"""The adapters: each solves the frozen problem by one library or one formulation.

In: the problem, a start and a clock. Out: where the solver stopped, in the common unknowns.

    ours                  Gauss-Newton of the back end
    ipopt                 IPOPT as the back end calls it, and in other formulations
    condensed             IPOPT on states and constants, landmarks eliminated at every point
    sqp                   CasADi's SQP method
    casadi_program        the common cost as a CasADi program in several formulations
    scipy_least_squares   SciPy's trust region
    ceres                 Ceres
    gtsam_solvers         GTSAM: Levenberg-Marquardt and iSAM2
    belief_propagation    Gaussian belief propagation
    odometry              motion without dynamics, then the inertia
    dynamic_isam          the incremental method of the thesis
    ablations             other inertias, noises and landmarks
    changed_unknowns      the same cost over other unknowns
    changed_inertia       other parameters of the inertia
    aghili_dynamics       dynamics with Aghili's parameters
    sliding_window        the sliding window of the back end
"""
