"""The model through the left camera at the estimated poses, beside the images: thesis figure 6-30, as a film.

What differs should be geometry and light, so gain and offset of the brightness are fitted in each frame. The
difference is the image minus the model; its root mean square is taken where both show the target.
"""

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from polhode.files.atomic import replaced, write_bytes
from polhode.frontend.rectification import Rectifier, rectified_left
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose, transform_points
from polhode.mapping.finishing.albedo import smooth_normals
from polhode.mapping.visibility import Caster, MeshViewer
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.report.shape_figures import vertex_rgb
from polhode.run_directory.film import FOOT_PX, GAP_PX, GIF_SCALE, HEAD_PX, PANEL_PX

Rgb = NDArray[np.uint8]

SIZE_PX = (3 * PANEL_PX + 2 * GAP_PX, HEAD_PX + PANEL_PX + FOOT_PX)
"""(width, height), both even, as video codecs require."""
SPAN_GREY = 64.0
"""Differences of at least this size have the full colour [grey levels]."""
STEPS = 64
"""Colours on either side of zero."""
MINUS = "\u2212"
GROUND, TEXT, SOFT = (16, 21, 27), (236, 240, 244), (150, 162, 174)
DARKER, EQUAL, BRIGHTER = (60, 140, 255), (48, 54, 60), (255, 140, 40)
"""Image darker than the model, equal, brighter: blue to orange, which colour-blind readers distinguish."""
RATE_HZ = 10
MAX_GIF_BYTES, MIN_GIF_FRAMES = 3_000_000, 8


@dataclass(frozen=True)
class FrameComparison:
    """One frame: squares of n x n pixels about the target."""

    frame: int
    time_s: float
    measured: bool
    """whether the frame has measurements; else its pose is bridged by the dynamics"""
    image: NDArray[np.uint8]
    model: Array
    """brightness of the model [grey levels], 0 where there is none"""
    seen: Bools
    """the target's silhouette in the image"""
    modelled: Bools
    """the model's"""
    gain: float
    offset: float
    """grey levels"""

    @property
    def difference(self) -> Array:
        """Image minus model after gain and offset [grey levels]; 0 outside both silhouettes."""
        fitted = np.where(self.modelled, (self.gain * self.model + self.offset).clip(0.0, 255.0), 0.0)
        return np.where(self.seen | self.modelled, self.image - fitted, 0.0)

    @property
    def rms_grey(self) -> float:
        """Root mean square of the difference where both show the target; NaN where they nowhere do."""
        both = self.seen & self.modelled
        return float(np.sqrt(np.mean(np.square(self.difference[both])))) if both.any() else float("nan")

    @property
    def overlap(self) -> float:
        """Intersection over union of the silhouettes; NaN where both are empty."""
        return _share(self.seen & self.modelled, self.seen | self.modelled)

    @property
    def covered(self) -> float:
        """Share of the image's silhouette that the model covers: in shadows, only lit parts are seen."""
        return _share(self.seen & self.modelled, self.seen)


def _share(part: Bools, whole: Bools) -> float:
    count = int(whole.sum())
    return int(part.sum()) / count if count else float("nan")


def chosen_frames(n_frames: int, most: int) -> list[int]:
    """At most ``most`` frames, spread evenly, first and last among them."""
    frames = np.linspace(0, n_frames - 1, min(n_frames, most)).round().astype(int)
    return [int(k) for k in np.unique(frames)]


def compare_frames(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    mesh: trimesh.Trimesh,
    frames: list[int],
    sun_N: Array | None = None,
    caster: Caster | None = None,
) -> Iterator[FrameComparison]:
    """The model beside the image, frame by frame. The mesh has faces.

    With sun_N (3,), the unit vector towards the Sun, the brightness of the mesh is taken as its albedo and
    shaded by Lambert's law; ``caster``, which knows the mesh, adds the shadows that it casts on itself, and
    its normals are then those by which its albedo was found.
    """
    rig, viewer = rectifier.rig, MeshViewer(mesh, caster)
    brightness = vertex_rgb(mesh).astype(np.float64).mean(axis=1)
    X_RG = inverse_pose(tracks.X_NR) @ estimate.X_NG
    corners, side = _window(np.asarray(mesh.vertices), rig, X_RG[frames])
    measured = np.bincount(tracks.frame, minlength=tracks.n_frames) > 0
    vertices_G = np.asarray(mesh.vertices, dtype=np.float64)
    has_shadows = caster is not None and sun_N is not None
    normals = smooth_normals(mesh) if has_shadows else np.asarray(mesh.vertex_normals)
    for k, corner in zip(frames, corners, strict=True):
        left, mask = rectified_left(sequence, rectifier, k)
        u, v, image, seen = _cut(left, mask, corner, side)
        view = viewer.perspective(rig, X_RG[k], u, v)
        inside = ((v >= 0) & (v <= rig.height_px - 1))[:, None] & ((u >= 0) & (u <= rig.width_px - 1))
        modelled = view.hit & inside
        model = np.where(modelled, view.values(brightness), 0.0)
        if sun_N is not None:
            sun_G = estimate.X_NG[k, :3, :3].T @ sun_N
            light = (view.values(normals) @ sun_G).clip(0.0, 1.0)
            if caster is not None:
                light[view.hit] *= caster.lit_by(sun_G, view.values(vertices_G)[view.hit])
            # 3 % of the Sun's light reaches the target from elsewhere.
            model *= 0.03 + light
        fit = fit_brightness(image[seen & modelled], model[seen & modelled])
        time_s = float(tracks.time_s[k])
        yield FrameComparison(k, time_s, bool(measured[k]), image, model, seen, modelled, *fit)


def fit_brightness(image: NDArray[np.uint8], model: Array) -> tuple[float, float]:
    """Gain and offset of least squares, image ~ gain model + offset (n,); the gain is never negative."""
    if len(model) == 0:
        return 1.0, 0.0
    grey = image.astype(np.float64)
    spread = float(np.var(model))
    gain = float(np.mean((model - model.mean()) * (grey - grey.mean()))) / spread if spread > 0.0 else 1.0
    gain = max(gain, 0.0)
    return gain, float(grey.mean() - gain * model.mean())


def _window(vertices: Array, rig: RectifiedRig, X_RG: Array) -> tuple[Ints, int]:
    """First column and row (F, 2) and edge [px] of a square that follows the model and contains all of it.

    The edge is 12 % over what the model needs in any frame. Frames without the model's middle in view follow,
    but do not count for the size.
    """
    some = vertices[:: max(1, len(vertices) // 3000)]
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    size = np.array([rig.width_px, rig.height_px])
    most = int(size.max())
    centres, half = np.tile([rig.cx_px, rig.cy_px], (len(X_RG), 1)), 8.0
    for k, X in enumerate(X_RG):
        p_R = transform_points(X, np.vstack([middle, some]))
        if p_R[0, 2] <= 0.0:
            continue
        centres[k] = rig.project(p_R[0])[:2]
        if p_R[:, 2].min() > 0.0 and np.all((centres[k] >= 0.0) & (centres[k] < size)):
            half = max(half, float(np.abs(rig.project(p_R)[:, :2] - centres[k]).max()))
    side = int(min(np.ceil(2.0 * 1.12 * half), most))
    return np.round(centres - 0.5 * (side - 1)).clip(-4 * most, 4 * most).astype(np.int64), side


def _cut(
    image: NDArray[np.uint8], mask: Bools, corner: Ints, side: int
) -> tuple[Array, Array, NDArray[np.uint8], Bools]:
    """Columns and rows of the cut-out, its image and its mask; black beyond the image's border.

    At most 256 pixels wide: of a larger window, fewer rays are cast.
    """
    count = min(side, 256)
    u0, v0 = (int(start) for start in corner)
    place = np.asarray((np.arange(count) + 0.5) * side / count - 0.5, dtype=np.float64)
    grey, target = np.zeros((2, side, side), dtype=np.uint8)
    height, width = image.shape
    rows, columns = slice(max(v0, 0), min(v0 + side, height)), slice(max(u0, 0), min(u0 + side, width))
    if rows.start < rows.stop and columns.start < columns.stop:
        there = (slice(rows.start - v0, rows.stop - v0), slice(columns.start - u0, columns.stop - u0))
        grey[there], target[there] = image[rows, columns], 255 * mask[rows, columns]
    if count < side:
        shrunk = (cv2.resize(each, (count, count), interpolation=cv2.INTER_AREA) for each in (grey, target))
        grey, target = (np.asarray(each, dtype=np.uint8) for each in shrunk)
    return u0 + place, v0 + place, grey, target > 127


def draw_frame(comparison: FrameComparison, n_frames: int, sunlit: bool = False) -> Rgb:
    """(H, W, 3) of ``SIZE_PX``. ``sunlit``: whether the Sun that was estimated lights the model."""
    left_px = [column * (PANEL_PX + GAP_PX) for column in range(3)]
    lines_px = (HEAD_PX + PANEL_PX + 16, HEAD_PX + PANEL_PX + 38)
    canvas = np.full((*SIZE_PX[::-1], 3), GROUND, dtype=np.uint8)
    grey = (comparison.image, np.round(comparison.model).astype(np.uint8))
    colours = signed_colours(comparison.difference, comparison.seen | comparison.modelled)
    for left, panel in zip(
        left_px, [*(np.repeat(each[..., None], 3, axis=2) for each in grey), colours], strict=True
    ):
        larger = cv2.resize(panel, (PANEL_PX, PANEL_PX), interpolation=cv2.INTER_LINEAR)
        canvas[HEAD_PX : HEAD_PX + PANEL_PX, left : left + PANEL_PX] = larger
    # the scale of the difference below its panel
    left, top, width = left_px[2] + 8 + 36, lines_px[0] - 4, 140
    scale = signed_colours(np.linspace(-SPAN_GREY, SPAN_GREY, width), np.ones(width, dtype=bool))
    canvas[top : top + 9, left : left + width] = scale
    page = Image.fromarray(canvas)
    draw = ImageDraw.Draw(page)
    # The font that matplotlib ships: the same picture on every machine.
    file = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    large, small = (ImageFont.truetype(file, size) for size in (15, 13))
    pose = "" if comparison.measured else ", pose from the dynamics"
    fit = f"gain {comparison.gain:.2f}, offset {round(comparison.offset):+d}".replace("-", MINUS)
    for column, row_px, words in (
        (0, HEAD_PX / 2, "left camera, rectified"),
        (1, HEAD_PX / 2, "model in the estimated sunlight" if sunlit else "model at the estimated pose"),
        (2, HEAD_PX / 2, "difference: camera minus model"),
        (0, lines_px[0], f"frame {comparison.frame} of {n_frames}{pose}"),
        (0, lines_px[1], f"{comparison.time_s:.2f} s"),
        (1, lines_px[0], f"overlap of silhouettes (IoU): {_number(comparison.overlap, 2)}"),
        (1, lines_px[1], f"covered by the model: {_number(comparison.covered, 2)}"),
        (2, lines_px[1], f"rms {_number(comparison.rms_grey, 1)}; {fit}"),
    ):
        draw.text((left_px[column] + 8, row_px), words, TEXT, large, anchor="lm")
    draw.text((left - 6, lines_px[0]), f"{MINUS}{SPAN_GREY:.0f}", SOFT, small, anchor="rm")
    draw.text((left + width + 6, lines_px[0]), f"+{SPAN_GREY:.0f} grey levels", SOFT, small, anchor="lm")
    return np.asarray(page, dtype=np.uint8)


def signed_colours(difference: Array, shown: NDArray[np.bool_]) -> Rgb:
    """Signed grey levels (...) as colours (..., 3): blue negative, orange positive, ground if not shown."""
    share = np.linspace(-1.0, 1.0, 2 * STEPS + 1)[:, None]
    ends = np.where(share < 0.0, np.array(DARKER, dtype=np.float64), np.array(BRIGHTER, dtype=np.float64))
    mixed = np.array(EQUAL) + np.abs(share) * (ends - np.array(EQUAL))
    scale = np.vstack([np.round(mixed), np.array(GROUND)]).astype(np.uint8)
    step = np.round((difference / SPAN_GREY).clip(-1.0, 1.0) * STEPS).astype(np.int64)
    return scale[np.where(shown, step + STEPS, -1)]


def caption(comparison: FrameComparison) -> str:
    """The numbers of a frame in a line."""
    return (
        f"frame {comparison.frame}, {comparison.time_s:.1f} s: overlap of the silhouettes "
        f"{_number(comparison.overlap, 2)}, difference {_number(comparison.rms_grey, 1)} grey levels rms"
    )


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "none"


@contextmanager
def film(mp4: Path, gif: Path) -> Iterator[Callable[[Rgb], None]]:
    """Yield a function that adds a picture (H, W, 3) of ``SIZE_PX``; the files appear if the block succeeds.

    Raises OSError when there is no encoder, ValueError when nothing was added.
    """
    # The colours that occur: the background, 48 greys, and 64 of the scale of the difference.
    grey = np.repeat(np.linspace(0, 255, 48).round().astype(np.uint8)[:, None], 3, axis=1)
    hues = signed_colours(np.linspace(-SPAN_GREY, SPAN_GREY, 64), np.ones(64, dtype=bool))
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.vstack([[GROUND], grey, hues]).astype(np.uint8).tobytes())
    small: list[Image.Image] = []
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
        step = 1
        while True:
            # Every frame, or every second, fourth... one, so that the file stays small.
            content, kept = io.BytesIO(), small[::step]
            style = {"duration": step * 1000 // RATE_HZ, "loop": 0, "optimize": False}
            kept[0].save(content, "GIF", save_all=True, append_images=kept[1:], **style)
            if content.tell() <= MAX_GIF_BYTES or len(kept) <= MIN_GIF_FRAMES:
                break
            step *= 2
        write_bytes(gif, content.getvalue())
