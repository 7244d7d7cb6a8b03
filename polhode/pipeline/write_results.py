"""The stages that write files of a run, each as soon as there is what it writes; and RUN/pictures.

No picture is a result: if one cannot be made, it is left out with a warning.
"""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from polhode.files.atomic import write_text
from polhode.frontend.rectification import Crop, Rectifier, rectified_left, target_crop
from polhode.mapping.finishing.detail_levels import DetailLevel
from polhode.mapping.visibility import Caster, MeshViewer
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import Correspondences
from polhode.pipeline.find_motion import Attempt, MotionSolution
from polhode.pipeline.finish_surface import Coloured, Sentences
from polhode.pipeline.runner import stage
from polhode.records.dataset import StereoSequence
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.records.occupancy import Occupancy
from polhode.records.tracks import StereoTracks
from polhode.report.pictures.body_views import body_frame, draw_mesh
from polhode.report.pictures.mask_strip import jpeg, mask_strip
from polhode.report.pictures.model_comparison import (
    FrameComparison,
    caption,
    chosen_frames,
    compare_frames,
    draw_frame,
    film,
)
from polhode.report.tables import motion_sentence
from polhode.run_directory import outputs
from polhode.run_directory.archives import write_measurements
from polhode.run_directory.archives import write_occupancy as write_grid
from polhode.runtime.progress import NOTE, Advance

INLIER_BGR, OUTLIER_BGR = (233, 180, 86), (0, 94, 213)
"""Sky blue and vermillion of Okabe and Ito, which colour-blind readers tell apart"""
SIDE_PX = 360

_log = logging.getLogger(__name__)


@stage("report", ["frontend.tracks"], writes=True)
def write_matches(context: RunContext, folder: Path, matches: Correspondences) -> None:
    """The measurements as they are without a motion."""
    write_measurements(matches.tracks(context), folder / "measurements.npz", matches.links)


@stage("report", writes=True)
def write_first_motion(context: RunContext, folder: Path, matches: Correspondences, first: Attempt) -> None:
    """The motion of the first feature method, if it has found one."""
    if (solved := first.solved) is not None:
        outputs.write_estimate(folder, solved.tracks, solved.estimate, matches.links)


@stage("report", writes=True)
def write_motion(context: RunContext, folder: Path, motion: MotionSolution) -> None:
    """The motion with its measurements; the user reads of it long before the verdict."""
    links = motion.links if len(motion.links) else None
    outputs.write_estimate(folder, motion.tracks, motion.estimate, links)
    found = motion_sentence(motion.estimate, int(motion.is_measured.sum()))
    _log.log(NOTE, "%s; the verdict is pending", found)


@stage("report", writes=True)
def write_online(context: RunContext, folder: Path, online: OnlineEstimate | None) -> None:
    """The causal estimate, if there is one."""
    if online is not None:
        outputs.write_online_estimate(folder, online)


@stage("report", writes=True)
def write_surface(
    context: RunContext, folder: Path, coloured: Coloured, lighter: tuple[list[DetailLevel], Sentences]
) -> None:
    """The meshes."""
    outputs.write_surface(folder, coloured.surface, lighter[0])


@stage("report", writes=True)
def write_occupancy(context: RunContext, folder: Path, occupied: tuple[Occupancy | None, Sentences]) -> None:
    """The grid of what may hold matter beside the mesh."""
    if occupied[0] is not None:
        write_grid(occupied[0], folder / "occupancy.npz")


@stage("report", ["outputs", "pictures"], is_stored=False)
def write_pictures(context: RunContext, folder: Path, motion: MotionSolution, coloured: Coloured) -> None:
    """The pictures if they are wanted, for which no other stage waits.

    Tracks on the images, map and mesh from all sides, the model beside the images: where the Sun is known, in
    its light, with the shadows that it casts on itself.
    """
    if "pictures" not in context.config.outputs:
        return
    sequence, rectifier, most = context.sequence, context.rectifier, context.config.pictures.frames
    tracks, estimate, surface = motion.tracks, motion.estimate, coloured.surface
    caster = None
    with _optional("the mesh"):
        if len(surface.mesh.faces):
            caster = Caster(surface.mesh)
    frames = chosen_frames(tracks.n_frames, most) if caster else []
    with context.progress.stage("pictures", 2 + len(frames)) as advance:
        with _optional("tracks on the images"):
            drawn = track_pictures(sequence, rectifier, tracks, estimate)
            for number, (words, content) in enumerate(drawn.items()):
                outputs.write_picture(folder, f"{number:02d}.jpg", content, words)
        with _optional("masks.jpg"):
            strip = mask_strip(sequence, rectifier)
            if strip is not None:
                outputs.write_picture(folder, "masks.jpg", *strip)
        advance()
        frame = body_frame(estimate.mass)
        with _optional("mesh.png"):
            if caster is not None:
                content = draw_mesh(surface, MeshViewer(surface.mesh, caster), frame)
                words = f"Mesh from eight sides. {frame.description}"
                outputs.write_picture(folder, "mesh.png", content, words)
        advance()
        if frames:
            with _optional("model.mp4"):
                shown = (sequence, rectifier, tracks, estimate, surface.mesh, frames)
                compared = compare_frames(*shown, coloured.sun_N, caster)
                _animate(folder, compared, tracks, len(frames), coloured.sun_N is not None, advance)


@contextmanager
def _optional(name: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001  pictures are optional: the run goes on without it
        _log.warning("no picture: %s (%s: %s)", name, type(error).__name__, error)


def _animate(
    folder: Path,
    compared: Iterator[FrameComparison],
    tracks: StereoTracks,
    count: int,
    sunlit: bool,
    advance: Advance,
) -> None:
    """model.mp4, model.gif, model.csv, and four of the frames as separate pictures, for the report."""
    target = folder / "pictures"
    target.mkdir(exist_ok=True)
    still = set(((np.arange(4) + 0.5) * count / 4).astype(int).tolist())
    stills, overlap = [], []
    # a missing value is nan
    lines = ["frame,timestamp_ns,measured,iou,covered,rms_grey,gain,offset_grey,sunlit"]
    with film(target / "model.mp4", target / "model.gif") as add:
        for number, each in enumerate(compared):
            picture = draw_frame(each, tracks.n_frames, sunlit)
            add(picture)
            start = f"{each.frame},{tracks.timestamps_ns[each.frame]},{int(each.measured)}"
            numbers = (each.overlap, each.covered, each.rms_grey, each.gain, each.offset)
            lines.append(",".join([start, *(f"{number:.4f}" for number in numbers), str(int(sunlit))]))
            overlap.append(each.overlap)
            if number in still:
                stills.append((f"model_{each.frame:04d}.jpg", picture, caption(each)))
            advance()
    write_text(target / "model.csv", "\n".join(lines) + "\n")
    for name, picture, words in stills:
        outputs.write_picture(folder, name, jpeg(picture[..., ::-1]), words)
    if np.isfinite(overlap).any():
        _log.info("silhouettes of model and image overlap by %.2f (median)", float(np.nanmedian(overlap)))


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
        patch = left[crop.v0 : crop.v1, crop.u0 : crop.u1]
        zoom = SIDE_PX / max(patch.shape)
        size = (round(patch.shape[1] * zoom), round(patch.shape[0] * zoom))
        canvas = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
        places = ((tracks.uvd_px[here, :2] - [crop.u0, crop.v0] + 0.5) * zoom).round().astype(int)
        for place, good in zip(places.tolist(), inlier.tolist(), strict=True):
            cv2.circle(canvas, place, 2, INLIER_BGR if good else OUTLIER_BGR, -1, cv2.LINE_AA)
        words = f"frame {k}, {float(tracks.time_s[k]):.1f} s: {counts}"
        pictures[words] = jpeg(np.asarray(canvas, dtype=np.uint8))
    return pictures
