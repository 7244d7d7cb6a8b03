"""``polhode report``: the page of one run, or one page that compares several."""

import os
from pathlib import Path
from time import perf_counter
from typing import Annotated

from polhode.cli.answer import Answer, sizes_of
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.errors import InputError


class ReportCommand(Command):
    """Make the report of a run again, or one page that compares several runs."""

    runs: Annotated[tuple[Path, ...], Positional("RUN...")]
    """Folders of runs."""
    output: Annotated[Path, Named("FILE", "-o")]
    """The page, HTML. An earlier page of this command is replaced, any other file is not."""

    def execute(self) -> Answer:
        """Write the page."""
        if not self.runs:
            raise InputError(
                "a run is missing: give the folder of one or more runs; see polhode report --help"
            )
        known: dict[Path, Path] = {}
        for run in self.runs:
            if (same := known.setdefault(Path(os.path.realpath(run)), run)) is not run:
                raise InputError(f"{same} and {run} are the same run: give each run once")
        from polhode.report import page_file, write_comparison, write_report

        start = perf_counter()
        place = page_file(self.output, self.runs)
        if len(self.runs) == 1:
            write_report(self.runs[0], place)
        else:
            write_comparison(self.runs, place)
        figures = {
            "runs": len(self.runs),
            "files": sizes_of((self.output,)),
            "duration_s": perf_counter() - start,
        }
        return Answer(f"Report: {self.output}", paths=(self.output,), figures=figures)
