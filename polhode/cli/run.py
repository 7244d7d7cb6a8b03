"""``polhode run``: estimate motion, mass properties, map and mesh from a stereo sequence."""

import logging
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from polhode.cli.answer import Answer
from polhode.cli.options import ConfiguredCommand, Named
from polhode.runtime.console import announce, choose_progress, progress_of_run
from polhode.runtime.errors import InputError, RunFailure, one_line
from polhode.runtime.processes import start_server, worker_count

if TYPE_CHECKING:
    from polhode.pipeline.live.run_live import Watch
    from polhode.pipeline.run import RunResult
    from polhode.viewer.target import ViewTarget

_log = logging.getLogger(__name__)

REPORT = "report.html"
FIGURES = {
    *("frames", "frames_used", "landmarks", "observations", "duration_s", "timing_s"),
    *("com_G", "identifiable", "noise"),
}
"""What the answer repeats of summary.json, beside k1 and k2"""


class RunCommand(ConfiguredCommand):
    """Estimate motion, mass properties, map and mesh of the target from a stereo sequence.

    Options with dots override the configuration; the help shows the default of each key, which applies where
    the file does not set it.
    """

    output: Annotated[Path, Named("RUN", "-o")]
    """Folder of the results, which is created."""
    data: Annotated[Path | None, Named("SEQ")] = None
    """Folder of the stereo sequence (it contains mav0/)."""
    live: Annotated[Path | None, Named("SOURCE")] = None
    """Instead of --data: a folder of the same layout that fills meanwhile. Each pair gives a state before the
    next one comes; at the end, when the file mav0/end appears or after --patience-s, follows the answer from
    all of them. Ctrl-C finishes with what has come."""
    rate: Annotated[float | None, Named("RATE")] = None
    """With --live: SOURCE is complete and is replayed, 1 at its own speed, 2 at twice that, 0 as fast as it
    is processed."""
    patience_s: Annotated[float | None, Named("S")] = None
    """With --live: SOURCE has ended when no pair came for so long [s]; 10 if it is left out."""
    overwrite: bool = False
    """Replace an existing run as soon as the new one is complete. Only files of the run are replaced; others
    in its folder stay. A failed run replaces only a failed one: else it is written to RUN.failed."""
    even_if_failed: bool = False
    """With --overwrite: a failed run, too, replaces one that did not fail."""
    resume: bool = False
    """Go on with the run that was interrupted at RUN, or replace the one that is there by one with another
    configuration: stages that are finished, and that the configuration does not change, are used again. The
    result is the same as without. Where there is nothing to resume, all is computed."""
    view: bool = False
    """Show the run in the window of Rerun: with --live each pair as its state comes, otherwise the finished
    run."""
    view_save: Annotated[Path | None, Named("FILE")] = None
    """The same as a recording, FILE.rrd, which "rerun FILE.rrd" shows. An earlier one is replaced."""

    def execute(self) -> Answer:
        """Run the pipeline. A run that did not reach a converged estimate has its failure in the answer."""
        target = None
        if self.view or self.view_save is not None:
            from polhode.runtime.optional_parts import require_part

            require_part("rerun", "--view" if self.view else "--view-save")
            from polhode.viewer.target import require_target

            target = require_target(self.view_save, self.view, "--view-save")
        # before this process imports the same
        start_server(("polhode.pipeline.run",), worker_count(self.values.runtime.workers))
        if self.live is not None:
            result = self._run_live(self.live, target)
        else:
            result = self._run()
            if target is not None:
                from polhode.viewer.show_run import show_run

                try:
                    show_run(_folder_of(result), self.data, target, choose_progress())
                except (InputError, RunFailure) as error:
                    _log.warning("the run is complete, but it could not be shown: %s", error)
        note = f"; {result.note}" if result.note else ""
        failure, found = result.failure, _from_summary(_folder_of(result))
        # warnings together, as those that came while it worked stand far above
        lines = [f"- {one_line(each)}" for each in found.get("warnings", ()) if each != failure]
        lines = ["Warnings of this run:", *lines] if lines else []
        what = "Report" if result.report_path.name == REPORT else "Results"
        return Answer(
            f"{what}: {result.report_path}",
            "\n".join([*lines, *filter(None, [result.sentence])]),
            paths=(result.report_path, _folder_of(result)),
            status=result.status,
            **found,
            failure=failure and f"{failure}; the best motion found: {result.report_path}{note}",
        )

    def _run(self) -> "RunResult":
        from polhode.pipeline.run import run

        if self.data is None:
            raise InputError(
                "the sequence is missing: give --data SEQ, or --live SOURCE for one that comes now"
            )
        if self.rate is not None or self.patience_s is not None:
            raise InputError("--rate and --patience-s need --live SOURCE: --data is read at once")
        with progress_of_run() as progress:
            return run(
                self.values,
                self.data,
                self.output,
                progress,
                overwrite=self.overwrite,
                even_if_failed=self.even_if_failed,
                resume=self.resume,
            )

    def _run_live(self, source: Path, target: "ViewTarget | None") -> "RunResult":
        from polhode.pipeline.live.run_live import PATIENCE_S, open_source, run_live

        if self.data is not None:
            raise InputError("--data and --live: give one of them")
        if self.resume:
            raise InputError(
                "--resume: a stream cannot be resumed; give --data instead of --live for the answer from "
                "the pairs that were recorded"
            )
        patience_s = PATIENCE_S if self.patience_s is None else self.patience_s
        pairs = open_source(source, self.rate, patience_s)
        watching: AbstractContextManager[Watch | None] = nullcontext()
        if target is not None:
            from polhode.viewer.show_live import watching as watching_by

            watching = watching_by(target, source.resolve().name)
        with watching as watch:
            result, live = run_live(
                self.values,
                pairs,
                self.output,
                choose_progress(),
                rate=self.rate,
                overwrite=self.overwrite,
                even_if_failed=self.even_if_failed,
                watch=watch,
            )
        announce(
            f"live: {len(live.processed)} pairs, {live.dropped} dropped; report {live.report_s:.1f} s after "
            "the last one"
        )
        return result


def _folder_of(result: "RunResult") -> Path:
    """The folder of the run; where there is no page, the result names it instead."""
    return result.report_path.parent if result.report_path.name == REPORT else result.report_path


def _from_summary(folder: Path) -> dict[str, Any]:
    """Key figures and warnings of a run's summary; nothing where a failed run has none."""
    from polhode.run_directory.summary import read_summary

    try:
        summary = read_summary(folder / "summary.json")
    except InputError:
        return {}
    figures = summary.model_dump(include=FIGURES)
    if summary.inertia is not None:
        figures |= {"k1": summary.inertia.k1, "k2": summary.inertia.k2}
    return {"figures": figures, "warnings": tuple(summary.warnings)}
