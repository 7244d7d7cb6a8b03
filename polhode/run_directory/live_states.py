"""live_states.csv of a live run: one row per pair, as it was judged when it came."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from polhode.files.atomic import write_text

FILE = "live_states.csv"


class LiveRow(NamedTuple):
    """One pair."""

    timestamp_ns: int
    """The dataset's stamp, also where the estimate uses another time"""
    status: str
    reason: str
    """In words; empty: there is nothing to say"""
    frame_of_reference: str
    """The frame G of the state, by the time of the pair that fixes it; empty: there is none yet"""
    consistent: int
    """1: the pair continues the motion, 0: it does not, or no motion is known"""


def write_live_states(rows: Sequence[LiveRow], folder: Path) -> None:
    """RUN/live_states.csv."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(LiveRow._fields)
    lines.writerows(rows)
    write_text(folder / FILE, text.getvalue())
