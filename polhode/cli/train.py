"""``polhode train``: train a network of the front end."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import ConfiguredCommand, Named, Positional
from polhode.config import Config, Train
from polhode.runtime.console import choose_progress
from polhode.runtime.errors import InputError
from polhode.runtime.processes import worker_count


class TrainCommand(ConfiguredCommand):
    """Train a network of the front end on simulated scenes; missing ones are rendered first.

    The same command resumes an interrupted training. Options with dots override the configuration; the help
    shows the default of each key, which applies where the file does not set it.
    """

    config: Annotated[Path, Positional("CONFIG")]
    """Configuration with a train section, YAML: configs/train/features.yaml, configs/train/depth.yaml."""
    output: Annotated[Path | None, Named("DIR", "-o")] = None
    """Folder of the results, instead of train.output of the configuration. A training that was begun there
    continues."""
    values: Config = Config(train=Train())

    def execute(self) -> Answer:
        """Train; print the weights' path and their scores."""
        if self.values.train is None:
            raise InputError(f"{self.config}: no 'train' section; see configs/train/ for examples")
        from polhode.train.run import train

        values, settings = self.values, self.values.train
        if self.output is not None:
            settings = settings.model_copy(update={"output": str(self.output)})
            values = values.model_copy(update={"train": settings})
        trained = train(values, settings, choose_progress(), worker_count(values.runtime.workers))
        lines = [f"  {name}: {value:.4g}" for name, value in trained.outcome.scores.items()]
        if not trained.outcome.finished:
            steps = f"step {trained.outcome.step} of {settings.schedule.steps}"
            lines.append(f"The time limit was reached at {steps}; the same command resumes.")
        return Answer(
            f"Weights: {trained.weights}",
            "\n".join(lines),
            paths=(trained.weights,),
            figures={"finished": trained.outcome.finished, "scores": trained.outcome.scores},
        )
