"""``polhode report``: the page of one run, or one page that compares several."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from polhode.cli.options import Debug
from polhode.errors import InputError


@dataclass(frozen=True)
class ReportCommand:
    """Make the report of a run again, or one page that compares several runs."""

    runs: Annotated[Positional[tuple[Path, ...]], arg(metavar="RUN...")]
    """Folders of runs."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """The page, HTML. An existing file is replaced."""
    debug: Debug = False

    def execute(self) -> int:
        """Write the page."""
        if not self.runs:
            raise InputError(
                "a run is missing: give the folder of one or more runs; see polhode report --help"
            )
        if not self.output.parent.is_dir():
            raise InputError(f"{self.output.parent} is not a folder: choose another -o")
        if self.output.is_dir():
            raise InputError(f"{self.output} is a folder: -o names the page, such as report.html")
        from polhode.pipeline.report import write_comparison, write_report

        if len(self.runs) == 1:
            write_report(self.runs[0], self.output)
        else:
            write_comparison(self.runs, self.output)
        print(f"Report: {self.output}")
        return 0
