"""One frame of the animation as a picture: camera, model, difference, and what they say in numbers."""

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from polhode.atomic import replaced, write_bytes
from polhode.lie import Array
from polhode.pipeline.pictures.model_comparison import FrameComparison

Rgb = NDArray[np.uint8]

PANEL_PX, GAP_PX, HEAD_PX, FOOT_PX = 320, 8, 30, 54
SIZE_PX = (3 * PANEL_PX + 2 * GAP_PX, HEAD_PX + PANEL_PX + FOOT_PX)
"""(width, height), both even, as video codecs want them."""
SPAN_GREY = 64.0
"""Differences of this size and more have the full colour [grey levels]."""
STEPS = 64
"""Colours on either side of zero."""
BAR_PX, BAR_INSET_PX = 140, 36
_LINES = (HEAD_PX + PANEL_PX + 16, HEAD_PX + PANEL_PX + 38)
MINUS = "\u2212"
GROUND, TEXT, SOFT = (16, 21, 27), (236, 240, 244), (150, 162, 174)
DARKER, EQUAL, BRIGHTER = (60, 140, 255), (48, 54, 60), (255, 140, 40)
"""Image darker than the model, equal, brighter: blue to orange, which colour-blind readers distinguish."""
TITLES = ("left camera, rectified", "model at the estimated pose", "difference: camera minus model")


def draw_frame(comparison: FrameComparison, n_frames: int) -> Rgb:
    """(H, W, 3) of ``SIZE_PX``."""
    width, height = SIZE_PX
    canvas = np.empty((height, width, 3), dtype=np.uint8)
    canvas[:] = GROUND
    grey = (comparison.image, np.round(comparison.model).astype(np.uint8))
    panels = [*(np.repeat(_enlarged(each)[..., None], 3, axis=2) for each in grey)]
    panels.append(_enlarged(signed_colours(comparison.difference, comparison.seen | comparison.modelled)))
    for column, panel in enumerate(panels):
        left = column * (PANEL_PX + GAP_PX)
        canvas[HEAD_PX : HEAD_PX + PANEL_PX, left : left + PANEL_PX] = panel
    _draw_bar(canvas)
    page = Image.fromarray(canvas)
    _write(ImageDraw.Draw(page), comparison, n_frames)
    return np.asarray(page, dtype=np.uint8)


def signed_colours(difference: Array, shown: NDArray[np.bool_]) -> Rgb:
    """Signed grey levels (...) as colours (..., 3): blue negative, orange positive, ground if not shown."""
    step = np.round((difference / SPAN_GREY).clip(-1.0, 1.0) * STEPS).astype(np.int64)
    return _scale()[np.where(shown, step + STEPS, -1)]


def caption(comparison: FrameComparison) -> str:
    """The numbers of a frame in a line."""
    return (
        f"frame {comparison.frame}, {comparison.time_s:.1f} s: overlap of the silhouettes "
        f"{_number(comparison.overlap, 2)}, difference {_number(comparison.rms_grey, 1)} grey levels rms"
    )


def _write(draw: ImageDraw.ImageDraw, comparison: FrameComparison, n_frames: int) -> None:
    for column, title in enumerate(TITLES):
        draw.text((_left(column), HEAD_PX / 2), title, TEXT, _font(15), anchor="lm")
    pose = "" if comparison.measured else ", pose from the dynamics"
    fit = f"gain {comparison.gain:.2f}, offset {round(comparison.offset):+d}".replace("-", MINUS)
    lines = (
        (0, 0, f"frame {comparison.frame} of {n_frames}{pose}"),
        (0, 1, f"{comparison.time_s:.2f} s"),
        (1, 0, f"overlap of silhouettes (IoU): {_number(comparison.overlap, 2)}"),
        (1, 1, f"covered by the model: {_number(comparison.covered, 2)}"),
        (2, 1, f"rms {_number(comparison.rms_grey, 1)}; {fit}"),
    )
    for column, line, words in lines:
        draw.text((_left(column), _LINES[line]), words, TEXT, _font(15), anchor="lm")
    middle = _left(2) + BAR_INSET_PX + BAR_PX / 2
    for share, words in ((-1, f"{MINUS}{SPAN_GREY:.0f}"), (1, f"+{SPAN_GREY:.0f} grey levels")):
        place = (middle + share * (BAR_PX / 2 + 6), _LINES[0])
        draw.text(place, words, SOFT, _font(13), anchor="rm" if share < 0 else "lm")


def _left(column: int) -> int:
    return column * (PANEL_PX + GAP_PX) + 8


@cache
def _scale() -> Rgb:
    """(2 STEPS + 2, 3) from blue to orange; the last row is the ground."""
    share = np.linspace(-1.0, 1.0, 2 * STEPS + 1)[:, None]
    ends = np.where(share < 0.0, np.array(DARKER, dtype=np.float64), np.array(BRIGHTER, dtype=np.float64))
    mixed = np.array(EQUAL) + np.abs(share) * (ends - np.array(EQUAL))
    return np.vstack([np.round(mixed), np.array(GROUND)]).astype(np.uint8)


def _draw_bar(canvas: Rgb) -> None:
    """The scale of the difference below its panel."""
    left, top = _left(2) + BAR_INSET_PX, _LINES[0] - 4
    colours = signed_colours(np.linspace(-SPAN_GREY, SPAN_GREY, BAR_PX), np.ones(BAR_PX, dtype=bool))
    canvas[top : top + 9, left : left + BAR_PX] = colours


def _enlarged(picture: Rgb) -> Rgb:
    larger = cv2.resize(picture, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_LINEAR)
    return np.asarray(larger, dtype=np.uint8)


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "none"


@cache
def _font(size_px: int) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings along: the same picture on every machine."""
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf", size_px)


RATE_HZ = 10
GIF_SCALE, MAX_GIF_BYTES, MIN_GIF_FRAMES = 0.75, 3_000_000, 8
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
        if content.tell() <= MAX_GIF_BYTES or len(kept) <= MIN_GIF_FRAMES:
            return content.getvalue()
        step *= 2


def _palette() -> Image.Image:
    """The colours that occur: those of the ground, greys, and the scale of the difference."""
    grey = np.repeat(np.linspace(0, 255, GREYS).round().astype(np.uint8)[:, None], 3, axis=1)
    hues = signed_colours(np.linspace(-SPAN_GREY, SPAN_GREY, HUES), np.ones(HUES, dtype=bool))
    image = Image.new("P", (1, 1))
    image.putpalette(np.vstack([[GROUND], grey, hues]).astype(np.uint8).tobytes())
    return image
