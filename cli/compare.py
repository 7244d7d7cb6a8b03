"""``polhode compare``: which optimizer, which formulation, at what price."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.cli.console import choose_progress
from polhode.config import Config
from polhode.errors import RunFailure

_Values = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]


@dataclass(frozen=True)
class Compare:
    """Put the same measurements and the same cost through many optimizers: table, CSV, JSON, a page.

    Measurements: a dataset, a stored run, or the Monte Carlo generator (compare.monte_carlo). An interrupted
    comparison goes on with the same command. Options with dots override the configuration; the defaults shown
    are those of a value that the file leaves out.
    """

    config: Annotated[Positional[Path], arg(metavar="CONFIG")]
    """Configuration, YAML: configs/default.yaml tries every solver once; configs/compare/ holds others."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """Folder of the results, to be made, or of the same comparison, to be gone on with."""
    data: Annotated[Path | None, arg(metavar="SEQ")] = None
    """Folder of a stereo sequence (it holds mav0/): its measurements are made first, by the front end and the
    rounds of the back end that `polhode run` makes. Its truth (mav0/target0), if any, gives errors."""
    run: Annotated[Path | None, arg(metavar="RUN")] = None
    """Folder of a finished run: its measurements.npz is used."""
    truth: Annotated[Path | None, arg(metavar="SEQ")] = None
    """With --run: folder of the sequence that it was made from; its truth (mav0/target0) gives errors."""
    debug: FlagCreatePairsOff[bool] = False
    """Show the traceback of an error."""
    values: _Values = field(default_factory=Config)

    def execute(self) -> int:
        """Compare; 1 when no solver came to an end."""
        from polhode.compare.comparison import compare
        from polhode.compare.tables.table import print_tables

        found = compare(self.values, self.output, choose_progress(), self.data, self.run, self.truth)
        print_tables(found)
        page = self.output / "compare.html"
        if not any(row.status in ("ok", "baseline") for row in found.rows):
            raise RunFailure(f"no solver came to an end; why: {page}")
        print(f"Comparison: {page}")
        return 0
