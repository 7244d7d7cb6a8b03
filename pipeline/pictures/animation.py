"""Pictures in a row as MP4, for players, and as GIF, for any browser."""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from polhode.atomic import replaced, write_bytes
from polhode.pipeline.pictures.frame_drawing import GROUND, SIZE_PX, SPAN_GREY, Rgb, signed_colours

RATE_HZ = 10
GIF_SCALE, MOST_GIF_BYTES, FEWEST_GIF_FRAMES = 0.75, 3_000_000, 8
GREYS, HUES = 48, 64
"""Colours of the GIF: of the images, and of the difference."""


@contextmanager
def film(mp4: Path, gif: Path) -> Iterator[Callable[[Rgb], None]]:
    """Yields what adds a picture (H, W, 3) of ``SIZE_PX``; both files appear when the block ends well.

    Raises OSError when there is no encoder, ValueError when nothing was added.
    """
    small: list[Image.Image] = []
    palette = _palette()
    with replaced(mp4) as partial:
        # MPEG-4: OpenCV's packages bring no encoder of H.264, and theirs of VP9 takes 0.25 s a frame.
        code = cv2.VideoWriter.fourcc(*"mp4v")
        video = cv2.VideoWriter(str(partial), cv2.CAP_FFMPEG, code, RATE_HZ, SIZE_PX)
        if not video.isOpened():
            raise OSError("this OpenCV cannot write MPEG-4 video")

        def add(picture: Rgb) -> None:
            video.write(np.ascontiguousarray(picture[..., ::-1]))
            shrunk = cv2.resize(picture, None, fx=GIF_SCALE, fy=GIF_SCALE, interpolation=cv2.INTER_AREA)
            image = Image.fromarray(np.asarray(shrunk, dtype=np.uint8))
            small.append(image.quantize(palette=palette, dither=Image.Dither.NONE))

        try:
            yield add
        finally:
            video.release()
        if not small:
            raise ValueError("no frame to show")
        write_bytes(gif, _gif(small))


def _gif(images: Sequence[Image.Image]) -> bytes:
    """Every frame, or every second, fourth... one, so that the file stays small."""
    step = 1
    while True:
        content, kept = io.BytesIO(), images[::step]
        kept[0].save(
            content,
            "GIF",
            save_all=True,
            append_images=kept[1:],
            duration=step * 1000 // RATE_HZ,
            loop=0,
            optimize=False,
        )
        if content.tell() <= MOST_GIF_BYTES or len(kept) <= FEWEST_GIF_FRAMES:
            return content.getvalue()
        step *= 2


def _palette() -> Image.Image:
    """The colours that occur: those of the ground, greys, and the scale of the difference."""
    grey = np.repeat(np.linspace(0, 255, GREYS).round().astype(np.uint8)[:, None], 3, axis=1)
    hues = signed_colours(np.linspace(-SPAN_GREY, SPAN_GREY, HUES), np.ones(HUES, dtype=bool))
    image = Image.new("P", (1, 1))
    image.putpalette(np.vstack([[GROUND], grey, hues]).astype(np.uint8).tobytes())
    return image
