"""The problem that all solvers are given, and the functions that assess every answer.

In: measurements and the configuration of the back end. Out: a frozen problem, its residuals, a point's cost.

    measured_problem   the frozen problem and its starts
    sources            a dataset, a stored run or generated measurements
    dataset            measurements of a dataset, by the front end
    blocks             residuals and Jacobians of the common cost, as blocks of a factor graph
    single_blocks      the same for one landmark or one step, for libraries that call Python for each
    assessment         cost, convergence and errors of a point, by the common functions
    fingerprint        digests of a problem, of our code and of the versions
"""
