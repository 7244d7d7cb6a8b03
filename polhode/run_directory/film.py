"""The film of a run, model beside camera: where its panels lie, and what of it is stored for the report."""

import csv
import logging
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from polhode.files.foreign_files import MIB, MissingFile, read_bytes, read_text
from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)

FILM, FRAMES = "model.gif", "model.csv"
"""Files of RUN/pictures: the film, and a table of frames of which it shows every one, second, fourth..."""
PANEL_PX, GAP_PX, HEAD_PX, FOOT_PX = 320, 8, 30, 54
"""A picture of the film: three square panels in a row, space between them, titles above, numbers below."""
GIF_SCALE = 0.75
"""Of the GIF's pictures"""


@dataclass(frozen=True)
class StoredFilm:
    """The GIF, undecoded, and the frames of the run that it was made from."""

    gif: bytes
    frames: tuple[int, ...]
    sunlit: bool = False
    """Whether the Sun that was estimated lights the model"""


def read_film(folder: Path) -> StoredFilm | None:
    """The film in RUN/pictures; None: there is none, or it is damaged, of which a warning tells."""
    try:
        gif = read_bytes(folder / FILM, 16 * MIB, "a film")
        table = read_text(folder / FRAMES, 4 * MIB, "a table of the film's frames")
        rows = list(csv.DictReader(StringIO(table)))
        frames = tuple(int(row["frame"]) for row in rows)
    except MissingFile:
        return None
    except (InputError, KeyError, TypeError, ValueError) as error:
        _log.warning("%s is damaged and is left out: %s", folder / FILM, error)
        return None
    return StoredFilm(gif, frames, rows[0].get("sunlit") == "1") if frames else None
