"""``polhode simulate``: render a dataset with truth."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import ConfiguredCommand, Named, Positional
from polhode.config import Config, Scene
from polhode.runtime.console import announce, choose_progress
from polhode.runtime.errors import InputError
from polhode.runtime.processes import worker_count


class SimulateCommand(ConfiguredCommand):
    """Render a dataset with truth from the scene of a configuration.

    Options with dots override the configuration; the help shows the default of each key, which applies where
    the file does not set it.
    """

    config: Annotated[Path, Positional("CONFIG")]
    """Configuration with a scene, YAML."""
    output: Annotated[Path, Named("SEQ", "-o")]
    """Folder of the dataset, which is created."""
    overwrite: bool = False
    """Replace an existing dataset that simulate made, if nothing was added to it. Nothing else is ever
    replaced."""
    values: Config = Config(scene=Scene())

    def execute(self) -> Answer:
        """Render. The dataset appears when it is complete; an interrupted one is resumed."""
        if self.values.scene is None:
            raise InputError(f"{self.config}: no 'scene' to simulate; add one, or extend a file that has it")
        from polhode.simulation.bodies import describe
        from polhode.simulation.dataset.sequence import plan_sequence, require_free, write_sequence

        require_free(self.output, self.overwrite)
        plan = plan_sequence(self.values.scene, self.values.seed)
        announce(describe(plan.body))
        write_sequence(
            plan, self.output, choose_progress(), worker_count(self.values.runtime.workers), self.overwrite
        )
        kind = "stereo pairs" if self.values.scene.ranges is None else "images with ranges"
        return Answer(
            f"{len(plan.frames)} {kind} with truth: {self.output}",
            paths=(self.output,),
            figures={"pairs": len(plan.frames)},
        )
