"""Frames of the film, model beside camera, small enough that a page holds some dozens of them."""

import io
import logging
import math
from dataclasses import dataclass

from PIL import Image

from polhode.images import MAX_PIXELS
from polhode.pipeline.report.embedded_pictures import data_uri, webp
from polhode.pipeline.run_directory.film import GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX, StoredFilm

_log = logging.getLogger(__name__)

MAX_FRAMES = 30
MAX_BYTES = 240_000
"""Of all frames together, in the page"""
QUALITIES = (55, 42, 30, 18)
"""Of WebP: the first one with which the frames are small enough; else every second frame is left out."""


@dataclass(frozen=True)
class FilmFrame:
    """Camera, model and their difference in a row, without the words around them."""

    frame: int
    """of the run"""
    uri: str


def film_frames(film: StoredFilm | None, most_bytes: int = MAX_BYTES) -> list[FilmFrame]:
    """At most ``MAX_FRAMES`` frames, evenly chosen, together within ``most_bytes`` of the page.

    None where there is no film or it cannot be read.
    """
    if film is None:
        return []
    try:
        pictures = _panels(film)
    except Exception as error:  # noqa: BLE001  a damaged or a hostile file: the page goes on without it
        _log.warning("the film of the run is left out: %s: %s", type(error).__name__, error)
        return []
    while pictures:
        for quality in QUALITIES:
            frames = [
                FilmFrame(frame, data_uri(webp(picture, quality))) for frame, picture in pictures.items()
            ]
            if sum(len(each.uri) for each in frames) <= most_bytes:
                return frames
        pictures = dict(list(pictures.items())[::2]) if len(pictures) > 1 else {}
    return []


def _panels(film: StoredFilm) -> dict[int, Image.Image]:
    """The panels of the chosen pictures by the frame that they show. Raises ValueError."""
    with Image.open(io.BytesIO(film.gif), formats=("GIF",)) as gif:
        count = int(getattr(gif, "n_frames", 1))
        step = math.ceil(len(film.frames) / count)
        shown = film.frames[::step]
        width, height = gif.size
        if len(shown) != count or width * height > MAX_PIXELS:
            raise ValueError(f"it has {count} pictures of {width}x{height} for {len(film.frames)} frames")
        top = round(GIF_SCALE * HEAD_PX)
        box = (0, top, round(GIF_SCALE * (3 * PANEL_PX + 2 * GAP_PX)), top + round(GIF_SCALE * PANEL_PX))
        most = min(count, MAX_FRAMES)
        chosen = [round(k * (count - 1) / max(most - 1, 1)) for k in range(most)]
        found = {}
        for k in chosen:
            gif.seek(k)
            found[shown[k]] = gif.convert("RGB").crop(box)
    return found
