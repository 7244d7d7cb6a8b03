"""What the caller of a run gets: where it is, whether it can be trusted, and the motion in a sentence."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from polhode.pipeline.find_motion import MotionSolution
from polhode.pipeline.finish_surface import Coloured
from polhode.pipeline.runner import Result, Runner
from polhode.records.estimate import MotionEstimate
from polhode.report import finish_run
from polhode.report.tables import motion_sentence
from polhode.run_directory.run_folder import RunFolder
from polhode.run_directory.summary import build_summary
from polhode.run_directory.summary_schema import Check, Intervals, ShapeFindings, Summary


@dataclass(frozen=True)
class RunResult:
    """What the command line reports at the end."""

    status: Literal["ok", "degraded", "failed"]
    report_path: Path
    """The page; the folder of the run where there is none"""
    sentence: str
    failure: str | None = None
    """Why the status is "failed"; everything that was found is in the run directory all the same"""
    note: str = ""
    """What the user should know about the place of the run"""


def report_run(
    run: Runner,
    written: RunFolder,
    answer: Result[MotionSolution],
    coloured: Result[Coloured],
    shape: Result[ShapeFindings],
    checks: Result[list[Check]],
    intervals: Result[tuple[Intervals | None, list[str]]],
    warnings: Result[list[str]],
) -> Callable[[RunFolder], RunResult]:
    """Write summary.json and report.html. Returns what makes the result of the run once it is published."""
    tracks, estimate, surface = answer.value.tracks, answer.value.estimate, coloured.value.surface
    summary = build_summary(
        *(tracks, estimate, surface, run.clock.with_total(), warnings.value),
        shape=shape.value,
        checks=checks.value,
    )
    summary = summary.model_copy(update={"intervals": intervals.value[0], "data": written.recording})
    with run.context.progress.stage("report", 1) as advance:
        summary = finish_run(written.path, summary)
        advance()
    return partial(_result_of, summary, estimate)


def _result_of(summary: Summary, estimate: MotionEstimate, written: RunFolder) -> RunResult:
    sentence = motion_sentence(estimate, summary.frames_used, summary.intervals)
    report = written.published / "report.html"
    failure = summary.warnings[0] if summary.status == "failed" else None
    place = report if report.is_file() else written.published
    return RunResult(summary.status, place, sentence, failure, written.note)
