"""Before the stages of a run: its inputs are opened and judged, its folder begun."""

import logging
from dataclasses import replace
from pathlib import Path

from polhode.config import Config
from polhode.pipeline.checkout.checkout import warn_before_run
from polhode.pipeline.context import open_context
from polhode.pipeline.runner import Runner, Stopwatch
from polhode.pipeline.stream_results import Streamed
from polhode.run_directory import outputs
from polhode.run_directory.live_states import write_live_states
from polhode.run_directory.recording import recording_of
from polhode.run_directory.run_folder import RunFolder
from polhode.runtime.progress import Progress

_log = logging.getLogger(__name__)


def open_run(
    written: RunFolder, config: Config, sequence_folder: Path, progress: Progress, streamed: Streamed | None
) -> tuple[Runner, Streamed | None]:
    """What runs the stages, and of a stream what can be used again: nothing, if its masks were others."""
    clock = Stopwatch()
    with clock("frontend"):
        context = open_context(sequence_folder, config, progress)
    written.recording = recording_of(context.sequence)
    context = replace(context, stages=written.open_stages(sequence_folder, config.runtime))
    outputs.write_config(written.path, config)
    warn_before_run(context.sequence, context.rectifier)
    known = streamed
    if streamed is not None:
        # In its own frame G until the motion is found, should that fail.
        outputs.write_online_estimate(written.path, streamed.online)
        write_live_states(streamed.live, written.path)
        if not streamed.fits(context.sequence.timestamps_ns, context.rectifier):
            _log.info("all pairs together give other masks than those of the stream: nothing of it is used")
            known = None
    return Runner(context, clock), known
