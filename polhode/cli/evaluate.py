"""``polhode evaluate``: a run against the truth of its dataset."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Positional


class EvaluateCommand(Command):
    """Compare a run with the truth of its dataset: RUN/metrics.json, a table, a section of the report."""

    run: Annotated[Path, Positional("RUN")]
    """Folder of a finished run."""
    data: Annotated[Path, Positional("SEQ")]
    """Folder of the sequence of that run, with its truth in mav0/target0."""

    def execute(self) -> Answer:
        """Write the metrics, renew the report and print the table."""
        from polhode.report import evaluate_and_report
        from polhode.report.evaluation import format_table

        metrics = evaluate_and_report(self.run, self.data)
        path = self.run / "metrics.json"
        return Answer(f"Metrics: {path}", format_table(metrics), paths=(path,), figures=metrics)
