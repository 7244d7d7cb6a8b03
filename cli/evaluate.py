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
        from polhode.output.locks import at_work
        from polhode.output.place import require_writable
        from polhode.output.single_file import remove_all_partials
        from polhode.pipeline.evaluation import evaluate, format_table
        from polhode.pipeline.report import write_evaluation
        from polhode.pipeline.run_directory.run_folder import require_run_folder

        require_run_folder(self.run)
        require_writable(self.run, self.run, "make the run writable, or evaluate a copy of it")
        with at_work(self.run, self.run):
            remove_all_partials(self.run)
            metrics = evaluate(self.run, self.data)
            write_evaluation(self.run, metrics)
        print(format_table(metrics))
        return 0
