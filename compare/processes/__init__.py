"""Each solver in a process of its own: one that crashes, hangs or is missing costs its row only.

In: the file of a problem, a solver, a start and a limit of time. Out: a row, whatever happens.

    isolation        starts the process, ends it at its limit, reads what it left
    solver_process   the process itself: solves, assesses, writes
"""
