"""Optimizers side by side: the same measurements and the same cost, solved by many methods.

In: a dataset, a stored run or generated measurements. Out: a row for each solver and start (compare.json),
tables and a page.

    comparison        the flow of ``polhode compare``; a row on disk is not measured again
    registry          the solvers by name
    ranking           performance profiles, growth, Pareto front
    rows              compare.json: the record of the results, and its schema
    solver            what a solver is given and what it returns
    solver_progress   files that outlive the process of a solver
    problem/          the frozen problem, its sources, and the assessment of a point
    solvers/          one adapter a module
    processes/        each solver in a process of its own
    tables/           the tables at the terminal and the page
"""
