"""The back end on generated measurements with known errors: Monte Carlo.

In: scenes of the measurement generator. Out: errors against the Cramer-Rao bound, consistency, convergence.

    accuracy       errors against the bound, consistency of the covariances
    bound          the Cramer-Rao bound, and errors of an estimate
    convergence    random bodies and spins from a cold start
    robustness     outliers, gaps in the measurements, a moving inspector
    disturbances   known and unknown forces and torques
    same_answer    both solvers and both forms of the inertia
    rounding       whether rounding decides where a cold start ends
    window         the sliding window against full smoothing; its growth
"""
