"""``polhode run``: estimate motion, mass properties, map and mesh from a stereo sequence."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from polhode.cli.console import choose_progress
from polhode.cli.options import ConfigValues, Debug, Flag, OptionalConfigFile
from polhode.config import Config
from polhode.errors import RunFailure


@dataclass(frozen=True)
class RunCommand:
    """Estimate motion, mass properties, map and mesh of the target from a stereo sequence.

    Options with dots override the configuration; the help shows the default of each key, which applies where
    the file does not set it.
    """

    data: Annotated[Path, arg(metavar="SEQ")]
    """Folder of the stereo sequence (it contains mav0/)."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="RUN")]
    """Folder of the results, which is created."""
    config: OptionalConfigFile = None
    """Configuration, YAML. If it is left out the defaults apply, which fit any calibrated sequence."""
    overwrite: Flag = False
    """Replace an existing run."""
    debug: Debug = False
    values: ConfigValues = field(default_factory=Config)

    def execute(self) -> int:
        """Run the pipeline. Raises RunFailure when it did not reach a converged estimate."""
        from polhode.pipeline.run import run

        try:
            result = run(self.values, self.data, self.output, choose_progress(), overwrite=self.overwrite)
        except RunFailure as failure:
            raise RunFailure(f"{failure}; what was found: {self.output / 'report.html'}") from failure
        print(f"{result.sentence} {result.report_path}")
        if result.failure is not None:
            raise RunFailure(f"{result.failure}; the best motion found: {result.report_path}")
        return 0
