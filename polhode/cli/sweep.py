"""``polhode sweep``: the points of a study, one task each, and their table."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.console import choose_progress
from polhode.runtime.errors import InputError


class SweepCommand(Command):
    """Compute a study: a row for each point of a grid or a design of settings.

    A study (docs/studies.md) names a base configuration, axes, and what is done for each point: simulate,
    run, evaluate, plan, compare. Points that are stored in DIR are not computed again: the same command goes
    on after whatever has ended it.
    """

    study: Annotated[Path, Positional("STUDY")]
    """The study, YAML."""
    output: Annotated[Path, Named("DIR", "-o")]
    """Folder of the results: a new or empty one, or that of a study, which is resumed."""
    dry_run: bool = False
    """Compute and write nothing: print the number of points, and what is rendered once."""
    page_only: bool = False
    """Compute nothing: write study.html again, of the points that are stored."""
    again_failed: bool = False
    """Compute points that have failed again, too."""
    cluster: Annotated[str | None, Named("ADDRESS")] = None
    """Scheduler of Dask that runs already (tcp://HOST:8786), whose workers see DIR under the same name. If it
    is left out, processes of this machine compute."""
    workers: Annotated[int, Named("N"), Field(ge=0, le=1024)] = 0
    """Processes of this machine; 0: one per core."""
    memory_gb: Annotated[float | None, Named("GB"), Field(gt=0, le=1e5)] = None
    """Limit of the memory of each process [GB]; one that reaches it is ended and the point tried again. If it
    is left out, they have equal shares of the memory."""

    def execute(self) -> Answer:
        """Compute the points and write the table. Points that failed are rows; the answer counts them."""
        if self.dry_run and self.page_only:
            raise InputError("--dry-run and --page-only contradict each other: give one of them")
        if self.cluster is not None and (self.workers or self.memory_gb is not None):
            raise InputError("--workers and --memory-gb are of this machine; with --cluster, leave them out")
        from polhode.studies.study import open_study

        study = open_study(self.study)
        if self.dry_run:
            from polhode.studies.forecast import forecast, format_forecast

            found = forecast(study)
            return Answer(format_forecast(found), figures=found)
        if self.page_only:
            from polhode.studies.sweep import rewrite_page

            page = self.output / rewrite_page(study, self.output).name
            return Answer(f"Page: {page}", paths=(page,))
        from polhode.studies.cluster import ClusterOptions
        from polhode.studies.sweep import sweep
        from polhode.studies.table import PAGE

        options = ClusterOptions(self.cluster, self.workers, self.memory_gb)
        swept = sweep(study, self.output, choose_progress(), options, self.again_failed)
        table, page = self.output / swept.table.name, self.output / PAGE
        most = swept.reasons.most_common(5)
        reasons = [f"  {count} x {reason}" for reason, count in most]
        failed = f", {swept.failed} failed" if swept.failed else ""
        all_failed = swept.failed == swept.points
        return Answer(
            f"Table: {table} ({swept.points} points{failed}); page: {page}",
            "\n".join(["Points that failed, by reason:", *reasons] if reasons else []),
            paths=(table, page, self.output),
            status="degraded" if swept.failed else "ok",
            figures={
                "points": swept.points,
                "stored_before": swept.stored,
                "failed": swept.failed,
                "reasons": dict(most),
            },
            failure=f"no point succeeded; the reasons: {table}" if all_failed else None,
        )
