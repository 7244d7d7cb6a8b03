"""compare.json: a row for each solver, problem and start.

The pydantic models are the only definition; ``compare.schema.json`` beside this file is generated from them
(``python -m polhode.compare.rows``) and shipped, and every file is validated when it is written and read.
There is no NaN or infinity: what is unknown is null.
"""

import json
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from polhode.files.atomic import write_text
from polhode.files.foreign_files import MIB, MissingFile
from polhode.files.json_files import read_json
from polhode.run_directory.summary_schema import Finite, StrictModel
from polhode.runtime.errors import InputError

Status = Literal["ok", "baseline", "failed", "timeout", "missing"]
Kept = Literal["answer", "best", "last", "nothing"]
StartKind = Literal["cold", "perturbed", "near"]
SCHEMA_FILE = Path(__file__).with_name("compare.schema.json")


class EstimateErrors(StrictModel):
    """Estimate minus truth: root mean squares over the frames; attitude after the best constant rotation."""

    position_mm: Finite
    velocity_mm_s: Finite
    attitude_deg: Finite
    angular_velocity_deg_s: Finite
    com_mm: Finite
    k1: Finite
    k2: Finite


class Case(StrictModel):
    """Problem, solver and start of a row."""

    problem: str
    solver: str
    start: StartKind
    seed: int = Field(ge=0)

    @property
    def case(self) -> tuple[str, str, int]:
        """Problem, start, seed: the same for all solvers."""
        return self.problem, self.start, self.seed


class Row(Case):
    """Result of one solver for one problem from one start."""

    family: str
    claim: Literal["ok", "baseline"]
    status: Status
    message: str
    ran: bool
    """False: its package is missing, or the time of the comparison was up"""
    kept: Kept
    """The point to which cost, ratios and errors belong: the solver's result, or, of one that did not finish,
    the best point that it recorded, or the last one (of a method whose own cost is not the common one)"""
    cost: Finite | None
    """The common cost of the point that is kept"""
    gain_left: Finite | None
    """Decrease that one more Gauss-Newton step predicts there, over the cost"""
    iterations: int | None = Field(ge=0)
    wall_s: Finite | None
    """Building and solving, without the start of the process and the preparation of the problem"""
    memory_mb: Finite | None
    """Largest resident size of the process"""
    k1: Finite | None
    k2: Finite | None
    sigma_k1: Finite | None
    """By the solver's own linear algebra"""
    sigma_k2: Finite | None
    sigma_com_mm: Finite | None
    errors: EstimateErrors | None
    trace: list[tuple[Finite, Finite]]
    """Seconds since the start, cost, at each iteration"""


class ProblemSummary(StrictModel):
    """One frozen problem."""

    name: str
    source: str
    frames: int
    landmarks: int
    observations: int
    unknowns: int
    accel_psd: Finite
    torque_psd: Finite
    prepared_s: Finite
    truth: bool
    """Whether rows have errors against a truth"""
    reference_cost: Finite | None
    """The common cost of the reference solution: ours, from the back end's own estimate"""
    least_cost: Finite | None
    """The least cost known, of the rows and the reference solution; "solved" refers to it"""
    sigma_k1: Finite | None
    """Reference: by the whole Gauss-Newton Hessian of the common cost at the reference solution"""
    sigma_k2: Finite | None
    sigma_com_mm: Finite | None


class Tally(StrictModel):
    """Numbers of cases of one kind of start; a case is a problem with a start."""

    solved: int = Field(ge=0)
    """Convergence is claimed, at the least cost known"""
    ran: int = Field(ge=0)
    """Cases that the solver ran: the denominator"""
    not_run: int = Field(ge=0)
    """Its package was missing, or the time of the comparison was up: not counted elsewhere"""


class Profile(Tally):
    """Performance profile (Dolan and Moré 2002) of a solver that claims convergence."""

    solver: str
    starts: dict[StartKind, Tally]
    factors: list[Finite]
    """(solved,) ascending: time over that of the fastest solver of the same case"""


class Comparison(StrictModel):
    """The whole file."""

    schema_: Literal["polhode-compare/1"] = Field("polhode-compare/1", alias="schema")
    limit_s: Finite
    machine: str
    versions: dict[str, str]
    """Of the packages with solvers"""
    problems: list[ProblemSummary]
    rows: list[Row]
    profiles: list[Profile] = Field(default_factory=list)


def least_costs(comparison: Comparison) -> dict[str, float | None]:
    """By problem: the least cost of its rows and its reference solution."""
    return {problem.name: problem.least_cost for problem in comparison.problems}


def gap(row: Row, least: float | None) -> float | None:
    """Cost over the least one of its problem, minus 1; None where one of them is unknown."""
    if row.cost is None or least is None:
        return None
    return row.cost / least - 1.0


def write_comparison(comparison: Comparison, path: Path) -> None:
    """Validate, write atomically."""
    content = comparison.model_dump(mode="json", by_alias=True)
    Comparison.model_validate(content)
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def read_comparison(path: Path) -> Comparison:
    """Raises InputError, one line, when the file is missing or invalid."""
    try:
        return Comparison.model_validate(read_json(path, "a comparison", 32 * MIB))
    except MissingFile:
        raise InputError(f"{path}: no such file; make it with polhode compare") from None
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        where = ".".join(str(part)[:60] for part in first["loc"][:6])
        raise InputError(f"{path}: not a comparison: {where}: {first['msg'][:200]}") from None


def schema_text() -> str:
    """The JSON Schema that is shipped."""
    return json.dumps(Comparison.model_json_schema(by_alias=True), indent=1) + "\n"


if __name__ == "__main__":
    write_text(SCHEMA_FILE, schema_text())
