"""Masks that were found before a background that is not dark: their outlines on some of the left images."""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.background.find_masks import doubtful_frames
from polhode.frontend.rectification import Image, Rectifier
from polhode.geometry.lie import Bools
from polhode.records.dataset import StereoSequence

SHOWN = 8
"""Frames, spread over the sequence; doubtful ones take the place of those next to them."""
COLUMNS, WIDTH_PX, GAP_PX = 4, 320, 4
OUTLINE_BGR, DOUBTFUL_BGR = (80, 220, 90), (60, 80, 245)

Bgr = NDArray[np.uint8]


def mask_strip(sequence: StereoSequence, rectifier: Rectifier) -> tuple[bytes, str] | None:
    """JPEG of some left images with the target's outline, and its caption; None: no masks were found."""
    if rectifier.found is None:
        return None
    doubtful = set(doubtful_frames(rectifier.found))
    tiles = []
    for k in frames_to_show(sorted(rectifier.found.quality), doubtful):
        mask = rectifier.found.mask(k, 0)
        image = rectifier(sequence.read_left(k)[0], 0)
        if mask is not None:
            tiles.append(draw_outline(image, mask, f"frame {k}", k in doubtful))
    columns = min(COLUMNS, len(tiles))
    framed = [np.pad(each, ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255) for each in tiles]
    framed += [np.full_like(framed[0], 255)] * (-len(framed) % columns)
    rows = [np.hstack(framed[k : k + columns]) for k in range(0, len(framed), columns)]
    words = (
        "Masks that were found, since the background is not dark: "
        f"{len(tiles)} of {len(rectifier.found.quality)} frames. Doubtful (red): {len(doubtful)}."
    )
    return jpeg(np.asarray(np.vstack(rows)[:-GAP_PX, :-GAP_PX])), words


def jpeg(picture: Bgr) -> bytes:
    """The file; the same bytes for the same picture (H, W, 3)."""
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()


def frames_to_show(frames: list[int], doubtful: set[int]) -> list[int]:
    """Some frames spread over the sequence; half of the places may go to doubtful ones."""

    def spread(frames: list[int], count: int) -> list[int]:
        if len(frames) <= count:
            return frames
        return [frames[n] for n in np.linspace(0, len(frames) - 1, count).round().astype(int).tolist()]

    odd = spread(sorted(doubtful), SHOWN // 2)
    rest = [k for k in spread(frames, SHOWN) if k not in odd]
    return sorted([*odd, *spread(rest, SHOWN - len(odd))])


def draw_outline(image: Image, mask: Bools, words: str, doubtful: bool) -> Bgr:
    """An image (H, W) at the width of a tile, its background dimmed, with the outline of its mask."""
    size = (WIDTH_PX, max(1, round(image.shape[0] * WIDTH_PX / image.shape[1])))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    inside = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) >= 0.5
    tile = cv2.cvtColor(np.where(inside, small, 0.55 * small).astype(np.uint8), cv2.COLOR_GRAY2BGR)
    colour = DOUBTFUL_BGR if doubtful else OUTLINE_BGR
    around, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(tile, around, -1, colour, 1)
    cv2.putText(tile, words, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)
    return np.asarray(tile, dtype=np.uint8)
