"""A mission flown: simulated, run with configs/default.yaml, judged by the truth."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from lab.missions.draw import Mission
from lab.missions.judgement import judgement
from polhode.config.loader import load_config
from polhode.pipeline.run import run
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent
from polhode.simulation.dataset.sequence import plan_sequence, write_sequence

PICTURES = {"pictures.views": False, "pictures.animation": False, "mapping.levels": (), "runtime.workers": 1}
"""What no judgement needs"""


def fly(flown: Mission, folder: Path, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    """The row of a mission; its sequence and run remain in ``folder`` and are used again.

    settings: beside those of the default configuration.
    """
    sequence, out = folder / "sequence", folder / "run"
    if not (sequence / "mav0").is_dir():
        write_sequence(plan_sequence(flown.scene, flown.seed), sequence, Silent())
    if not (out / "summary.json").is_file():
        # summary.json says why it failed
        with suppress(RunFailure):
            run(load_config(None, PICTURES | (settings or {})), sequence, out, Silent())
    return judgement(out, sequence, flown.scene.body.size_m)
