"""Optimizers side by side: the same measurements and the same cost, solved by many methods.

In: a dataset, a stored run or generated measurements. Out: a row for each solver and start (compare.json),
tables and a page.

    comparison        the flow of ``polhode compare``, which uses stored rows again
    page              compare.html
    tables            performance profiles, the tables at the terminal, compare.csv
    solver_process    each solver in a process of its own
    solver            the solvers by name, their protocol, and the record of their progress
    rows              compare.json: the record of the results, and its schema
    solvers/          the adapters
    problem/          the frozen problem, its sources, and the assessment of a point
"""
