"""The frozen problem as a file for the solvers' processes: named arrays of numbers and texts, no code.

A name is the path of a field, such as ``fixed.steps.dt_s``; a field that is None is left out. The file lives
in a temporary folder while the comparison runs.
"""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.inertia import FORMS
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.level_prior import LevelPrior
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.problem.wrench import Impulses
from polhode.backend.solvers.linearization_point import LinearizationPoint
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.files.array_files import read_arrays
from polhode.records.truth import Truth

RECORDS: dict[str, type] = {
    "": MeasuredProblem, "data.": MotionData, "data.impulses.": Impulses,
    "data.level_prior.": LevelPrior, "fixed.": LinearizationPoint,
    "fixed.reference.": Iterate, "fixed.steps.": Steps, "truth.": Truth,
}  # fmt: skip
"""By the beginning of the names of their fields."""
PAIRS = ("data.camera_sigma", "data.bias_sigma", "data.node_sigma", "fixed.bias_sigma",
         "data.level_prior.stated", "data.level_decades")  # fmt: skip


def write_problem(problem: MeasuredProblem, path: Path) -> None:
    """Write the file, without a surface of the truth."""
    with path.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **dict(_named("", problem)))


def _named(prefix: str, record: Any) -> Iterator[tuple[str, Any]]:
    for each in fields(record):
        name, value = prefix + each.name, getattr(record, each.name)
        if is_dataclass(value) and f"{name}." in RECORDS:
            yield from _named(f"{name}.", value)
        elif name == "data.form":
            yield name, value.name
        elif value is not None and name != "truth.mesh":
            yield name, value


def read_problem(path: Path) -> MeasuredProblem:
    """Read a file of ``write_problem``."""
    arrays = read_arrays(path)

    def field_of(name: str) -> Any:
        if f"{name}." in RECORDS:
            return record(f"{name}.") if any(key.startswith(f"{name}.") for key in arrays) else None
        value = arrays.get(name)
        if value is None or value.ndim > 0:
            return tuple(value.tolist()) if value is not None and name in PAIRS else value
        return FORMS[value.item()] if name == "data.form" else value.item()

    def record(prefix: str) -> Any:
        kind: Any = RECORDS[prefix]
        return kind(**{each.name: field_of(prefix + each.name) for each in fields(kind)})

    found: MeasuredProblem = record("")
    return found
