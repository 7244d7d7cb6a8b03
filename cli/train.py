"""``polhode train``: from a configuration to the weights of a network of the front end."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import AvoidSubcommands, FlagConversionOff, FlagCreatePairsOff, Positional, arg

from polhode.cli.console import choose_progress
from polhode.config import Config, Train
from polhode.errors import InputError
from polhode.threads import processes

_Values = Annotated[AvoidSubcommands[FlagConversionOff[Config]], arg(name="")]


@dataclass(frozen=True)
class TrainNetwork:
    """Train a network of the front end on simulated scenes, which are rendered first where they are missing.

    The same command goes on where it was interrupted. Options with dots override the configuration; the
    defaults shown are those of a value that the file leaves out.
    """

    config: Annotated[Positional[Path], arg(metavar="CONFIG")]
    """Configuration with a train section, YAML: configs/train/features.yaml, configs/train/depth.yaml."""
    debug: FlagCreatePairsOff[bool] = False
    """Show the traceback of an error."""
    values: _Values = field(default_factory=lambda: Config(train=Train()))

    def execute(self) -> int:
        """Train; print where the weights are and how good they are."""
        if self.values.train is None:
            raise InputError(f"{self.config}: no 'train' section; see configs/train/ for examples")
        from polhode.train.run import train

        trained = train(
            self.values, self.values.train, choose_progress(), processes(self.values.runtime.workers)
        )
        for name, value in trained.outcome.scores.items():
            print(f"  {name}: {value:.4g}")
        if not trained.outcome.finished:
            steps = f"step {trained.outcome.step} of {self.values.train.schedule.steps}"
            print(f"The time was up at {steps}; the same command goes on.")
        print(f"Weights: {trained.weights}")
        return 0
