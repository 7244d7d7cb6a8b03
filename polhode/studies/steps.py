"""What a worker does: simulate a sequence, or compute a point step by step and store its record.

Whatever a step raises becomes the reason of the point's row; what prevents the record from being stored (a
full disk) is raised. Nothing here knows of Dask.
"""

import json
import logging
import math
import platform
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

from pydantic import BaseModel

from polhode.config import Config
from polhode.config.study_settings import Keep, PlanOptions, Step
from polhode.files.atomic import REFUSALS
from polhode.runtime.errors import InputError, RunFailure, one_line
from polhode.runtime.program_digest import code_digest, processor
from polhode.runtime.progress import Silent
from polhode.runtime.threads import limit_threads
from polhode.studies.store import Record, Store
from polhode.studies.study import RECORD

DONE, FAILED = "done", "failed"
NOT_OF_A_RUN = frozenset(
    {"schema_", "files", "data", "timing_s", "verdict", "status", "warnings", "words", "own_sha256"}
)
"""Keys of a summary that say nothing of the answer, or stand in columns of their own"""
Metrics = dict[str, bool | int | float | str | None]


class OtherCode(Exception):
    """This worker has another polhode than the one that plans the study."""


@dataclass(frozen=True)
class SequenceJob:
    """A sequence to simulate."""

    folder: Path
    """Of the study"""
    digest: str
    config: dict[str, Any]
    code: str
    """Digest of the program that wants it"""


@dataclass(frozen=True)
class SequenceOutcome:
    """What became of it."""

    reason: str = ""
    """Why there is none; empty: it is there"""
    seconds: float = 0.0


@dataclass(frozen=True)
class PointJob:
    """A point to compute."""

    folder: Path
    """Of the study"""
    address: str
    values: dict[str, Any]
    """Of the axes"""
    steps: tuple[Step, ...]
    config: dict[str, Any]
    plan: PlanOptions
    keep: Keep
    code: str
    """Digest of the program that wants it"""
    sequence: str = ""
    """Digest of the sequence that it simulates; empty: none"""
    data: Path | None = None
    """The sequence that it reads instead"""


@dataclass
class _Work:
    """A point while it is computed."""

    job: PointJob
    config: Config
    sequence: Path | None
    folder: Path
    """Of this attempt"""
    metrics: Metrics = field(default_factory=dict)
    times: dict[str, float] = field(default_factory=dict)
    verdict: str | None = None
    """Of the run, in a word"""
    doubts: str | None = None
    """Reasons for that verdict, where it is not ok"""

    @property
    def run(self) -> Path:
        """Folder of the run."""
        return self.folder / "run"


def simulate_sequence(job: SequenceJob) -> SequenceOutcome:
    """Render a sequence where it is missing; what was begun is resumed."""
    from polhode.simulation import simulate

    _prepare(job.code)
    store, start = Store(job.folder), perf_counter()
    folder = store.sequence_folder(job.digest)
    try:
        config = Config.model_validate(job.config)
        assert config.scene is not None
        while not store.has_sequence(job.digest):
            folder.parent.mkdir(parents=True, exist_ok=True)
            try:
                simulate(config.scene, config.seed, folder, Silent())
            except InputError as error:
                # a worker that lost its scheduler may be rendering the same
                if "another polhode is at work" not in str(error):
                    raise
                time.sleep(2.0)
    except Exception as error:  # noqa: BLE001  the reason of every point that needs this sequence
        return SequenceOutcome(f"simulate: {_reason(error)}".replace(str(folder), "SEQ"))
    return SequenceOutcome(seconds=perf_counter() - start)


def compute_point(job: PointJob, sequence: SequenceOutcome | None = None) -> Record:
    """Compute a point and store its record. Raises RunFailure, OSError: it cannot be stored."""
    _prepare(job.code)
    store = Store(job.folder)
    if sequence is not None and sequence.reason:
        record = failed_record(job.address, job.values, sequence.reason, job.sequence)
        store.write(record)
        return record
    where = store.sequence_folder(job.sequence) if job.sequence else job.data
    with store.attempt() as folder:
        work = _Work(job, Config.model_validate(job.config), where, folder)
        if sequence is not None:
            work.times["simulate_s"] = sequence.seconds
        reason = _do_steps(work)
        _keep(work, store, reason)
    record = failed_record(job.address, job.values, reason, job.sequence)
    record |= {"status": FAILED if reason else DONE, "verdict": work.verdict, "doubts": work.doubts}
    record |= {"metrics": work.metrics, "times": work.times | record["times"]}
    store.write(record)
    return record


def failed_record(address: str, values: dict[str, Any], reason: str, sequence: str = "") -> Record:
    """Of a point that no step was done for."""
    return {
        "schema": RECORD,
        "address": address,
        "settings": values,
        "status": FAILED,
        "reason": reason or None,
        "verdict": None,
        "doubts": None,
        "metrics": {},
        "times": {"finished": datetime.now(UTC).isoformat(timespec="milliseconds")},
        "versions": versions(),
        "code": code_digest(),
        "sequence": sequence or None,
    }


@cache
def versions() -> dict[str, str]:
    """Of what decides a result."""
    return {
        "polhode": version("polhode"),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "processor": processor().partition(":")[2].strip() or processor(),
    }


def _prepare(code: str) -> None:
    """One thread, no messages on the terminal of whoever started the worker. Raises OtherCode."""
    if code_digest() != code:
        raise OtherCode(f"a worker on {platform.node()} has other code of polhode than this program")
    _one_thread()
    root = logging.getLogger()
    if not root.handlers:
        root.addHandler(logging.NullHandler())


@cache
def _one_thread() -> None:
    """Once for a process, as a thread of it computes one point after the other."""
    limit_threads(1)


def _do_steps(work: _Work) -> str:
    """Do every step. Returns the reason why one failed, without the names of folders, which differ between
    two attempts; empty: none did."""
    for step in work.job.steps:
        if step == "simulate":
            continue
        start = perf_counter()
        try:
            _STEPS[step](work)
        except Exception as error:  # noqa: BLE001  the reason of the row
            reason = f"{step}: {_reason(error)}"
            for folder, name in ((work.run, "RUN"), (work.folder, "DIR"), (work.sequence, "SEQ")):
                reason = reason.replace(str(folder), name)
            return reason
        finally:
            work.times[f"{step}_s"] = perf_counter() - start
    return ""


def _reason(error: BaseException) -> str:
    """The reason of a row. Raises RunFailure for a disk that is full or fails: that is no property of the
    point."""
    is_known = isinstance(error, InputError | RunFailure)
    said = one_line(str(error) if is_known else f"unexpected {type(error).__name__}: {error}")
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in REFUSALS:
            raise RunFailure(said) from error
        cause = cause.__cause__ or cause.__context__
    return said


def _run(work: _Work) -> None:
    from polhode.pipeline.run import run
    from polhode.run_directory.summary import read_summary

    assert work.sequence is not None
    try:
        result = run(work.config, work.sequence, work.run, Silent())
    except RunFailure:
        work.verdict = "failed"
        raise
    work.verdict = result.status
    summary = read_summary(work.run / "summary.json").model_dump()
    if summary["verdict"] is not None and result.status != "ok":
        work.doubts = one_line("; ".join(summary["verdict"]["reasons"]))
    work.times |= {f"run.{key}_s": each for key, each in summary["timing_s"].items()}
    work.metrics |= flattened("run", summary, NOT_OF_A_RUN)


def _evaluate(work: _Work) -> None:
    from polhode.report import evaluate_and_report
    from polhode.report.evaluation import evaluate

    assert work.sequence is not None
    if work.job.keep == "whole":
        metrics = evaluate_and_report(work.run, work.sequence)
    else:
        metrics = evaluate(work.run, work.sequence)
        _write_json(work.run / "metrics.json", metrics)
    work.metrics |= flattened("evaluate", metrics)


def _plan(work: _Work) -> None:
    """The plan, and whether the true body leaves the keep-out volume, where truth reaches its horizon."""
    from polhode.planning.keep_out.keep_out_truth import keep_out_truth, truth_numbers
    from polhode.planning.keep_out.volumes import KeepOutOptions
    from polhode.planning.plan import plan_run
    from polhode.planning.plan_files import plan_folder, summary_of, write_plan

    wanted = work.job.plan
    options = KeepOutOptions(wanted.horizon_s, wanted.confidence, members=wanted.members, cover=wanted.cover)
    plan = plan_run(work.run, options, None)
    if work.job.keep == "whole":
        with plan_folder(work.folder / "plan") as place:
            write_plan(plan, place)
    else:
        _write_json(work.run / "planning.json", summary_of(plan))
    work.metrics |= flattened("plan", summary_of(plan), frozenset({"schema", "notes", "left_out"}))
    if plan.keep_out is not None and plan.surface is not None and work.sequence is not None:
        with suppress(InputError):
            truth = keep_out_truth(plan.keep_out, plan.surface, work.run, work.sequence)
            work.metrics |= flattened("plan.truth", dict(truth_numbers(truth)))


def _compare(work: _Work) -> None:
    from polhode.compare.comparison import compare

    folder, has_run = work.folder / "compare", "run" in work.job.steps
    comparison = compare(
        work.config,
        folder,
        Silent(),
        data=None if has_run else work.sequence,
        run=work.run if has_run else None,
        truth=work.sequence if has_run and work.job.sequence else None,
    )
    for row in comparison.rows:
        name = f"compare.{row.problem}.{row.solver}.{row.start}{row.seed}"
        found = row.model_dump(include={"status", "cost", "iterations", "k1", "k2", "errors"})
        work.metrics |= flattened(name, found)
        if row.wall_s is not None:
            work.times[f"{name}.wall_s"] = row.wall_s


_STEPS: dict[str, Callable[[_Work], None]] = {
    "run": _run,
    "evaluate": _evaluate,
    "plan": _plan,
    "compare": _compare,
}


def _keep(work: _Work, store: Store, reason: str) -> None:
    """Keep of the attempt's folder what the study asks for; of a failed run what it has."""
    if work.job.keep == "nothing" or not any(work.folder.iterdir()):
        return
    kept = work.folder
    if work.job.keep == "summary":
        kept = work.folder / "kept"
        kept.mkdir()
        for name in ("summary.json", "metrics.json", "config.yaml", "planning.json", "compare.csv"):
            for file in (work.run / name, work.folder / "compare" / name):
                if file.is_file():
                    shutil.copy(file, kept)
    if reason:
        with suppress(OSError):
            (kept / "reason.txt").write_text(f"{reason}\n", encoding="utf-8")
    store.keep(kept, work.job.address)


def flattened(prefix: str, values: Mapping[str, Any], without: frozenset[str] = frozenset()) -> Metrics:
    """Numbers, truths and short texts below ``prefix``, sections by names with dots, vectors of at most three
    numbers by position; what is not finite is None."""
    return dict(_leaves(prefix, {key: each for key, each in values.items() if key not in without}))


def _leaves(name: str, value: Any) -> Iterator[tuple[str, bool | int | float | str | None]]:
    value = value.model_dump() if isinstance(value, BaseModel) else value
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _leaves(f"{name}.{key}", each)
    elif isinstance(value, list | tuple):
        if len(value) <= 3 and not any(isinstance(each, list | tuple | Mapping | str) for each in value):
            for position, each in enumerate(value):
                yield from _leaves(f"{name}.{position}", each)
    elif isinstance(value, float):
        yield name, value if math.isfinite(value) else None
    elif not isinstance(value, str) or len(value) <= 40:
        yield name, value


def _write_json(path: Path, values: Any) -> None:
    path.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
