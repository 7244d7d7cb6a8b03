"""The README's animation: what the camera saw, the model at the estimated pose, the polhode as it is drawn.

    python -m polhode simulate lab/end_to_end/closed_tumble.yaml -o SEQ
    python -m polhode run --data SEQ -o RUN
    python -m lab.end_to_end.animation RUN SEQ -o docs/images/tumbling.webp

Left: the left image. Middle: RUN/mesh.ply, seen by the same camera from the pose that the run estimated.
Right: the ellipsoid of equal energy with lines of equal angular momentum, in the axes of the body, and the
path of the angular velocity on it. The sequence is read for its images alone.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from skimage.measure import find_contours
from tyro.conf import Positional, arg

from lab.command import command
from lab.presentation import subplots
from polhode.frontend.rectification import Crop, make_rectifier, rectified_pair, target_crop
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, inverse_pose
from polhode.mapping.visibility import MeshViewer
from polhode.records.dataset import open_sequence
from polhode.report.shape_figures import stretch_contrast, vertex_rgb
from polhode.run_directory.stored_run import StoredRun, read_stored_run
from polhode.runtime.errors import InputError

Picture = NDArray[np.uint8]
PANEL_PX, GAP_PX, CAPTION_PX = 290, 10, 30
FINE = 2
"""Panels are drawn so many times larger and shrunk, which smooths every edge."""
PAPER, INK = (13, 17, 23), (230, 237, 243)
PATH_RGB, BODY_RGB, LINE_RGB = (250, 170, 90), (74, 66, 122), (148, 141, 184)
MARGIN_PX = 6
"""Around the target in all frames."""
QUALITY = 55
"""Of WebP, 0 to 100."""
TITLES = ("left camera", "reconstructed model, estimated pose", "polhode: angular velocity in the body")
EYE_TILT_P = np.array([0.0, 0.35, 0.30])
"""From the middle of the path to the eye, so that ellipsoid and path look round."""


def main(
    run: Positional[Annotated[Path, arg(metavar="RUN", help="Folder of a run.")]],
    sequence: Positional[Annotated[Path, arg(metavar="SEQ", help="Its sequence.")]],
    output: Annotated[Path, arg(aliases=["-o"], metavar="WEBP", help="The animation.")],
    frames: Annotated[int | None, arg(help="So many of the first frames.")] = None,
) -> None:
    """Draw the frames and write them as an animation without end."""
    first, *rest = animation_frames(read_stored_run(run, run.name), sequence, frames)
    output.parent.mkdir(parents=True, exist_ok=True)
    first.save(output, save_all=True, append_images=rest, duration=100, loop=0, quality=QUALITY, method=6)
    print(f"{output}: {1 + len(rest)} frames, {output.stat().st_size / 1e6:.2f} MB")


def animation_frames(content: StoredRun, folder: Path, count: int | None) -> Iterator[Image.Image]:
    """One picture for each frame of the run. Raises InputError without an estimate or a surface."""
    if content.motion is None or content.surface is None:
        raise InputError(f"{content.name}: the animation needs a run with an estimate and a surface")
    images = open_sequence(folder)
    rectifier = make_rectifier(images.calibration)
    lefts = [rectified_pair(images, rectifier, k) for k in range(len(images) if count is None else count)]
    crop = common_crop([pair.mask_left for pair in lefts])
    path, side = content.motion.trajectory, FINE * PANEL_PX
    polhode = PolhodePanel(path.w_P, content.motion.moments, side)
    viewer = MeshViewer(content.surface.mesh)
    for k, pair in enumerate(lefts):
        model = surface_panel(content, viewer, k, rectifier.rig, crop, side)
        yield sheet([camera_panel(pair.left, crop, side), model, polhode.at(k)], TITLES, PANEL_PX)


def common_crop(masks: Sequence[Bools]) -> Crop:
    """The square that holds the target in every frame; the whole image where it is never seen."""
    crops = [crop for mask in masks if (crop := target_crop(mask, MARGIN_PX)) is not None]
    if not crops:
        height, width = masks[0].shape
        return square_around(Crop(0, 0, width, height))
    bounds = np.array([(crop.u0, crop.v0, crop.u1, crop.v1) for crop in crops])
    return square_around(Crop(*bounds[:, :2].min(axis=0).tolist(), *bounds[:, 2:].max(axis=0).tolist()))


def square_around(crop: Crop) -> Crop:
    """The square around a crop, which may reach beyond the image."""
    side = max(crop.width_px, crop.height_px)
    u0, v0 = (crop.u0 + crop.u1 - side) // 2, (crop.v0 + crop.v1 - side) // 2
    return Crop(u0, v0, u0 + side, v0 + side)


def camera_panel(left: Picture, crop: Crop, side: int) -> Picture:
    """A crop of an image (H, W), which may reach beyond it, enlarged to a square of ``side`` pixels."""
    pad = max(0, -crop.u0, -crop.v0, crop.u1 - left.shape[1], crop.v1 - left.shape[0])
    padded = cv2.copyMakeBorder(left, pad, pad, pad, pad, cv2.BORDER_CONSTANT)
    patch = padded[crop.v0 + pad : crop.v1 + pad, crop.u0 + pad : crop.u1 + pad]
    large = cv2.resize(patch, (side, side), interpolation=cv2.INTER_CUBIC)
    # Black sky takes the colour of the ground.
    return np.maximum(cv2.cvtColor(large, cv2.COLOR_GRAY2RGB), np.array(PAPER, dtype=np.uint8))


def surface_panel(
    content: StoredRun, viewer: MeshViewer, k: int, rig: RectifiedRig, crop: Crop, side: int
) -> Picture:
    """The mesh in its colours from the camera of frame k, lit a little from there; ``side`` pixels square."""
    assert content.motion is not None and content.tracks is not None and content.surface is not None
    mesh = content.surface.mesh
    X_RG = inverse_pose(content.tracks.X_NR[k]) @ content.motion.X_NG[k]
    place = (np.arange(side) + 0.5) * crop.width_px / side - 0.5
    view = viewer.perspective(rig, X_RG, crop.u0 + place, crop.v0 + place)
    color = view.values(stretch_contrast(vertex_rgb(mesh)) / 255.0)
    facing = np.abs(view.values(mesh.vertex_normals @ X_RG[2, :3]))[..., None]
    shaded = np.clip(255 * (0.06 + 0.94 * color**1.3) * (0.4 + 0.6 * facing), 0, 255)
    return np.where(view.hit[..., None], shaded, PAPER).astype(np.uint8)


class PolhodePanel:
    """The ellipsoid of equal energy with lines of equal angular momentum, and the path of the angular
    velocity on it up to a frame."""

    def __init__(self, w_P: Array, moments: Array, side: int) -> None:
        """w_P (F, 3) [rad/s] at the frames; moments (3,), in any unit; side [fine px]."""
        energy = 0.5 * float(np.mean(np.sum(w_P**2 * moments, axis=1)))
        semi = np.sqrt(2.0 * energy / moments)
        u, v = np.mgrid[0.0 : 2.0 * np.pi : 241j, 0.0 : np.pi : 121j]
        unit = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
        self._figure, self._axes = subplots(
            1, 1, (side / 100, side / 100), subplot_kw={"projection": "3d", "computed_zorder": False}
        )
        self._figure.set(dpi=100, facecolor=np.array(PAPER) / 255.0)
        self._axes.set_axis_off()
        self._axes.set(facecolor=np.array(PAPER) / 255.0, position=[-0.15, -0.15, 1.3, 1.3])
        self._axes.set_box_aspect(semi)
        rgb, surface = np.array(BODY_RGB) / 255.0, np.moveaxis(unit * semi, -1, 0)
        self._axes.plot_surface(*surface, color=rgb, rcount=120, ccount=120, linewidth=0)
        self._semi, self._drawn = semi, list[Any]()
        self._eye_P = w_P.mean(axis=0) / np.linalg.norm(w_P.mean(axis=0)) + EYE_TILT_P
        x, y, z = self._eye_P
        self._axes.view_init(np.rad2deg(np.arctan2(z, np.hypot(x, y))), np.rad2deg(np.arctan2(y, x)))
        # lines where h^2 / 2E takes evenly spaced values
        level = 14.0 * (unit**2 @ moments - moments[1]) / (moments[0] - moments[2])
        for value in range(int(np.ceil(level.min())), int(level.max()) + 1):
            for line in find_contours(level, value + 1e-6):
                around, down = np.pi / 120.0 * line.T
                ring = np.stack(
                    [np.cos(around) * np.sin(down), np.sin(around) * np.sin(down), np.cos(down)], 1
                )
                self._axes.plot(
                    *self._near_side(ring * semi).T, color=np.array(LINE_RGB) / 255.0, linewidth=0.7, zorder=5
                )
        self._path = w_P / np.sqrt(np.sum((w_P / semi) ** 2, axis=1, keepdims=True))

    def _near_side(self, p_P: Array) -> Array:
        """Points of the surface (n, 3), NaN on the far side."""
        near = (p_P / self._semi**2) @ self._eye_P > 0.0
        return np.where(near[:, None], 1.01 * p_P, np.nan)

    def at(self, k: int) -> Picture:
        """The panel at frame k: the path is bright up to there."""
        for line in self._drawn:
            line.remove()
        path, axes, color = self._near_side(self._path), self._axes, np.array(PATH_RGB) / 255.0
        self._drawn = [
            *axes.plot(*path.T, color=color, linewidth=1.0, zorder=10),
            *axes.plot(*path[: k + 1].T, color=color, linewidth=4.0, zorder=10),
            *axes.plot(*path[k : k + 1].T, "o", color="white", zorder=11),
        ]
        self._figure.canvas.draw()
        return np.asarray(self._figure.canvas.buffer_rgba())[..., :3].copy()


def sheet(panels: Sequence[Picture], titles: Sequence[str], side: int) -> Image.Image:
    """Panels beside each other, each shrunk to ``side`` pixels with its title below."""
    page = Image.new("RGB", (len(panels) * (side + GAP_PX) + GAP_PX, side + GAP_PX + CAPTION_PX), PAPER)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(side // 20)
    for column, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        left = GAP_PX + column * (side + GAP_PX)
        small = cv2.resize(panel, (side, side), interpolation=cv2.INTER_AREA)
        page.paste(Image.fromarray(small), (left, GAP_PX))
        middle = (left + side // 2, GAP_PX + side + CAPTION_PX // 2 - 2)
        draw.text(middle, title, INK, font, anchor="mm")
    return page


if __name__ == "__main__":
    command(main)
