"""What a worker does: simulate a sequence, or compute a point step by step and store its record.

Whatever a step raises becomes the reason of the point's row; what prevents the record from being stored (a
full disk) is raised. Nothing here knows of Dask.
"""

import json
import logging
import platform
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from polhode.config import Config
from polhode.config.study_settings import Keep, PlanOptions, Step
from polhode.files.atomic import REFUSALS
from polhode.runtime.errors import InputError, RunFailure, one_line
from polhode.runtime.program_digest import code_digest, processor
from polhode.runtime.progress import Silent
from polhode.runtime.threads import limit_threads
from polhode.studies.flat_metrics import NOT_OF_A_RUN, Metrics, as_json, flattened
from polhode.studies.measurement import MeasuredPoint, Measurement
from polhode.studies.store import Record, Store
from polhode.studies.study import RECORD

if TYPE_CHECKING:
    from polhode.planning.plan import Plan

DONE, FAILED = "done", "failed"
SUMMARY_FILES = ("summary.json", "metrics.json", "config.yaml", "planning.json", "compare.csv")
"""What ``keep: summary`` keeps"""


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
    measurement: Measurement | None = None
    case: dict[str, Any] = field(default_factory=dict)
    """Settings for the measurement alone"""


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
    measured: dict[str, Any] | None = None
    """What the function of the step ``measure`` found, as JSON has it"""

    def named(self, reason: str) -> str:
        """A reason without what differs between two attempts: the names of folders."""
        for folder, name in ((self.run, "RUN"), (self.folder, "DIR"), (self.sequence, "SEQ")):
            reason = reason.replace(str(folder), name)
        return reason

    @property
    def run(self) -> Path:
        """Folder of the run."""
        return self.folder / "run"


def simulate_sequence(job: SequenceJob) -> SequenceOutcome:
    """Render a sequence where it is missing; what was begun is resumed."""
    _prepare(job.code)
    store, start = Store(job.folder), perf_counter()
    try:
        while not store.has_sequence(job.digest):
            _simulate(Config.model_validate(job.config), store.sequence_folder(job.digest))
    except Exception as error:  # noqa: BLE001  the reason of every point that needs this sequence
        _require_disk(error)
        folder = str(store.sequence_folder(job.digest))
        return SequenceOutcome(f"simulate: {_reason(error)}".replace(folder, "SEQ"))
    return SequenceOutcome(seconds=perf_counter() - start)


def _simulate(config: Config, folder: Path) -> None:
    from polhode.simulation import simulate

    assert config.scene is not None
    folder.parent.mkdir(parents=True, exist_ok=True)
    try:
        simulate(config.scene, config.seed, folder, Silent())
    except InputError as error:
        # a worker that lost its scheduler may be rendering the same
        if "another polhode is at work" not in str(error):
            raise
        # while another process renders the same sequence
        time.sleep(2.0)


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
        reason = _all_steps(work)
        _keep(work, store, reason)
    record = failed_record(job.address, job.values, reason, job.sequence)
    record |= {"status": FAILED if reason else DONE, "verdict": work.verdict, "doubts": work.doubts}
    record |= {"metrics": work.metrics, "times": work.times | record["times"]}
    if work.measured is not None:
        record["measured"] = work.measured
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


def _all_steps(work: _Work) -> str:
    """Do every step. Returns the reason why one failed; empty: none did."""
    for step in work.job.steps:
        if step == "simulate":
            continue
        start = perf_counter()
        try:
            _STEPS[step](work)
        except Exception as error:  # noqa: BLE001  the reason of the row
            _require_disk(error)
            return work.named(f"{step}: {_reason(error)}")
        finally:
            work.times[f"{step}_s"] = perf_counter() - start
    return ""


def _require_disk(error: BaseException) -> None:
    """Raise RunFailure for an error of a disk that is full or fails: it is no property of the point."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in REFUSALS:
            raise RunFailure(_reason(error)) from error
        cause = cause.__cause__ or cause.__context__


def _reason(error: BaseException) -> str:
    if isinstance(error, InputError | RunFailure):
        return one_line(str(error))
    return one_line(f"unexpected {type(error).__name__}: {error}")


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
    work.metrics |= flattened("plan.truth", _kept_out(work, plan))


def _kept_out(work: _Work, plan: "Plan") -> Metrics:
    """Whether the true body leaves the keep-out volume; nothing where there is no volume, or no truth that
    reaches its horizon."""
    from polhode.planning.keep_out.keep_out_truth import keep_out_truth, truth_numbers

    if plan.keep_out is None or plan.surface is None or work.sequence is None:
        return {}
    try:
        return dict(truth_numbers(keep_out_truth(plan.keep_out, plan.surface, work.run, work.sequence)))
    except InputError:
        return {}


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


def _measure(work: _Work) -> None:
    assert work.job.measurement is not None
    run = work.run if "run" in work.job.steps else None
    folder = work.folder / "measured"
    folder.mkdir()
    found = work.job.measurement.function(
        MeasuredPoint(work.job.case, work.config, work.sequence, run, folder)
    )
    work.measured = as_json(found)
    work.metrics |= flattened("measure", work.measured)
    if not any(folder.iterdir()):
        folder.rmdir()


_STEPS: dict[str, Callable[[_Work], None]] = {
    "run": _run,
    "evaluate": _evaluate,
    "plan": _plan,
    "compare": _compare,
    "measure": _measure,
}


def _keep(work: _Work, store: Store, reason: str) -> None:
    """Keep of the attempt's folder what the study asks for; of a failed run what it has."""
    if work.job.keep == "nothing" or not any(work.folder.iterdir()):
        return
    kept = work.folder
    if work.job.keep == "summary":
        kept = work.folder / "kept"
        kept.mkdir()
        for folder in (work.run, work.folder / "compare"):
            for name in SUMMARY_FILES:
                if (folder / name).is_file():
                    shutil.copy(folder / name, kept)
    if reason:
        with suppress(OSError):
            (kept / "reason.txt").write_text(f"{reason}\n", encoding="utf-8")
    store.keep(kept, work.job.address)


def _write_json(path: Path, values: Any) -> None:
    path.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
