"""RUN/pictures: tracks on the images, map and mesh from all sides, the model beside the images.

None of them is a result: if one cannot be made, it is left out with a warning.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from polhode.files.atomic import write_text
from polhode.frontend.rectification import Crop, Rectifier, rectified_left, target_crop
from polhode.geometry.lie import Array
from polhode.mapping.visibility import Caster, MeshViewer
from polhode.pipeline.context import RunContext
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.body_views import body_frame, draw_mesh
from polhode.report.pictures.mask_strip import jpeg, mask_strip
from polhode.report.pictures.model_comparison import (
    FrameComparison,
    Rgb,
    caption,
    chosen_frames,
    compare_frames,
    draw_frame,
    film,
)
from polhode.run_directory.outputs import write_picture
from polhode.runtime.progress import Advance

STILLS = 4
"""Frames of the animation that the report shows."""
INLIER_BGR = (233, 180, 86)
OUTLIER_BGR = (0, 94, 213)
"""Sky blue and vermillion of Okabe and Ito, which colour-blind readers tell apart"""
SIDE_PX = 360

_log = logging.getLogger(__name__)


def make_pictures(
    context: RunContext,
    folder: Path,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    surface: SurfaceModel,
    sun_N: Array | None = None,
) -> None:
    """Write the pictures that the configuration asks for into ``folder``/pictures.

    With sun_N (3,), the film shows the model in that light, with the shadows that it casts on itself.
    """
    sequence, rectifier, config = context.sequence, context.rectifier, context.config.pictures
    caster = None
    with _optional("the mesh"):
        if len(surface.mesh.faces):
            caster = Caster(surface.mesh)
    frames = chosen_frames(tracks.n_frames, config.frames) if config.animation and caster else []
    with context.progress.stage("pictures", 1 + config.views + len(frames)) as advance:
        with _optional("tracks on the images"):
            drawn = track_pictures(sequence, rectifier, tracks, estimate)
            for number, (words, content) in enumerate(drawn.items()):
                write_picture(folder, f"{number:02d}.jpg", content, words)
        with _optional("masks.jpg"):
            strip = mask_strip(sequence, rectifier)
            if strip is not None:
                write_picture(folder, "masks.jpg", *strip)
        advance()
        frame = body_frame(estimate.mass)
        if config.views:
            with _optional("mesh.png"):
                if caster is not None:
                    words = f"Mesh from eight sides. {frame.description}"
                    content = draw_mesh(surface, MeshViewer(surface.mesh, caster), frame)
                    write_picture(folder, "mesh.png", content, words)
            advance()
        if frames:
            with _optional("model.mp4"):
                shown = (sequence, rectifier, tracks, estimate, surface.mesh, frames)
                compared = compare_frames(*shown, sun_N, caster)
                _animate(folder, compared, tracks, len(frames), sun_N is not None, advance)


def _animate(
    folder: Path,
    compared: Iterator[FrameComparison],
    tracks: StereoTracks,
    count: int,
    sunlit: bool,
    advance: Advance,
) -> None:
    """model.mp4, model.gif, model.csv, and some of the frames as separate pictures."""
    target = folder / "pictures"
    target.mkdir(exist_ok=True)
    still = set(((np.arange(STILLS) + 0.5) * count / STILLS).astype(int).tolist())
    stills: dict[str, tuple[Rgb, str]] = {}
    rows: list[FrameComparison] = []
    with film(target / "model.mp4", target / "model.gif") as add:
        for number, comparison in enumerate(compared):
            picture = draw_frame(comparison, tracks.n_frames, sunlit)
            add(picture)
            rows.append(comparison)
            if number in still:
                stills[f"model_{comparison.frame:04d}.jpg"] = picture, caption(comparison)
            advance()
    # a missing value is nan
    lines = ["frame,timestamp_ns,measured,iou,covered,rms_grey,gain,offset_grey,sunlit"]
    for each in rows:
        start = f"{each.frame},{tracks.timestamps_ns[each.frame]},{int(each.measured)}"
        numbers = (each.overlap, each.covered, each.rms_grey, each.gain, each.offset)
        lines.append(",".join([start, *(f"{number:.4f}" for number in numbers), str(int(sunlit))]))
    write_text(target / "model.csv", "\n".join(lines) + "\n")
    for name, (picture, words) in stills.items():
        write_picture(folder, name, jpeg(picture[..., ::-1]), words)
    overlap = [each.overlap for each in rows if np.isfinite(each.overlap)]
    if overlap:
        _log.info("silhouettes of model and image overlap by %.2f (median)", float(np.median(overlap)))


@contextmanager
def _optional(name: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001  pictures are optional: the run goes on without it
        _log.warning("no picture: %s (%s: %s)", name, type(error).__name__, error)


def track_pictures(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    count: int = 6,
) -> dict[str, bytes]:
    """Caption -> JPEG of the left image's crop with its measurements: inliers blue, outliers orange."""
    pictures = {}
    for k in np.unique(np.linspace(0, tracks.n_frames - 1, count).round().astype(int)).tolist():
        left, mask = rectified_left(sequence, rectifier, k)
        crop = target_crop(mask, margin_px=16) or Crop(0, 0, left.shape[1], left.shape[0])
        here = tracks.frame == k
        inlier = estimate.inlier_weight[here] > 0.5
        counts = f"{int(inlier.sum())} inliers (blue), {int((~inlier).sum())} outliers (orange)"
        words = f"frame {k}, {float(tracks.time_s[k]):.1f} s: {counts}"
        patch = left[crop.v0 : crop.v1, crop.u0 : crop.u1]
        zoom = SIDE_PX / max(patch.shape)
        size = (round(patch.shape[1] * zoom), round(patch.shape[0] * zoom))
        canvas = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
        places = ((tracks.uvd_px[here, :2] - [crop.u0, crop.v0] + 0.5) * zoom).round().astype(int)
        for place, good in zip(places.tolist(), inlier.tolist(), strict=True):
            cv2.circle(canvas, place, 2, INLIER_BGR if good else OUTLIER_BGR, -1, cv2.LINE_AA)
        pictures[words] = jpeg(np.asarray(canvas, dtype=np.uint8))
    return pictures
