"""``polhode checkout``: what a user should know of a sequence before a run."""

from pathlib import Path
from typing import Annotated

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positional


class CheckoutCommand(Command):
    """Check a sequence before a run: rig, range, turn between frames, exposure, times, background, cost.

    Examines some 20 pairs, spread over the sequence. Writes checkout.json and the page checkout.html; prints
    what does not pass. The exit code is 0 whatever the checks say: the status is in the file.
    """

    sequence: Annotated[Path, Positional("SEQ")]
    """Folder of the stereo sequence (it contains mav0/)."""
    output: Annotated[Path, Named("DIR", "-o")]
    """Folder of the results: a new or empty one, or that of an earlier call, whose files are replaced."""
    rig: Annotated[Path | None, Named("RIG")] = None
    """Check with this calibration instead: a folder with cam0/sensor.yaml and cam1/sensor.yaml."""

    def execute(self) -> Answer:
        """Check, write and print."""
        from polhode.pipeline.checkout.checkout import checkout
        from polhode.pipeline.checkout.page import checkout_folder, format_checkout, write_checkout
        from polhode.runtime.console import choose_progress

        with checkout_folder(self.output) as place:
            done = checkout(self.sequence, self.rig, choose_progress())
            write_checkout(done, self.sequence.resolve().name, place)
        page, table = self.output / "checkout.html", self.output / "checkout.json"
        return Answer(
            f"Checkout: {page}",
            format_checkout(done),
            paths=(page, table),
            figures=done.result.model_dump(by_alias=True),
        )
