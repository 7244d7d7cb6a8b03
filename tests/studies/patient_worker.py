"""Dask's workers load this file first: a point waits, at no cost, until the test allows it.

The file ``allowed`` beside the folder of the study has the number of records that there may be.
"""

import time
from functools import wraps
from inspect import unwrap
from pathlib import Path

from polhode.studies import steps
from polhode.studies.store import POINTS, Record, Store

ALLOWED = "allowed"
LOOK_S = 0.02

# Dask loads the file twice
_compute_point = unwrap(steps.compute_point)


# by its name, as pickles refer to it, it is still a function of that module
@wraps(_compute_point)
def _waiting(job: steps.PointJob, sequence: steps.SequenceOutcome | None = None) -> Record:
    folder = Path(job.folder)
    with Store(folder).attempt():
        while sum(1 for _ in (folder / POINTS).glob("*/*.json")) >= int(
            (folder.parent / ALLOWED).read_text()
        ):
            time.sleep(LOOK_S)
    record: Record = _compute_point(job, sequence)
    return record


steps.compute_point = _waiting
