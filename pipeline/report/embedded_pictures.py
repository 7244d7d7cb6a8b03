"""Pictures of a run as parts of the page: WebP, no larger than a screen shows them."""

import base64
import contextlib
import io
import math

from PIL import Image

from polhode.images import MAX_PIXELS
from polhode.pipeline.run_directory.stored_run import StoredPicture

SHEETS = ("landmarks.png", "mesh.png")
"""Pictures over the full width of the page; the files in RUN/pictures are sharper."""
MASKS = "masks.jpg"
SHEET_WIDTH_PX, SHEET_QUALITY, QUALITY = 1160, 45, 42


def embedded(picture: StoredPicture) -> tuple[str, str]:
    """Caption and content. What cannot be decoded stays as it is, for the browser to judge."""
    content = picture.content
    sheet = picture.name in SHEETS
    with contextlib.suppress(Exception):
        image = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
        if math.prod(image.size) <= MAX_PIXELS:
            image.thumbnail((SHEET_WIDTH_PX, SHEET_WIDTH_PX), Image.Resampling.LANCZOS)
            content = webp(image.convert("RGB"), SHEET_QUALITY if sheet else QUALITY)
    return picture.caption, data_uri(content)


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
