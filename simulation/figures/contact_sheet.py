"""A contact sheet of one sequence, or of scenes that are rendered for it.

``python -m polhode.simulation.figures.contact_sheet SEQ -o SHEET.png``
``python -m polhode.simulation.figures.contact_sheet configs/ts38.yaml configs/scenes -o SHEET.png``
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.progress import Progress as RichProgress

from polhode.config.scene import Scene
from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.lie import inverse_pose, transform_points
from polhode.processes import in_order
from polhode.records import Bools
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, load_scene, plan_sequence

Grey = NDArray[np.uint8]
Box = tuple[float, float, float, float]

TILES = 4
TILE_PX = (188, 141)
GAP_PX = 3
COLUMNS = 2
BETWEEN_PX = 30
MARGIN_PX = 24
CAPTION_PX = 28
BELOW_PX = 20
BACK, NAME, WORDS = 14, 235, 150
"""Grey values of paper, scene's name, and the words beside it."""

_CAMERA = {
    "drift": "drifting camera",
    "circle": "circling camera",
    "approach": "approaching camera",
    "waypoints": "guided camera",
}


@dataclass(frozen=True)
class Strip:
    """One scene of the sheet."""

    name: str
    words: tuple[str, ...]
    tiles: tuple[Grey, ...]
    """TILES images of TILE_PX"""


def scene_files(sources: Sequence[Path]) -> list[Path]:
    """Configurations, given one by one or by their folder, in order. Raises InputError if there are none."""
    files: list[Path] = []
    for source in sources:
        found = sorted(source.glob("*.yaml")) if source.is_dir() else [source]
        if not found:
            raise InputError(f"{source} holds no configuration (*.yaml) and no dataset (mav0/)")
        files += found
    return files


def strips_of(files: Sequence[Path], workers: int, advance: Callable[[], None]) -> list[Strip]:
    """Render the scenes, several at once; ``advance`` is called after each. Raises InputError."""
    strips: list[Strip] = []
    for strip in in_order(strip_of, files, workers):
        strips.append(strip)
        advance()
    return strips


def strip_of(file: Path) -> Strip:
    """Plan the scene of a configuration and render its frames for the sheet."""
    plan = plan_sequence(*load_scene(file))
    frames = frames_to_show(plan)
    renderer = FrameRenderer(plan)
    images = [renderer.render_image(k, 0)[0] for k in frames]
    boxes = boxes_around(plan, frames)
    tiles = [_tile(image, plan.scene, box) for image, box in zip(images, boxes, strict=True)]
    return Strip(file.stem, describe(plan.scene), tuple(tiles))


def frames_to_show(plan: SequencePlan) -> list[int]:
    """Frames evenly over the sequence; or through an eclipse; or as the target leaves the view and
    returns.
    """
    there, eclipse = np.array(plan.frames), plan.scene.light.eclipse
    gone = np.flatnonzero([_share_in_view(plan, k) == 0.0 for k in plan.frames])
    if eclipse.duration_s > 0:
        end_s = eclipse.start_s + eclipse.duration_s
        dusk_s, dawn_s = eclipse.start_s - 0.5 * eclipse.ramp_s, end_s + 0.5 * eclipse.ramp_s
        wanted_s = [0.5 * eclipse.start_s, dusk_s, 0.5 * (eclipse.start_s + end_s), dawn_s]
        t_s = np.array([plan.time_s(k) for k in plan.frames])
        places = [int(np.abs(t_s - wanted).argmin()) for wanted in wanted_s]
    elif len(gone) > 0 and gone[0] > 0:
        leaves, back = gone[0] - 1, gone[-1]
        places = [leaves // 2, leaves, (leaves + back) // 2 + 1, (back + len(there)) // 2]
    else:
        places = [int((i + 0.5) / TILES * len(there)) for i in range(TILES)]
    return [int(there[place]) for place in places]


def _share_in_view(plan: SequencePlan, k: int) -> float:
    """Share of the target's vertices in the left image, of 200 of them."""
    vertices_G = plan.body.mesh.vertices[:: 1 + len(plan.body.mesh.vertices) // 200]
    p_C = transform_points(inverse_pose(plan.X_NC[k]) @ plan.target.X_NG[k], vertices_G)
    return len(plan.cameras[0].project_visible(p_C)[1]) / len(p_C)


def boxes_around(plan: SequencePlan, frames: Sequence[int], margin: float = 0.12) -> list[Box]:
    """Parts of the left image (left, top, right, bottom) with the target, of one size and the tiles' shape.

    The whole image, if the target leaves it or the Earth is in the background.
    """
    camera, vertices_G = plan.cameras[0], plan.body.mesh.vertices
    size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    shape = np.array(TILE_PX) / TILE_PX[0]
    largest = float((0.5 * size / shape).min())
    middles, reach = [], 0.0
    for k in frames:
        p_C = transform_points(inverse_pose(plan.X_NC[k]) @ plan.target.X_NG[k], vertices_G)
        uv, seen = camera.project_visible(p_C)
        if len(seen) < len(p_C) or plan.scene.background.earth:
            middles, reach = [0.5 * size] * len(frames), largest
            break
        middles.append(0.5 * (uv.min(axis=0) + uv.max(axis=0)))
        reach = max(reach, float(((0.5 + margin) * np.ptp(uv, axis=0) / shape).max()))
    reach = min(reach, largest)
    corners = [np.clip(middle, reach * shape, size - reach * shape) for middle in middles]
    return [(*(middle - reach * shape), *(middle + reach * shape)) for middle in corners]


def describe(scene: Scene) -> tuple[str, ...]:
    """Short labels: the target, its spin, and special features of the scene."""
    body, motion, light = scene.body, scene.motion, scene.light
    family = "mesh" if body.path is None else Path(body.path).stem
    words = [f"{body.family.replace('_', ' ')} {body.size_m:g} m" if body.family != "mesh" else family]
    rpm = float(np.linalg.norm(motion.spin_rpm))
    words.append(f"{rpm:.2g} rpm" if rpm >= 1 else f"{6 * rpm:.2g}°/s" if rpm > 0 else "no spin")
    if scene.inspector.profile in _CAMERA:
        words.append(_CAMERA[scene.inspector.profile])
    elif scene.inspector.moves:
        words.append("camera in its dead band")
    asked = {
        f"{light.eclipse.duration_s:g} s of eclipse": light.eclipse.duration_s > 0,
        "known pushes": bool(motion.pushes),
        "losing energy": motion.energy_loss > 0,
        "toed-in, distorted rig": any(scene.rig.right_rotation_deg) or any(scene.rig.distortion),
        "Earth behind": scene.background.earth,
        "stars": scene.background.stars,
        f"{scene.sensor.bits} bits": scene.sensor.bits > 8,
        "lamp": light.lamp > 0,
    }
    return (*words, *(word for word, holds in asked.items() if holds))


def draw_sheet(strips: Sequence[Strip]) -> Image.Image:
    """All scenes on a dark sheet, two per row, each with a caption above its frames."""
    wide = TILES * TILE_PX[0] + (TILES - 1) * GAP_PX
    tall = CAPTION_PX + TILE_PX[1] + BELOW_PX
    rows = -(-len(strips) // COLUMNS)
    columns = min(COLUMNS, len(strips))
    width = 2 * MARGIN_PX + columns * wide + (columns - 1) * BETWEEN_PX
    sheet = Image.new("L", (width, 2 * MARGIN_PX + rows * tall - BELOW_PX), BACK)
    for index, strip in enumerate(strips):
        row, column = divmod(index, COLUMNS)
        left, top = MARGIN_PX + column * (wide + BETWEEN_PX), MARGIN_PX + row * tall
        _write_caption(ImageDraw.Draw(sheet), strip, left, top, wide)
        for place, tile in enumerate(strip.tiles):
            sheet.paste(Image.fromarray(tile), (left + place * (TILE_PX[0] + GAP_PX), top + CAPTION_PX))
    return sheet


def _write_caption(draw: ImageDraw.ImageDraw, strip: Strip, left: int, top: int, wide: int) -> None:
    """The name, and beside it as many of the labels as fit."""
    bold, plain = _font("DejaVuSans-Bold.ttf", 16), _font("DejaVuSans.ttf", 13)
    baseline = top + 17
    draw.text((left, baseline), strip.name, fill=NAME, font=bold, anchor="ls")
    start = left + draw.textlength(strip.name, font=bold) + 14
    words = list(strip.words)
    while len(words) > 1 and start + draw.textlength("  ·  ".join(words), font=plain) > left + wide:
        words.pop()
    draw.text((start, baseline), "  ·  ".join(words), fill=WORDS, font=plain, anchor="ls")


def _font(name: str, size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), size)


def _tile(image: NDArray[np.uint8] | NDArray[np.uint16], scene: Scene, box: Box) -> Grey:
    grey = (image >> (scene.sensor.bits - 8)).astype(np.uint8)
    return np.asarray(Image.fromarray(grey).resize(TILE_PX, Image.Resampling.LANCZOS, box=box))


def contact_sheet(folder: Path, columns: int = 4, rows: int = 2, width_px: int = 240) -> Grey:
    """Left images evenly over the sequence, cropped to the lit part, row by row (h, w).

    Raises InputError: the folder is no sequence.
    """
    sequence = open_sequence(folder)
    chosen = np.linspace(0, len(sequence.timestamps_ns) - 1, columns * rows).round().astype(int)
    images = np.stack([sequence.read_pair(int(k)).left for k in chosen])
    top, bottom, left, right = _lit_box(images)
    height_px = round(width_px * (bottom - top) / (right - left))
    tiles = [
        np.asarray(Image.fromarray(image[top:bottom, left:right]).resize((width_px, height_px)))
        for image in images
    ]
    return np.vstack([np.hstack(tiles[r * columns : (r + 1) * columns]) for r in range(rows)])


def _lit_box(images: Grey, above_dn: int = 20, margin_px: int = 8) -> tuple[int, int, int, int]:
    """Rows and columns (top, bottom, left, right) that contain all lit pixels of all images (n, h, w)."""
    lit: Bools = np.max(images, axis=0) > above_dn
    height, width = lit.shape
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    if len(rows) == 0:
        return 0, height, 0, width
    return (
        max(int(rows[0]) - margin_px, 0),
        min(int(rows[-1]) + 1 + margin_px, height),
        max(int(columns[0]) - margin_px, 0),
        min(int(columns[-1]) + 1 + margin_px, width),
    )


def main(words: Sequence[str] | None = None) -> int:
    """Write the sheet of the command line; returns 2 if its arguments are wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.simulation.figures.contact_sheet", description=__doc__
    )
    what = "a dataset; or configurations with a scene, and folders of them"
    parser.add_argument("sources", type=Path, nargs="+", metavar="SOURCE", help=what)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="SHEET.png")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="parallel processes")
    arguments = parser.parse_args(words)
    try:
        # Before rendering, so that no work is lost.
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        draw(arguments.sources, arguments.workers).save(arguments.output, optimize=True)
    except InputError as error:
        print(f"contact_sheet: error: {error}", file=sys.stderr)
        return 2
    return 0


def draw(sources: list[Path], workers: int = 1) -> Image.Image:
    """The sheet of one dataset, or of scenes. Raises InputError."""
    if len(sources) == 1 and (sources[0] / "mav0").is_dir():
        return Image.fromarray(contact_sheet(sources[0]))
    files = scene_files(sources)
    with RichProgress() as progress:
        task = progress.add_task("scenes", total=len(files))
        strips = strips_of(files, workers, lambda: progress.advance(task))
    return draw_sheet(strips)


if __name__ == "__main__":
    sys.exit(main())
