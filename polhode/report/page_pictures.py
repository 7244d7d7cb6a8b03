"""Pictures and film of a run as parts of the page: WebP, as large as a screen shows them, within a size."""

import base64
import contextlib
import io
import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from PIL import Image

from polhode.files.images import MAX_PIXELS
from polhode.run_directory.film import GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX, StoredFilm
from polhode.run_directory.stored_run import StoredPicture

SHEETS = ("mesh.png",)
"""Pictures over the full width of the page; the files in RUN/pictures are sharper."""
SHARPNESS = ((1160, 45, 42), (1160, 30, 25), (720, 25, 20))
"""Width [px], quality of a sheet, quality of another picture: the first one with which all fit is taken."""
MAX_FILM_FRAMES = 30
MAX_FILM_BYTES = 240_000
"""Of all frames of the film together, in the page"""
FILM_QUALITIES = (55, 42, 30, 18)
"""Of WebP: the first one with which the frames of the film fit is taken."""

_log = logging.getLogger(__name__)
Item = TypeVar("Item")
Level = TypeVar("Level")


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture as the page holds it."""

    uri: str
    name: str = ""
    caption: str = ""
    frame: int = -1
    """of the run: of a picture of the film, camera, model and their difference in a row"""


def embed_pictures(pictures: Sequence[StoredPicture], most_bytes: int) -> list[EmbeddedPicture]:
    """The pictures, together within ``most_bytes`` of the page; of too many, evenly chosen ones."""

    def embed(picture: StoredPicture, sharpness: tuple[int, int, int]) -> EmbeddedPicture:
        width_px, of_sheet, of_other = sharpness
        content = picture.content
        # What cannot be decoded stays as it is, for the browser to judge.
        with contextlib.suppress(Exception):
            image = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
            if math.prod(image.size) <= MAX_PIXELS:
                image.thumbnail((width_px, width_px), Image.Resampling.LANCZOS)
                content = _webp(image.convert("RGB"), of_sheet if picture.name in SHEETS else of_other)
        return EmbeddedPicture(_data_uri(content), picture.name, picture.caption)

    found = _fitting(pictures, SHARPNESS, embed, most_bytes)
    if len(found) < len(pictures):
        _log.info("the report shows %d of %d pictures", len(found), len(pictures))
    return found


def film_frames(film: StoredFilm | None, most_bytes: int = MAX_FILM_BYTES) -> list[EmbeddedPicture]:
    """At most ``MAX_FILM_FRAMES`` frames, evenly chosen, together within ``most_bytes`` of the page.

    None where there is no film or it cannot be read.
    """
    if film is None:
        return []
    panels = []
    try:
        with Image.open(io.BytesIO(film.gif), formats=("GIF",)) as gif:
            count = int(getattr(gif, "n_frames", 1))
            shown = film.frames[:: math.ceil(len(film.frames) / count)]
            width, height = gif.size
            if len(shown) != count or width * height > MAX_PIXELS:
                raise ValueError(f"it has {count} pictures of {width}x{height} for {len(film.frames)} frames")
            top, side = round(GIF_SCALE * HEAD_PX), round(GIF_SCALE * PANEL_PX)
            box = (0, top, round(GIF_SCALE * (3 * PANEL_PX + 2 * GAP_PX)), top + side)
            most = min(count, MAX_FILM_FRAMES)
            for k in (round(n * (count - 1) / max(most - 1, 1)) for n in range(most)):
                gif.seek(k)
                panels.append((shown[k], gif.convert("RGB").crop(box)))
    except Exception as error:  # noqa: BLE001  a damaged or a hostile file: the page goes on without it
        _log.warning("the film of the run is left out: %s: %s", type(error).__name__, error)
        return []

    def embed(item: tuple[int, Image.Image], quality: int) -> EmbeddedPicture:
        return EmbeddedPicture(_data_uri(_webp(item[1], quality)), frame=item[0])

    return _fitting(panels, FILM_QUALITIES, embed, most_bytes)


def _fitting(
    items: Sequence[Item],
    levels: Sequence[Level],
    embed: Callable[[Item, Level], EmbeddedPicture],
    most_bytes: int,
) -> list[EmbeddedPicture]:
    """All items at the first level at which they fit; where none is enough, every second, fourth... item."""
    while items:
        for level in levels:
            found = [embed(item, level) for item in items]
            if sum(len(each.uri) for each in found) <= most_bytes:
                return found
        items = items[::2] if len(items) > 1 else []
    return []


def _webp(image: Image.Image, quality: int) -> bytes:
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=quality, method=4)
    return stream.getvalue()


def _data_uri(image: bytes) -> str:
    kind = {b"\x89PNG": "png", b"RIFF": "webp"}.get(image[:4], "jpeg")
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
