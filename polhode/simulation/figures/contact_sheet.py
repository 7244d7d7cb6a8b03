"""A contact sheet of scenes: frames of each, rendered for it.

``python -m polhode.simulation.figures.contact_sheet configs/ts38.yaml configs/scenes -o SHEET.png``

The scene of a simulated sequence is its scene.yaml.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.progress import Progress as RichProgress

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array, Ints, inverse_pose, transform_points
from polhode.runtime.errors import InputError
from polhode.runtime.processes import in_order
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import SequencePlan, load_scene, plan_sequence

Grey = NDArray[np.uint8]
Box = tuple[float, float, float, float]
TILES, TILE_PX, GAP_PX, COLUMNS = 4, (188, 141), 3, 2
BETWEEN_PX, MARGIN_PX, CAPTION_PX, BELOW_PX = 30, 24, 28, 20
WIDE = TILES * TILE_PX[0] + (TILES - 1) * GAP_PX
"""Width of a strip [px]."""


def scene_files(sources: Sequence[Path]) -> list[Path]:
    """Configurations, given one by one or by their folder, in order. Raises InputError if there are none."""
    files: list[Path] = []
    for source in sources:
        found = sorted(source.glob("*.yaml")) if source.is_dir() else [source]
        if not found:
            raise InputError(f"{source} has no configuration (*.yaml)")
        files += found
    return files


def strip_of(file: Path) -> Image.Image:
    """The caption of a scene above its frames, rendered for it."""
    plan = plan_sequence(*load_scene(file))
    scene, frames, renderer = plan.scene, frames_to_show(plan), FrameRenderer(plan)
    strip = Image.new("L", (WIDE, CAPTION_PX + TILE_PX[1]), 14)
    for place, (k, box) in enumerate(zip(frames, boxes_around(plan, frames), strict=True)):
        grey = (renderer.render_image(k, 0)[0] >> (scene.sensor.bits - 8)).astype(np.uint8)
        tile = Image.fromarray(grey).resize(TILE_PX, Image.Resampling.LANCZOS, box=box)
        strip.paste(tile, (place * (TILE_PX[0] + GAP_PX), CAPTION_PX))
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    bold, plain = (ImageFont.truetype(str(fonts / name), size)
                   for name, size in (("DejaVuSans-Bold.ttf", 16), ("DejaVuSans.ttf", 13)))  # fmt: skip
    draw, words = ImageDraw.Draw(strip), list(describe(scene))
    draw.text((0, 17), file.stem, fill=235, font=bold, anchor="ls")
    start = draw.textlength(file.stem, font=bold) + 14
    # As many of the labels as fit.
    while len(words) > 1 and start + draw.textlength("  ·  ".join(words), font=plain) > WIDE:
        words.pop()
    draw.text((start, 17), "  ·  ".join(words), fill=150, font=plain, anchor="ls")
    return strip


def frames_to_show(plan: SequencePlan) -> list[int]:
    """Frames evenly over the sequence, or through an eclipse, or while the target is out of view."""
    there, eclipse = np.array(plan.frames), plan.scene.light.eclipse
    gone = np.flatnonzero([len(_in_view(plan, k, 200)[1]) == 0 for k in plan.frames])
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


def _in_view(plan: SequencePlan, k: int, points: int | None = None) -> tuple[Array, Ints]:
    """Pixels (n, 2) of the target's vertices in the left image, and their indices; of about that many."""
    vertices_G = np.asarray(plan.body.mesh.vertices)
    if points is not None:
        vertices_G = vertices_G[:: 1 + len(vertices_G) // points]
    return plan.cameras[0].project_visible(
        transform_points(inverse_pose(plan.X_NC[k]) @ plan.target.X_NG[k], vertices_G)
    )


def boxes_around(plan: SequencePlan, frames: Sequence[int], margin: float = 0.12) -> list[Box]:
    """Parts of the left image (left, top, right, bottom) with the target, of one size and the tiles' shape.

    The whole image, if the target leaves it or the Earth is in the background.
    """
    size = np.array([plan.cameras[0].width_px, plan.cameras[0].height_px], dtype=np.float64)
    shape = np.array(TILE_PX) / TILE_PX[0]
    largest = float((0.5 * size / shape).min())
    middles, reach = [0.5 * size] * len(frames), largest
    views = [_in_view(plan, k) for k in frames]
    whole = all(len(seen) == len(plan.body.mesh.vertices) for _, seen in views)
    if whole and not plan.scene.background.earth:
        middles = [0.5 * (uv.min(axis=0) + uv.max(axis=0)) for uv, _ in views]
        reach = max(float(((0.5 + margin) * np.ptp(uv, axis=0) / shape).max()) for uv, _ in views)
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
    asked = {
        "drifting camera": scene.inspector.profile == "drift",
        "circling camera": scene.inspector.profile == "circle",
        "approaching camera": scene.inspector.profile == "approach",
        "guided camera": scene.inspector.profile == "waypoints",
        "camera in its dead band": scene.inspector.profile == "rest" and scene.inspector.moves,
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


def draw(sources: list[Path], workers: int = 1) -> Image.Image:
    """The sheet of scenes, two per row, rendered in several processes. Raises InputError."""
    files = scene_files(sources)
    with RichProgress() as progress:
        rendered = in_order(strip_of, files, workers)
        strips = list(progress.track(rendered, len(files), description="scenes"))
    columns, rows = min(COLUMNS, len(strips)), -(-len(strips) // COLUMNS)
    tall = CAPTION_PX + TILE_PX[1] + BELOW_PX
    width = 2 * MARGIN_PX + columns * WIDE + (columns - 1) * BETWEEN_PX
    sheet = Image.new("L", (width, 2 * MARGIN_PX + rows * tall - BELOW_PX), 14)
    for index, strip in enumerate(strips):
        row, column = divmod(index, COLUMNS)
        sheet.paste(strip, (MARGIN_PX + column * (WIDE + BETWEEN_PX), MARGIN_PX + row * tall))
    return sheet


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


if __name__ == "__main__":
    sys.exit(main())
