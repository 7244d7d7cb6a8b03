"""``polhode compare``: optimizers and formulations side by side."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import ConfiguredCommand, Named, Positional
from polhode.runtime.console import choose_progress

FIGURES = {"problem", "solver", "start", "seed", "status", "cost", "iterations", "wall_s", "k1", "k2"}
"""Of each row, what the answer repeats of compare.json"""


class CompareCommand(ConfiguredCommand):
    """Solve the same measurements and the same cost with many optimizers: table, CSV, JSON, a page.

    The measurements come from a dataset, a stored run, or the Monte Carlo generator (compare.monte_carlo).
    Options with dots override the configuration; the help shows the default of each key, which applies where
    the file does not set it.
    """

    output: Annotated[Path, Named("DIR", "-o")]
    """Folder of the results: a new one, or that of another comparison, whose files are replaced."""
    config: Annotated[Path | None, Positional("CONFIG")] = None
    """Configuration, YAML. If it is left out the defaults apply, which try every solver once; there are
    others in configs/compare/."""
    data: Annotated[Path | None, Named("SEQ")] = None
    """Folder of a stereo sequence (it contains mav0/): its measurements are made first, as by `polhode run`.
    Its truth (mav0/target0), if any, gives errors."""
    run: Annotated[Path | None, Named("RUN")] = None
    """Folder of a finished run: its measurements.npz is used."""
    truth: Annotated[Path | None, Named("SEQ")] = None
    """With --run: folder of the sequence of that run; its truth (mav0/target0) gives errors."""

    def execute(self) -> Answer:
        """Compare and print the tables. Raises RunFailure when no solver converged."""
        from polhode.compare.comparison import compare
        from polhode.compare.tables import format_tables

        comparison = compare(self.values, self.output, choose_progress(), self.data, self.run, self.truth)
        page = self.output / "compare.html"
        solved = any(row.status in ("ok", "baseline") for row in comparison.rows)
        return Answer(
            f"Comparison: {page}",
            format_tables(comparison),
            paths=(page, self.output / "compare.json", self.output / "compare.csv"),
            figures={"rows": [row.model_dump(include=FIGURES) for row in comparison.rows]},
            failure=None if solved else f"no solver converged; the reasons: {page}",
        )
