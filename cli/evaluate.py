"""``polhode evaluate``: a run against the truth of its dataset."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from polhode.cli.options import Debug


@dataclass(frozen=True)
class EvaluateCommand:
    """Compare a run with the truth of its dataset: RUN/metrics.json, a table, a section of the report."""

    run: Annotated[Positional[Path], arg(metavar="RUN")]
    """Folder of a finished run."""
    data: Annotated[Positional[Path], arg(metavar="SEQ")]
    """Folder of the sequence of that run, with its truth in mav0/target0."""
    debug: Debug = False

    def execute(self) -> int:
        """Write the metrics, renew the report and print the table."""
        from polhode.pipeline.evaluation import format_table
        from polhode.pipeline.report import evaluate_and_report

        print(format_table(evaluate_and_report(self.run, self.data)))
        return 0
