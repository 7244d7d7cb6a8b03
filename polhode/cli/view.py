"""``polhode view``: a run or a sequence in Rerun, in a window or as a file."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional
from polhode.runtime.errors import InputError


class ViewCommand(Command):
    """Show a run or a sequence in Rerun: images, tracks, target and camera in 3D, the growing mesh, plots.

    Needs the library rerun-sdk; polhode doctor tells how to install it. Of a sequence it shows images, masks,
    rig and poses of the inspector. Truth is not shown.
    """

    shown: Annotated[Path, Positional("RUN|SEQ")]
    """Folder of a run, or of a sequence (it contains mav0/)."""
    data: Annotated[Path | None, Named("SEQ")] = None
    """With RUN: the sequence that it was made from, for the images."""
    save: Annotated[Path | None, Named("FILE")] = None
    """Write the recording to FILE.rrd and open no window; "rerun FILE.rrd" shows it. An earlier recording is
    replaced, any other file is not."""

    def execute(self) -> Answer:
        """Check what is asked for, then show it."""
        from polhode.runtime.optional_parts import require_part

        is_run, is_sequence = ((self.shown / name).exists() for name in ("summary.json", "mav0"))
        if not (is_run or is_sequence):
            raise InputError(f"{self.shown}: neither a run (summary.json) nor a sequence (mav0/)")
        if self.data is not None and not is_run:
            raise InputError("--data goes with a run: a sequence has its images")
        require_part("rerun", "polhode view")
        from polhode.runtime.console import choose_progress
        from polhode.viewer.show_run import show_run, show_sequence
        from polhode.viewer.target import require_target

        target = require_target(self.save, window=self.save is None)
        if is_run:
            show_run(self.shown, self.data, target, choose_progress())
        else:
            show_sequence(self.shown, target, choose_progress())
        if self.save is None:
            return Answer("Rerun's window shows it.")
        return Answer(f"Recording: {self.save}", paths=(self.save,))
