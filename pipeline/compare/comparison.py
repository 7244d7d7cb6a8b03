"""``polhode compare`` as the data flows: measurements, frozen problems, one row a solver and start, the page.

Every row is a file of DIR/rows as soon as it is known: an interrupted comparison goes on where it stopped.
"""

import json
import logging
import platform
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import perf_counter

from pipeline.compare.isolate import empty_row, row_of
from pipeline.compare.judge import reference_covariance, sigmas
from pipeline.compare.measured_problem import MeasuredProblem, fingerprint, load, save
from pipeline.compare.registry import Entry, entries
from pipeline.compare.rows import Case, Comparison, ProblemWords, Row, write_comparison
from pipeline.compare.sources import Source, sources
from pipeline.compare.table import csv_text
from polhode.atomic import write_text
from polhode.config import Config
from polhode.errors import InputError, RunFailure
from polhode.progress import Progress

FILE = "compare.json"
PACKAGES = {"casadi": "casadi", "scipy": "scipy", "gtsam": "gtsam", "pyceres": "pyceres"}
"""Module: distribution."""

_log = logging.getLogger(__name__)


def compare(
    config: Config, folder: Path, progress: Progress, data: Path | None = None, run: Path | None = None
) -> Comparison:
    """Fill ``folder`` with compare.json, compare.csv and compare.html. Raises InputError, RunFailure."""
    if data is not None and run is not None:
        raise InputError("give --data or --run, not both")
    chosen = entries(config.compare.solvers)
    wanted = list(sources(config, data, run))
    _claim(folder, config, wanted)
    deadline = perf_counter() + config.compare.total_s
    problems: list[ProblemWords] = []
    rows: list[Row] = []
    for source in wanted:
        try:
            file = _prepared(source, folder, config, progress)
        except RunFailure as failure:
            if source is wanted[-1] and not problems:
                raise
            _log.warning("%s is left out: %s", source.name, failure)
            continue
        problem = load(file)
        cases = list(_cases(source.name, config, chosen))
        own = []
        with progress.stage(f"solvers, {source.name}", len(cases)) as advance:
            for entry, case in cases:
                own.append(_row(file, fingerprint(problem), folder, entry, case, config, deadline))
                advance()
        rows += own
        problems.append(_words(source, problem))
        comparison = Comparison(
            limit_s=config.compare.limit_s,
            machine=f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}",
            versions=_versions(),
            problems=problems,
            rows=rows,
        )
        write_comparison(comparison, folder / FILE)
        write_text(folder / "compare.csv", csv_text(rows))
    from pipeline.compare.page import write_page

    write_page(comparison, folder / "compare.html")
    return comparison


def _cases(problem: str, config: Config, chosen: tuple[Entry, ...]) -> Iterator[tuple[Entry, Case]]:
    for entry in chosen:
        if config.compare.cold:
            yield entry, Case(problem=problem, solver=entry.name, start="cold", seed=0)
        for seed in range(config.compare.perturbed):
            yield entry, Case(problem=problem, solver=entry.name, start="perturbed", seed=seed)
        for seed in range(config.compare.near):
            yield entry, Case(problem=problem, solver=entry.name, start="near", seed=seed)


def _claim(folder: Path, config: Config, wanted: list[Source]) -> None:
    """Make the folder; refuse one that holds anything else."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: a file stands here; choose another folder for -o")
    ours = folder / "config.yaml"
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "rows").is_dir():
        raise InputError(f"{folder}: holds files that are not a comparison; choose another folder")
    for source in wanted:
        if source.folder is not None and not source.folder.is_dir():
            raise InputError(f"{source.folder}: no such folder")
    try:
        (folder / "rows").mkdir(parents=True, exist_ok=True)
        (folder / "problems").mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot write here ({error.strerror}); choose another -o") from error
    from pipeline.outputs import write_config

    del ours
    write_config(folder, config)


def _prepared(source: Source, folder: Path, config: Config, progress: Progress) -> Path:
    """The file of a frozen problem. Made once: what is measured next to it belongs to it."""
    file = folder / "problems" / f"{source.name}.pickle"
    with progress.stage(f"freezing {source.name}", 1) as advance:
        save(source.problem(config, progress), file)
        advance()
    return file


def _row(
    file: Path, key: str, folder: Path, entry: Entry, case: Case, config: Config, deadline: float
) -> Row:
    """The row on disk, when it is of this problem and limit; else a new one."""
    name = f"{case.problem}.{case.solver}.{case.start}{case.seed}.json"
    path, stamp = folder / "rows" / name, {"fingerprint": key, "limit_s": config.compare.limit_s}
    if path.is_file():
        # a row that another version wrote counts as none
        with suppress(ValueError, KeyError):
            known = json.loads(path.read_text())
            if known["stamp"] == stamp and known["row"]["status"] != "missing":
                return Row.model_validate(known["row"])
    left_s = deadline - perf_counter()
    if left_s <= 0.0:
        return empty_row(entry, case, "timeout", "its turn did not come: the comparison's time was up")
    limit_s = min(config.compare.limit_s, left_s)
    row = row_of(file, entry, case, limit_s)
    if row.status == "timeout" and limit_s < config.compare.limit_s:
        # with its whole time it might have come to an end: measured again when the comparison goes on
        return row
    write_text(path, json.dumps({"stamp": stamp, "row": row.model_dump(mode="json")}) + "\n")
    _log.info("%s: %s, %s", name, row.status, row.message)
    return row


def _words(source: Source, problem: MeasuredProblem) -> ProblemWords:
    reference = sigmas(problem, problem.solution, reference_covariance(problem, problem.solution))
    return ProblemWords(
        name=source.name,
        source=source.words,
        fingerprint=fingerprint(problem),
        **problem.size,
        accel_psd=problem.data.accel_psd,
        torque_psd=problem.data.torque_psd,
        prepared_s=problem.prepared_s,
        sigma_k1=reference[0],
        sigma_k2=reference[1],
        sigma_com_mm=reference[2],
    )


def _versions() -> dict[str, str]:
    found = {}
    for module, distribution in PACKAGES.items():
        try:
            found[module] = version(distribution)
        except PackageNotFoundError:
            continue
    return found
