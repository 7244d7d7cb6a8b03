"""Pictures of a run as parts of the page: WebP, as large as a screen shows them, within a size."""

import base64
import contextlib
import io
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image

from polhode.images import MAX_PIXELS
from polhode.pipeline.run_directory.stored_run import StoredPicture

SHEETS = ("landmarks.png", "mesh.png")
"""Pictures over the full width of the page; the files in RUN/pictures are sharper."""
MASKS = "masks.jpg"
SHEET_WIDTH_PX = 1160

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sharpness:
    """Of embedded pictures."""

    width_px: int
    sheet_quality: int
    quality: int


SHARPNESS = (Sharpness(SHEET_WIDTH_PX, 45, 42), Sharpness(SHEET_WIDTH_PX, 30, 25), Sharpness(720, 25, 20))
"""The first one with which all pictures are small enough; if none is, every second picture is left out."""


@dataclass(frozen=True)
class EmbeddedPicture:
    """A picture as the page holds it."""

    name: str
    caption: str
    uri: str


def embedded(pictures: Sequence[StoredPicture], most_bytes: int) -> list[EmbeddedPicture]:
    """The pictures, together within ``most_bytes`` of the page; of too many, evenly chosen ones."""
    kept = list(pictures)
    while kept:
        for sharpness in SHARPNESS:
            found = [EmbeddedPicture(each.name, each.caption, _uri(each, sharpness)) for each in kept]
            if sum(len(each.uri) for each in found) <= most_bytes:
                if len(kept) < len(pictures):
                    _log.info("the report shows %d of %d pictures", len(kept), len(pictures))
                return found
        kept = kept[::2] if len(kept) > 1 else []
    return []


def _uri(picture: StoredPicture, sharpness: Sharpness) -> str:
    """What cannot be decoded stays as it is, for the browser to judge."""
    content = picture.content
    with contextlib.suppress(Exception):
        image = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
        if math.prod(image.size) <= MAX_PIXELS:
            image.thumbnail((sharpness.width_px, sharpness.width_px), Image.Resampling.LANCZOS)
            quality = sharpness.sheet_quality if picture.name in SHEETS else sharpness.quality
            content = webp(image.convert("RGB"), quality)
    return data_uri(content)


def webp(image: Image.Image, quality: int) -> bytes:
    """The same bytes for the same picture."""
    stream = io.BytesIO()
    image.save(stream, "WEBP", quality=quality, method=4)
    return stream.getvalue()


def data_uri(image: bytes) -> str:
    """An address that is its own content."""
    kinds = {b"\x89PNG": "png", b"RIFF": "webp"}
    kind = kinds.get(image[:4], "jpeg")
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
