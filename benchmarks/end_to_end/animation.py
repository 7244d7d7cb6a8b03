"""The README's animation: what the camera saw, the model at the estimated pose, the polhode as it is drawn.

    python -m polhode simulate benchmarks/end_to_end/closed_tumble.yaml -o SEQ
    python -m polhode run --data SEQ -o RUN
    python -m benchmarks.end_to_end.animation RUN SEQ -o docs/images/tumbling.webp

Left: the left image. Middle: RUN/mesh.ply, seen by the same camera from the pose that the run estimated.
Right: the ellipsoid of equal energy with lines of equal angular momentum, in the axes of the body, and the
path of the angular velocity on it. The sequence is read for its images alone.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.end_to_end.readme_picture import (
    FINE,
    INK,
    PAPER,
    Picture,
    energy_ellipsoid,
    square_around,
    surface_panel,
)
from polhode.dataset import StereoSequence, open_sequence
from polhode.errors import InputError
from polhode.frontend.rectification import Crop, Rectifier, make_rectifier, rectified_pair, target_crop
from polhode.lie import Array
from polhode.pipeline.run_directory.stored_run import StoredRun, read_stored_run

PANEL_PX, GAP_PX, CAPTION_PX = 290, 10, 30
MARGIN_PX = 6
"""Around the target in all frames"""
QUALITY = 55
"""Of WebP, 0 to 100"""
TITLES = ("left camera", "reconstructed model, estimated pose", "polhode: angular velocity in the body")
PATH_RGB, TIP_RGB = np.array((250, 170, 90)), (255, 250, 225)
TILT_P = np.array([0.0, 0.35, 0.30])
"""From the middle of the path to the eye, so that ellipsoid and path look round"""
FADED = 0.35
"""Of the path's brightness: where it has not come to yet, or is on the far side"""


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    sequence: Positional[Annotated[Path, arg(metavar="SEQ", help="Its sequence.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="WEBP", help="The animation.")],
    frame_ms: Annotated[int, arg(help="Time for which a frame is shown [ms].")] = 100,
) -> None:
    """Draw all frames and write them as an animation without end."""
    frames = list(animation_frames(read_stored_run(run, run.name), open_sequence(sequence)))
    output.parent.mkdir(parents=True, exist_ok=True)
    first, *rest = frames
    first.save(
        output, save_all=True, append_images=rest, duration=frame_ms, loop=0, quality=QUALITY, method=6
    )
    print(f"{output}: {len(frames)} frames, {output.stat().st_size / 1e6:.2f} MB")


def animation_frames(content: StoredRun, images: StereoSequence) -> Iterator[Image.Image]:
    """One picture for each frame of the run. Raises InputError without an estimate or a surface."""
    if content.motion is None or content.tracks is None or content.surface is None:
        raise InputError(f"{content.name}: the animation needs a run with an estimate and a surface")
    rectifier = make_rectifier(images.calibration)
    crop = common_crop(images, rectifier)
    path, side = content.motion.trajectory, FINE * PANEL_PX
    polhode = PolhodePanel(path.w_P, content.motion.moments, side)
    for k in range(len(images)):
        left = camera_panel(rectified_pair(images, rectifier, k).left, crop)
        yield _sheet([left, surface_panel(content, k, rectifier.rig, crop, side), polhode.at(k)])


def common_crop(images: StereoSequence, rectifier: Rectifier) -> Crop:
    """The square that holds the target in every frame; the whole image where it is never seen."""
    pairs = (rectified_pair(images, rectifier, k) for k in range(len(images)))
    crops = [crop for pair in pairs if (crop := target_crop(pair.mask_left, MARGIN_PX)) is not None]
    if not crops:
        rig = rectifier.rig
        return square_around(Crop(0, 0, rig.width_px, rig.height_px))
    bounds = np.array([(crop.u0, crop.v0, crop.u1, crop.v1) for crop in crops])
    return square_around(Crop(*bounds[:, :2].min(axis=0).tolist(), *bounds[:, 2:].max(axis=0).tolist()))


def camera_panel(left: Picture, crop: Crop) -> Picture:
    """A crop of an image (H, W), which may reach beyond it, at the size of a fine panel."""
    side = FINE * PANEL_PX
    v, u = (np.arange(start, stop) for start, stop in ((crop.v0, crop.v1), (crop.u0, crop.u1)))
    inside = ((v >= 0) & (v < left.shape[0]))[:, None] & ((u >= 0) & (u < left.shape[1]))
    patch = np.where(
        inside, left[np.ix_(v.clip(0, left.shape[0] - 1), u.clip(0, left.shape[1] - 1))], 0
    ).astype(np.uint8)
    large = cv2.resize(patch, (side, side), interpolation=cv2.INTER_CUBIC)
    # Black sky takes the colour of the ground.
    return np.maximum(cv2.cvtColor(large, cv2.COLOR_GRAY2RGB), np.array(PAPER, dtype=np.uint8))


class PolhodePanel:
    """The ellipsoid, drawn once, and the path on it up to a frame."""

    def __init__(self, w_P: Array, moments: Array, side: int) -> None:
        """w_P (F, 3) [rad/s] at the frames; moments (3,), in any unit; side [fine px]."""
        middle = w_P.mean(axis=0) / np.linalg.norm(w_P.mean(axis=0))
        self.ellipsoid = energy_ellipsoid(w_P, moments, middle + TILT_P, side)
        self.places, self.in_front = self.ellipsoid.project(w_P)

    def at(self, k: int) -> Picture:
        """The panel at frame k."""
        canvas = self.ellipsoid.picture.copy()
        for n, (a, b) in enumerate(zip(self.places[:-1].tolist(), self.places[1:].tolist(), strict=True)):
            bright = n < k and self.in_front[n]
            color = (PATH_RGB * (1.0 if bright else FADED) + (0.0 if bright else 60.0)).astype(int).tolist()
            cv2.line(canvas, a, b, color, (3 if bright else 1) * FINE, cv2.LINE_AA)
        cv2.circle(canvas, self.places[k].tolist(), 5 * FINE, TIP_RGB, -1, cv2.LINE_AA)
        return canvas


def _sheet(panels: list[Picture]) -> Image.Image:
    width = len(panels) * PANEL_PX + (len(panels) + 1) * GAP_PX
    sheet = Image.new("RGB", (width, PANEL_PX + GAP_PX + CAPTION_PX), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for column, (panel, title) in enumerate(zip(panels, TITLES, strict=True)):
        left = GAP_PX + column * (PANEL_PX + GAP_PX)
        small = cv2.resize(panel, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_AREA)
        sheet.paste(Image.fromarray(small), (left, GAP_PX))
        middle = (left + PANEL_PX // 2, GAP_PX + PANEL_PX + CAPTION_PX // 2 - 2)
        draw.text(middle, title, INK, font, anchor="mm")
    return sheet


if __name__ == "__main__":
    command(main)
