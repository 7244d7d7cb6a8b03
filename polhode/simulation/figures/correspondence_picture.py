"""Dense correspondences of two views as a file, and as a picture.

    python -m polhode.simulation.figures.correspondence_picture CONFIG --frames 3 7 --cameras 0 1 -o FILE.npz
        [--picture FILE.png]

The picture shows two images side by side; points of one colour are the same point of the body.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure

from polhode.runtime.drawing_style import default_style
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


@default_style
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
        for path in filter(None, (options.output, options.picture)):
            if not path.parent.is_dir():
                raise InputError(f"{path.parent} is not a folder: make it, or write {path.name} elsewhere")
        plan = plan_sequence(*load_scene(options.config))
        ends = list(zip(options.frames, options.cameras, strict=True))
        a, b = (view_of(plan, *end) for end in ends)
        found = dense_correspondence(RayCaster(plan.body), a, b)
        write_correspondence(options.output, a.camera.pixel_grid(), found)
        if options.picture:
            draw_correspondence(plan, ends, found).savefig(options.picture)
    except InputError as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")
    seen = int((found.reason != Reason.OFF_TARGET).sum())
    degrees = np.rad2deg(angle_between_views(a, b))
    print(
        f"{found.visible.sum()} of {seen} points are visible in both; the views are {degrees:.1f} deg apart"
    )


@default_style
def draw_correspondence(
    plan: SequencePlan, ends: Sequence[tuple[int, int]], found: Correspondence, points: int = 160
) -> Figure:
    """Images of ``ends``, (frame, camera) twice, around the target, with about that many points of ``found``.

    ``found`` is the dense field. Coloured: visible in both; grey rings: seen in the first only. Hue: by the
    direction from the middle of the points, paler towards it.
    """
    on_target = found.reason != Reason.OFF_TARGET
    step = max(1, round(np.sqrt(on_target.sum() / points)))
    chosen = np.zeros_like(on_target)
    chosen[step // 2 :: step, step // 2 :: step] = True
    chosen &= on_target
    uv_a, uv_b = plan.cameras[ends[0][1]].pixel_grid()[chosen], found.uv_b_px[chosen]
    visible = found.visible[chosen]
    offset = uv_a - uv_a.mean(axis=0)
    reach = np.linalg.norm(offset, axis=1)
    hue = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1.0
    colours = hsv_to_rgb(np.column_stack([hue, 0.35 + 0.65 * reach / reach.max(), np.ones(len(hue))]))
    figure = Figure(figsize=(10, 5), layout="constrained")
    renderer = FrameRenderer(plan)
    for place, (end, uv) in enumerate(zip(ends, (uv_a, uv_b), strict=True)):
        image, picture = renderer.render_image(*end)
        panel = figure.add_subplot(1, 2, place + 1)
        panel.imshow(image, cmap="gray", vmin=0, vmax=2**plan.scene.sensor.bits - 1)
        if place == 0:
            panel.scatter(uv[~visible, 0], uv[~visible, 1], s=14, facecolors="none", edgecolors="gray")
        seen = uv[visible]
        panel.scatter(seen[:, 0], seen[:, 1], s=18, c=colours[visible], edgecolors="black", linewidths=0.5)
        v, u = np.nonzero(picture.covered > 0)
        if len(u) > 0:
            panel.set(xlim=(u.min() - 8, u.max() + 8), ylim=(v.max() + 8, v.min() - 8))
        panel.set_axis_off()
    return figure


if __name__ == "__main__":
    main()
