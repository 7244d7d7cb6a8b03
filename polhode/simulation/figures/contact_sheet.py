"""A contact sheet of scenes: frames of each, rendered for it.

``python -m polhode.simulation.figures.contact_sheet configs/ts38.yaml configs/scenes -o SHEET.png``

The scene of a simulated sequence is its scene.yaml.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.progress import Progress as RichProgress

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
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
            raise InputError(f"{source} has no configuration (*.yaml)")
        files += found
    return files


def strip_of(file: Path) -> Strip:
    """Plan the scene of a configuration and render its frames for the sheet."""
    return strip_of_plan(file.stem, plan_sequence(*load_scene(file)))


def strip_of_plan(name: str, plan: SequencePlan) -> Strip:
    """Render the frames of a planned scene for the sheet."""
    frames = frames_to_show(plan)
    renderer = FrameRenderer(plan)
    images = [renderer.render_image(k, 0)[0] for k in frames]
    boxes = boxes_around(plan, frames)
    tiles = [tile_of(image, plan.scene, box) for image, box in zip(images, boxes, strict=True)]
    return Strip(name, describe(plan.scene), tuple(tiles))


def frames_to_show(plan: SequencePlan) -> list[int]:
    """Frames evenly over the sequence, or through an eclipse, or while the target is out of view."""
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


def tile_of(image: NDArray[np.uint8] | NDArray[np.uint16], scene: Scene, box: Box) -> Grey:
    """A part of an image, as a tile of the sheet."""
    grey = (image >> (scene.sensor.bits - 8)).astype(np.uint8)
    return np.asarray(Image.fromarray(grey).resize(TILE_PX, Image.Resampling.LANCZOS, box=box))


def main(words: Sequence[str] | None = None) -> int:
    """Write the sheet of the command line; returns 2 if its arguments are wrong."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.simulation.figures.contact_sheet", description=__doc__
    )
    what = "configurations with a scene, and folders of them"
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
    """The sheet of scenes, rendered in several processes. Raises InputError."""
    files, strips = scene_files(sources), []
    with RichProgress() as progress:
        for strip in progress.track(in_order(strip_of, files, workers), len(files), description="scenes"):
            strips.append(strip)
    return draw_sheet(strips)


if __name__ == "__main__":
    sys.exit(main())
