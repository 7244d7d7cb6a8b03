"""The problem that all solvers get, and the functions that assess every result.

In: measurements and the configuration of the back end. Out: a frozen problem, its residuals, a point's cost.

    measured_problem   the frozen problem and its starts
    problem_file       the frozen problem as a file for the processes
    sources            measurements of a dataset, of a stored run, or generated
    blocks             residuals and Jacobians of the common cost, as blocks of a factor graph
    assessment         cost, convergence and errors of a point, by the common functions
"""
