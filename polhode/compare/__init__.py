"""Optimizers side by side: the same measurements and the same cost, solved by many methods.

In: a dataset, a stored run or generated measurements. Out: a row for each solver and start (compare.json),
tables and a page.

    comparison        the flow of ``polhode compare``, which uses stored rows again
    page              compare.html
    tables            the tables at the terminal, compare.csv
    ranking           performance profiles, growth with size, Pareto front
    solver_process    each solver in a process of its own
    registry          the solvers by name
    solver            the protocol of the adapters, and the record of their progress
    rows              compare.json: the record of the results, and its schema
    solvers/          the adapters
    problem/          the frozen problem, its sources, and the assessment of a point
"""
