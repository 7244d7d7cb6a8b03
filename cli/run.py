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
    """Replace an existing run as soon as the new one is complete. Only files of the run are replaced; others
    in its folder stay. A failed run replaces only a failed one: else it is written to RUN.failed."""
    even_if_failed: Flag = False
    """With --overwrite: a failed run, too, replaces one that did not fail."""
    debug: Debug = False
    values: ConfigValues = field(default_factory=Config)

    def execute(self) -> int:
        """Run the pipeline. Raises RunFailure when it did not reach a converged estimate."""
        from polhode.pipeline.run import run

        result = run(
            self.values,
            self.data,
            self.output,
            choose_progress(),
            overwrite=self.overwrite,
            even_if_failed=self.even_if_failed,
        )
        print(f"{result.sentence} {result.report_path}")
        note = f"; {result.note}" if result.note else ""
        if result.failure is not None:
            raise RunFailure(f"{result.failure}; the best motion found: {result.report_path}{note}")
        return 0
