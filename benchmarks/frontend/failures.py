"""Where a method fails: pairs of frames that share much light and whose motion is wrong, with their matches.

    python -m benchmarks.frontend.failures [--method surface] [--short] [-o PICTURE]

Scenes and methods are those of ``benchmarks.frontend.matching``. Of each scene the lit pair is drawn that
shares the largest lit area among those whose rotation is off by more than 2 degrees, or that have none;
scenes in which all are right are left out. Matches are green where both ends are the same place of the body,
and red elsewhere. The table names what is drawn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import Short, command
from benchmarks.frontend.matching import (
    ANGLES_DEG,
    ENOUGH_LIGHT_PX,
    GAPS,
    SURFACE,
    correct,
    motion_of,
    settings,
)
from benchmarks.frontend.scenes import UnseenScene, open_scene, render, scene_names
from benchmarks.presentation import print_table, save_figure, subplots
from polhode.config.frontend_settings import Frontend
from polhode.frontend.extract import extract_pair
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.features.surface_features import with_patch_size
from polhode.frontend.matching.methods import match_method
from polhode.frontend.rectification import Image, target_crop
from polhode.lie import Array
from polhode.records import Bools

WRONG_DEG = 2.0
COLUMNS = "scene | frames | turn [deg] | lit in both [px] | correct | matches | rotation error [deg]"
RIGHT, WRONG = "#2a9d5c", "#c8321f"
GAP_PX = 8
"""Between the two images."""
PER_ROW = 2


@dataclass(frozen=True)
class Failure:
    """A pair of frames whose motion is wrong."""

    scene: str
    frames: tuple[int, int]
    lit_px: int
    error_deg: float | None
    """None: no motion was found"""
    images: tuple[Image, Image]
    """Parts with the target"""
    ends_px: tuple[Array, Array]
    """(m, 2) places of the matches in the two parts"""
    right: Bools
    """(m,)"""


def main(
    method: Annotated[str, arg(help="As in benchmarks.frontend.matching.")] = SURFACE,
    short: Short = False,
    output: Annotated[
        Path | None, arg(aliases=["-o"], metavar="FILE", help="Picture of these pairs, PNG or WebP.")
    ] = None,
) -> None:
    """Print the table and draw the picture."""
    found = []
    for name in scene_names(short):
        render(name)
        failure = worst_pair(name, open_scene(name), settings(method))
        if failure is not None:
            found.append(failure)
    print_table(COLUMNS, map(_row, found))
    if output is not None:
        draw(found, output)


def worst_pair(name: str, scene: UnseenScene, config: Frontend) -> Failure | None:
    """The pair of a scene whose motion is wrong and that shares the most light; None: all are right."""
    config = with_patch_size(config, scene.sequence, scene.rectifier)
    pairs = [(i, i + gap) for gap in GAPS for i in range(len(scene) - gap)]
    lit = {pair: scene.lit_in_both(*pair) for pair in pairs}
    frames = [extract_pair(scene.pair(k), scene.rig, config) for k in range(len(scene))]
    # frames nearer to each other come first where they share as much
    for i, j in sorted(pairs, key=lambda pair: -lit[pair]):
        if lit[i, j] < ENOUGH_LIGHT_PX:
            return None
        failure = _judged(name, scene, frames, (i, j), lit[i, j], config)
        if failure.error_deg is None or failure.error_deg > WRONG_DEG:
            return failure
    return None


def _judged(
    name: str,
    scene: UnseenScene,
    frames: Sequence[StereoFeatures],
    pair: tuple[int, int],
    lit_px: int,
    config: Frontend,
) -> Failure:
    i, j = pair
    a, b = frames[i], frames[j]
    matches = match_method(config)(a, b)
    error_deg, _ = motion_of(scene, matches, a, b, i, j, config)
    p_G = [scene.body_points(k, frames[k].uvd_px)[0] for k in pair]
    images, ends = [], []
    for k, frame, side in zip(pair, (a, b), (0, 1), strict=True):
        shown = scene.pair(k)
        crop = target_crop(shown.mask_left)
        # a frame without a target has no light in common with another
        assert crop is not None
        images.append(shown.left[crop.v0 : crop.v1, crop.u0 : crop.u1])
        ends.append(frame.uvd_px[matches.features[:, side], :2] - [crop.u0, crop.v0])
    return Failure(
        name,
        pair,
        lit_px,
        error_deg,
        (images[0], images[1]),
        (ends[0], ends[1]),
        correct(matches, p_G[0], p_G[1]),
    )


def _row(failure: Failure) -> list[object]:
    i, j = failure.frames
    error = "no motion" if failure.error_deg is None else f"{failure.error_deg:.1f}"
    counts = (int(failure.right.sum()), len(failure.right))
    return [failure.scene, f"{i}, {j}", ANGLES_DEG[j - i], failure.lit_px, *counts, error]


def draw(failures: Sequence[Failure], path: Path) -> None:
    """One panel for each pair, the brightest of its pixels white."""
    rows = -(-len(failures) // PER_ROW) or 1
    figure, axes = subplots(rows, PER_ROW, (11, 3.2 * rows), layout="constrained", squeeze=False)
    for panel in axes.flat:
        panel.set_axis_off()
    for panel, failure in zip(axes.flat, failures, strict=False):
        _draw_pair(panel, failure)
    save_figure(figure, path, 100)


def _draw_pair(panel: Any, failure: Failure) -> None:
    first, second = failure.images
    shift = first.shape[1] + GAP_PX
    both = np.full((max(len(first), len(second)), shift + second.shape[1]), 255, np.uint8)
    for image, left in ((first, 0), (second, shift)):
        white = max(1.0, float(np.percentile(image, 99.5)))
        # the square root shows what is dark
        shown = np.sqrt(np.clip(image / white, 0.0, 1.0))
        both[: len(image), left : left + image.shape[1]] = np.round(255.0 * shown)
    panel.imshow(both, cmap="gray", vmin=0, vmax=255)
    for kind, colour in ((True, RIGHT), (False, WRONG)):
        for from_px, to_px in zip(*(ends[failure.right == kind] for ends in failure.ends_px), strict=True):
            panel.plot(
                [from_px[0], to_px[0] + shift], [from_px[1], to_px[1]], color=colour, linewidth=0.7, alpha=0.8
            )
    cells = _row(failure)
    error = cells[-1] if failure.error_deg is None else f"off by {cells[-1]} deg"
    panel.set_title(f"{cells[0]}, {cells[2]} deg: {cells[4]} of {cells[5]} correct, {error}", fontsize=9)


if __name__ == "__main__":
    command(main)
