"""The flow of ``polhode compare``: measurements, frozen problems, a row for each solver and start, the page.

Each row is written to a file of DIR/rows as soon as it is known: an interrupted comparison can be resumed.
"""

import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from hashlib import sha256
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

from polhode.compare.page import write_page
from polhode.compare.problem.assessment import assess, reference_covariance, sigmas
from polhode.compare.problem.blocks import compile_block
from polhode.compare.problem.fingerprint import BASE, code_of, machine, of_problem, versions
from polhode.compare.problem.measured_problem import MeasuredProblem
from polhode.compare.problem.problem_file import SUFFIX, read_problem, write_problem
from polhode.compare.problem.sources import Source, sources
from polhode.compare.ranking import performance_profiles
from polhode.compare.registry import Entry, entries
from polhode.compare.rows import Case, Comparison, ProblemSummary, Row, StartKind, write_comparison
from polhode.compare.solver_process import empty_row, row_of
from polhode.compare.tables import csv_text, start_text
from polhode.config import Config
from polhode.files.atomic import write_text
from polhode.files.foreign_files import MIB, read_text
from polhode.files.output.locks import occupied
from polhode.files.output.marked_folder import claim as mark
from polhode.files.output.marked_folder import marked_place, withdrawn_if_refused
from polhode.files.output.place import folder_place, unwritable
from polhode.files.output.single_file import remove_all_partials
from polhode.run_directory.outputs import write_config
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.progress import NOTE, Progress

FILE = "compare.json"
COMMAND = "compare"
FILES = ("config.yaml", FILE, "compare.csv", "compare.html")
PARTS = ("rows", "problems")
MAX_ROW_BYTES = 16 * MIB
"""A row holds a trace of some thousand points at most."""

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
    with occupied(place, folder), withdrawn_if_refused(place, COMMAND, FILES, PARTS):
        return _compared(config, claim(folder), progress, chosen, wanted)


def _compared(
    config: Config, folder: Path, progress: Progress, chosen: tuple[Entry, ...], wanted: Sequence[Source]
) -> Comparison:
    for old in sorted((folder / "problems").glob("*.pickle")):
        # reading such a file may execute what is in it
        _log.warning("%s: a problem as earlier versions stored it, which is not read; delete it", old)
    # the first use on a machine compiles: that must not count as time of a solver
    with progress.stage("compiling the cost", 1) as advance:
        compile_block()
        advance()
    deadline = perf_counter() + config.compare.total_s
    problems: list[ProblemSummary] = []
    rows: list[Row] = []
    for source in wanted:
        # written each time, and never one that the folder held before
        file = folder / "problems" / f"{source.name}{SUFFIX}"
        try:
            with progress.stage(f"freezing {source.name}", 1) as advance:
                write_problem(source.problem(config, progress, folder / "problems" / source.name), file)
                advance()
        except RunFailure as failure:
            if source is wanted[-1] and not problems:
                raise
            _log.warning("%s is left out: %s", source.name, failure)
            continue
        problem = read_problem(file)
        key, cases, own = of_problem(problem), list(_cases(source.name, config, chosen)), []
        with progress.stage(f"solvers, {source.name}", len(cases)) as advance:
            for number, (entry, case) in enumerate(cases, 1):
                row = _row(file, key, folder, entry, case, config, deadline)
                found = "" if row.cost is None else f", cost {row.cost:.6g}"
                took = "" if row.wall_s is None else f", {row.wall_s:.1f} s"
                text = f"{row.problem}: {row.solver} ({start_text(row)} start): {row.status}{found}{took}"
                _log.log(NOTE, "%s, %d of %d", text, number, len(cases))
                own.append(row)
                advance()
        rows += own
        problems.append(_summary(source, problem, key, own))
        comparison = Comparison(
            limit_s=config.compare.limit_s,
            machine=machine(),
            versions=versions(),
            problems=problems,
            rows=rows,
        )
        comparison = comparison.model_copy(update={"profiles": performance_profiles(comparison)})
        write_config(folder, config)
        write_comparison(comparison, folder / FILE)
        write_text(folder / "compare.csv", csv_text(rows))
    write_page(comparison, folder / "compare.html")
    return comparison


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
    link = next((place / part for part in PARTS if (place / part).is_symlink()), None)
    if link is not None:
        raise InputError(f"{link}: this is a link, which a comparison does not write through; remove it")
    mark(place, COMMAND, FILES)
    for part in PARTS:
        try:
            (place / part).mkdir(exist_ok=True)
        except OSError as error:
            raise unwritable(place / part, error) from error
        for each in (place / part, *(place / part).iterdir()):
            remove_all_partials(each)
    return place


def _row(
    file: Path, key: str, folder: Path, entry: Entry, case: Case, config: Config, deadline: float
) -> Row:
    """The stored row, when all that determines it is the same; else a new one."""
    name = f"{case.problem}.{case.solver}.{case.start}{case.seed}.json"
    path, wanted = folder / "rows" / name, stamp(key, entry, config.compare.limit_s)
    known = _stored_row(path, wanted)
    if known is not None:
        return known
    left_s = deadline - perf_counter()
    if left_s <= 0.0:
        return empty_row(entry, case, "timeout", "not started: the time of the comparison was up")
    limit_s = min(config.compare.limit_s, left_s)
    row = row_of(file, entry, case, limit_s)
    if row.status == "timeout" and limit_s < config.compare.limit_s:
        # with the full limit it might have converged: measured again when the comparison resumes
        return row
    store_row(path, wanted, row)
    _log.info("%s: %s, %s", name, row.status, row.message)
    return row


def store_row(path: Path, wanted: Mapping[str, Any], row: Row) -> None:
    """Write a row with its stamp and a digest of both."""
    content = {"stamp": wanted, "row": row.model_dump(mode="json")}
    write_text(path, json.dumps({**content, "digest": _digest(content)}) + "\n")


def _digest(content: Mapping[str, Any]) -> str:
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _stored_row(path: Path, wanted: dict[str, Any]) -> Row | None:
    """The row in the file if its stamp is the one wanted and nothing in it was changed since; None for
    another, or for no row at all."""
    # a file of another version, or one that was damaged, is measured again
    with suppress(InputError, ValueError, KeyError, TypeError, RecursionError):
        known = json.loads(read_text(path, MAX_ROW_BYTES, "a row of a comparison"))
        if known["stamp"] == wanted and known["row"]["status"] != "missing":
            # Rows without a digest are of earlier versions: their stamps, which name the code, are others.
            if known.pop("digest", None) == _digest(known):
                return Row.model_validate(known["row"])
            _log.warning("%s: was changed since it was measured; it is measured again", path)
    return None


def stamp(problem: str, entry: Entry, limit_s: float) -> dict[str, Any]:
    """All that a stored row must share with a new one; ``problem`` is the fingerprint."""
    return {
        "fingerprint": problem,
        "limit_s": limit_s,
        "entry": asdict(entry),
        "versions": versions((*BASE, entry.needs) if entry.needs else BASE),
        "code": code_of(),
        "machine": machine(),
    }


def _summary(source: Source, problem: MeasuredProblem, key: str, rows: Sequence[Row]) -> ProblemSummary:
    reference = sigmas(problem, problem.solution, reference_covariance(problem, problem.solution))
    cost = assess(problem, problem.solution).cost
    known = [each for each in (cost, *(row.cost for row in rows)) if each is not None]
    return ProblemSummary(
        name=source.name,
        source=source.description,
        fingerprint=key,
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
