"""The flow of ``polhode compare``: measurements, frozen problems, a row for each solver, the page."""

import logging
import platform
from collections.abc import Iterator, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from polhode.compare.page import write_page
from polhode.compare.problem.assessment import assess, reference_covariance, sigmas
from polhode.compare.problem.blocks import compile_block
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import write_problem
from polhode.compare.problem.sources import Source, sources
from polhode.compare.rows import Case, Comparison, ProblemSummary, Row, StartKind, write_comparison
from polhode.compare.solver import Entry, entries
from polhode.compare.solver_process import empty_row, row_of
from polhode.compare.tables import csv_text, performance_profiles, start_text
from polhode.config import Config
from polhode.files.atomic import write_text
from polhode.files.output.locks import occupied
from polhode.files.output.marked_folder import claim as mark
from polhode.files.output.marked_folder import marked_place, withdrawn_if_refused
from polhode.files.output.place import folder_place
from polhode.run_directory.outputs import write_config
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import NOTE, Progress

FILE = "compare.json"
COMMAND = "compare"
FILES = ("config.yaml", FILE, "compare.csv", "compare.html")
_log = logging.getLogger(__name__)


def compare(
    config: Config,
    folder: Path,
    progress: Progress,
    data: Path | None = None,
    run: Path | None = None,
    truth: Path | None = None,
) -> Comparison:
    """Fill ``folder`` with compare.json, compare.csv and compare.html. Raises InputError, RunFailure."""
    chosen = entries(config.compare.solvers)
    wanted = list(sources(config, data, run, truth))
    place = folder_place(folder)
    with occupied(place, folder), withdrawn_if_refused(place, COMMAND, FILES):
        return _compared(config, claim(folder), progress, chosen, wanted)


def _compared(
    config: Config, folder: Path, progress: Progress, chosen: tuple[Entry, ...], wanted: Sequence[Source]
) -> Comparison:
    # the first use on a machine compiles: that must not count as time of a solver
    with progress.stage("compiling the cost", 1) as advance:
        compile_block()
        advance()
    deadline = perf_counter() + config.compare.total_s
    problems: list[ProblemSummary] = []
    rows: list[Row] = []
    # an earlier comparison stands until this one is complete; without one, an interrupt leaves what there is
    is_first = not (folder / FILE).exists()
    for source in wanted:
        with TemporaryDirectory(prefix="polhode-compare-") as temporary:
            file = Path(temporary) / "problem.npz"
            try:
                with progress.stage(f"freezing {source.name}", 1) as advance:
                    problem = source.problem(config, progress)
                    write_problem(problem, file)
                    advance()
            except RunFailure as failure:
                if source is wanted[-1] and not problems:
                    raise
                _log.warning("%s is left out: %s", source.name, failure)
                continue
            cases, own = list(_cases(source.name, config, chosen)), []
            try:
                with progress.stage(f"solvers, {source.name}", len(cases)) as advance:
                    for number, (entry, case) in enumerate(cases, 1):
                        row = _row(file, entry, case, min(config.compare.limit_s, deadline - perf_counter()))
                        found = "" if row.cost is None else f", cost {row.cost:.6g}"
                        took = "" if row.wall_s is None else f", {row.wall_s:.1f} s"
                        text = f"{row.solver} ({start_text(row)} start): {row.status}{found}{took}"
                        _log.log(NOTE, "%s: %s, %d of %d", row.problem, text, number, len(cases))
                        own.append(row)
                        advance()
            finally:
                if own:
                    rows += own
                    problems.append(_summary(source, problem, own))
                    if is_first:
                        _written(folder, config, problems, rows)
    comparison = _written(folder, config, problems, rows)
    write_page(comparison, folder / "compare.html")
    return comparison


def _written(folder: Path, config: Config, problems: list[ProblemSummary], rows: list[Row]) -> Comparison:
    """What was measured up to now, with compare.json, compare.csv and the configuration in the folder."""
    comparison = Comparison(
        limit_s=config.compare.limit_s,
        machine=f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
        versions=_versions(),
        problems=problems,
        rows=rows,
    )
    comparison = comparison.model_copy(update={"profiles": performance_profiles(comparison)})
    write_config(folder, config)
    write_comparison(comparison, folder / FILE)
    write_text(folder / "compare.csv", csv_text(rows))
    return comparison


def _row(file: Path, entry: Entry, case: Case, limit_s: float) -> Row:
    if limit_s <= 0.0:
        return empty_row(entry, case, "timeout", "not started: the time of the comparison was up")
    return row_of(file, entry, case, limit_s)


def _versions() -> dict[str, str]:
    """Of the packages with solvers that are installed."""
    found = {}
    for name in ("casadi", "gtsam", "pyceres"):
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def _cases(problem: str, config: Config, chosen: tuple[Entry, ...]) -> Iterator[tuple[Entry, Case]]:
    wanted = config.compare
    counts: tuple[tuple[StartKind, int], ...] = (
        ("cold", int(wanted.cold)), ("perturbed", wanted.perturbed), ("near", wanted.near),
    )  # fmt: skip
    for entry, (start, count) in product(chosen, counts):
        for seed in range(count):
            yield entry, Case(problem=problem, solver=entry.name, start=start, seed=seed)


def claim(folder: Path) -> Path:
    """Make the folder and mark it as ours; where it is, links followed. Raises InputError: it holds other
    files, or cannot be written."""
    place = marked_place(folder, COMMAND, FILES.__contains__)
    mark(place, COMMAND, FILES)
    return place


def _summary(source: Source, problem: MeasuredProblem, rows: Sequence[Row]) -> ProblemSummary:
    reference = sigmas(problem, problem.solution, reference_covariance(problem, problem.solution))
    cost = assess(problem, problem.solution).cost
    known = [each for each in (cost, *(row.cost for row in rows)) if each is not None]
    return ProblemSummary(
        name=source.name,
        source=source.description,
        **problem.size,
        accel_psd=problem.data.accel_psd,
        torque_psd=problem.data.torque_psd,
        prepared_s=problem.prepared_s,
        truth=problem.truth is not None,
        reference_cost=cost,
        least_cost=min(known, default=None),
        sigma_k1=reference[0],
        sigma_k2=reference[1],
        sigma_com_mm=reference[2],
    )
