"""How many threads BLAS and OpenMP may start. To be called before NumPy, SciPy or torch is imported.

More than one thread each was 5-8 times slower on problems of this size, and workers are processes anyway.
"""

import os

VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


def limit_threads(count: int) -> None:
    """Let each library of this process, and of processes that it starts, use ``count`` threads."""
    for variable in VARIABLES:
        os.environ[variable] = str(count)


def processes(workers: int) -> int:
    """Parallel processes for ``runtime.workers``: 0 means one per core that this process may use."""
    return workers or len(os.sched_getaffinity(0))
