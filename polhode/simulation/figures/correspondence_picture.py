"""Dense correspondences of two views as a file, and as a picture.

    python -m polhode.simulation.figures.correspondence_picture CONFIG --frames 3 7 --cameras 0 1 -o FILE.npz
        [--picture FILE.png]

The picture shows two images side by side; points of one colour are the same point of the body.
"""

import argparse
import colorsys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from polhode.files.images import to_grey
from polhode.geometry.lie import Array, Bools, Ints
from polhode.runtime.errors import InputError
from polhode.simulation.dataset.correspondence import (
    Correspondence,
    Reason,
    angle_between_views,
    dense_correspondence,
    view_of,
    write_correspondence,
)
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, load_scene, plan_sequence
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.stereo_camera import Image as Grey

Rgb = NDArray[np.uint8]
UNSEEN = (110, 110, 110)
ENLARGED, MARGIN_PX = 2, 8
SHIFT = 4
"""Circles are positioned to 1/2^SHIFT of a pixel."""


def main(words: Sequence[str] | None = None) -> None:
    """Write the files of the command line, and print how many points are visible in both views."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.simulation.figures.correspondence_picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", type=Path, metavar="CONFIG", help="configuration with a scene, YAML")
    parser.add_argument(
        "--frames", type=int, nargs=2, required=True, metavar=("A", "B"), help="counted from 0"
    )
    parser.add_argument("--cameras", type=int, nargs=2, default=(0, 0), metavar=("A", "B"), help="0: left")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.npz")
    parser.add_argument("--picture", type=Path, metavar="FILE.png", help="both images with points in colour")
    options = parser.parse_args(words)
    try:
        print(_execute(options))
    except InputError as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")


def _execute(options: argparse.Namespace) -> str:
    for path in filter(None, (options.output, options.picture)):
        if not path.parent.is_dir():
            raise InputError(f"{path.parent} is not a folder: make it, or write {path.name} elsewhere")
    plan = plan_sequence(*load_scene(options.config))
    a, b = (view_of(plan, k, c) for k, c in zip(options.frames, options.cameras, strict=True))
    found = dense_correspondence(RayCaster(plan.body), a, b)
    write_correspondence(options.output, a.camera.pixel_grid(), found)
    if options.picture:
        ends = list(zip(options.frames, options.cameras, strict=True))
        draw_correspondence(plan, ends, found).save(options.picture, optimize=True)
    seen = int((found.reason != Reason.OFF_TARGET).sum())
    degrees = np.rad2deg(angle_between_views(a, b))
    return (
        f"{found.visible.sum()} of {seen} points are visible in both; the views are {degrees:.1f} deg apart"
    )


def draw_correspondence(
    plan: SequencePlan, ends: Sequence[tuple[int, int]], found: Correspondence, points: int = 160
) -> Image.Image:
    """Images of ``ends``, (frame, camera) twice, around the target, with about that many points of ``found``.

    ``found`` is the dense field. Coloured: visible in both; grey rings: seen in the first only.
    """
    on_target = found.reason != Reason.OFF_TARGET
    step = max(1, round(np.sqrt(on_target.sum() / points)))
    chosen = np.zeros_like(on_target)
    chosen[step // 2 :: step, step // 2 :: step] = True
    chosen &= on_target
    uv_a, uv_b = plan.cameras[ends[0][1]].pixel_grid()[chosen], found.uv_b_px[chosen]
    colours, visible = _colours(uv_a), found.visible[chosen]
    renderer = FrameRenderer(plan)
    images = [renderer.render_image(*end) for end in ends]
    corners_px, size_px = _boxes([picture.covered > 0 for _, picture in images])
    panels = []
    for k, (uv, shown) in enumerate([(uv_a, np.ones_like(visible)), (uv_b, visible)]):
        panel = _panel(images[k][0], plan.scene.sensor.bits, corners_px[k], size_px)
        at = ENLARGED * (uv - corners_px[k] + 0.5) - 0.5
        for n in np.flatnonzero(shown):
            _circle(panel, at[n], colours[n] if visible[n] else UNSEEN, filled=bool(visible[n]))
        panels.append(panel)
    gap = np.full((panels[0].shape[0], 4, 3), 60, np.uint8)
    return Image.fromarray(np.hstack([panels[0], gap, panels[1]]))


def _boxes(covered: list[Bools]) -> tuple[list[Ints], tuple[int, int]]:
    """Upper left corners (u, v) and the common size (w, h) of boxes around the target in each image."""
    height, width = covered[0].shape
    sides = [[np.flatnonzero(mask.any(axis=axis)) for axis in (0, 1)] for mask in covered]
    spans = [[(int(s[0]), int(s[-1])) if len(s) else (0, 0) for s in side] for side in sides]
    size = [max(span[k][1] - span[k][0] for span in spans) + 1 + 2 * MARGIN_PX for k in (0, 1)]
    w, h = min(size[0], width), min(size[1], height)
    return [
        np.array([np.clip(sum(u) // 2 - w // 2, 0, width - w), np.clip(sum(v) // 2 - h // 2, 0, height - h)])
        for u, v in spans
    ], (w, h)


def _panel(image: Grey, bits: int, corner_px: Ints, size_px: tuple[int, int]) -> Rgb:
    """A box of the image, enlarged, grey as RGB (h, w, 3)."""
    (left, top), (w, h) = corner_px, size_px
    grey = to_grey(image, bits)[top : top + h, left : left + w]
    large = cv2.resize(grey, (ENLARGED * w, ENLARGED * h), interpolation=cv2.INTER_LINEAR)
    return np.repeat(large[..., None], 3, axis=2).astype(np.uint8)


def _colours(uv_px: Array) -> list[tuple[int, int, int]]:
    """Hue by the direction from the centre of the points (n, 2), paler towards it."""
    offset = uv_px - uv_px.mean(axis=0)
    hue = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1.0
    reach = np.linalg.norm(offset, axis=1)
    pure = 0.35 + 0.65 * reach / reach.max(initial=1.0)
    rgb = [colorsys.hsv_to_rgb(h, s, 1.0) for h, s in zip(hue, pure, strict=True)]
    return [(round(255 * r), round(255 * g), round(255 * b)) for r, g, b in rgb]


def _circle(image: Rgb, uv_px: Array, colour: tuple[int, int, int], filled: bool) -> None:
    at = np.rint(uv_px * 2**SHIFT).astype(int).tolist()
    if filled:
        cv2.circle(image, at, 4 * 2**SHIFT, (0, 0, 0), -1, cv2.LINE_AA, SHIFT)
    cv2.circle(image, at, 3 * 2**SHIFT, colour, -1 if filled else 1, cv2.LINE_AA, SHIFT)


if __name__ == "__main__":
    main()
