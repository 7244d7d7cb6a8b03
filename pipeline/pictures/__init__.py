"""RUN/pictures: tracks on the images, the map from six sides, the mesh, the model beside the images.

None of them is a result: one that cannot be made costs only itself and a warning in the log.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from polhode.atomic import write_text
from polhode.config import Pictures
from polhode.dataset import StereoSequence
from polhode.frontend.rectification.rectify import Rectifier
from polhode.mapping.mesh_viewer import MeshViewer
from polhode.pipeline.pictures.animation import film
from polhode.pipeline.pictures.body_views import body_frame
from polhode.pipeline.pictures.frame_drawing import Rgb, caption, draw_frame
from polhode.pipeline.pictures.landmarks import draw_landmarks
from polhode.pipeline.pictures.mesh_sheet import draw_mesh
from polhode.pipeline.pictures.model import Comparison, chosen_frames, compare_frames
from polhode.pipeline.pictures.tracks import track_pictures
from polhode.pipeline.run_directory.outputs import write_picture
from polhode.progress import Advance, Progress
from polhode.records import MotionEstimate, StereoTracks, SurfaceModel

__all__ = ["make_pictures"]

STILLS = 4
MODEL_COLUMNS = ("frame", "timestamp_ns", "measured", "iou", "covered", "rms_grey", "gain", "offset_grey")
"""Of model.csv; no number: nan."""

_log = logging.getLogger(__name__)


def make_pictures(
    folder: Path,
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    surface: SurfaceModel,
    config: Pictures,
    progress: Progress,
) -> None:
    """Write the pictures of a run that the configuration asks for into ``folder``/pictures."""
    viewer = None
    with _optional("the mesh"):
        viewer = MeshViewer(surface.mesh) if len(surface.mesh.faces) else None
    frames = chosen_frames(tracks.n_frames, config.frames) if config.animation and viewer else []
    with progress.stage("pictures", 1 + 2 * config.views + len(frames)) as advance:
        with _optional("tracks on the images"):
            drawn = track_pictures(sequence, rectifier, tracks, estimate)
            for number, (words, content) in enumerate(drawn.items()):
                write_picture(folder, f"{number:02d}.jpg", content, words)
        advance()
        frame = body_frame(estimate.mass)
        if config.views:
            with _optional("landmarks.png"):
                if len(estimate.landmarks.p_G):
                    words = f"Landmarks from six sides. {frame.words}"
                    write_picture(folder, "landmarks.png", draw_landmarks(estimate.landmarks, frame), words)
            advance()
            with _optional("mesh.png"):
                if viewer is not None:
                    words = f"Mesh from eight sides. {frame.words}"
                    write_picture(folder, "mesh.png", draw_mesh(surface, viewer, frame), words)
            advance()
        if viewer is not None and frames:
            with _optional("model.mp4"):
                compared = compare_frames(sequence, rectifier, tracks, estimate, surface.mesh, viewer, frames)
                _animate(folder, compared, tracks, len(frames), advance)


def _animate(
    folder: Path, compared: Iterator[Comparison], tracks: StereoTracks, count: int, advance: Advance
) -> None:
    """model.mp4, model.gif, model.csv, and some of the frames as pictures of their own."""
    place = folder / "pictures"
    place.mkdir(exist_ok=True)
    still = set(((np.arange(STILLS) + 0.5) * count / STILLS).astype(int).tolist())
    stills: dict[str, tuple[Rgb, str]] = {}
    rows: list[Comparison] = []
    with film(place / "model.mp4", place / "model.gif") as add:
        for number, comparison in enumerate(compared):
            picture = draw_frame(comparison, tracks.n_frames)
            add(picture)
            rows.append(comparison)
            if number in still:
                stills[f"model_{comparison.frame:04d}.jpg"] = picture, caption(comparison)
            advance()
    write_text(place / "model.csv", _table(rows, tracks))
    for name, (picture, words) in stills.items():
        encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
        write_picture(folder, name, encoded.tobytes(), words)
    overlap = [each.overlap for each in rows if np.isfinite(each.overlap)]
    if overlap:
        _log.info("silhouettes of model and image overlap by %.2f (median)", float(np.median(overlap)))


def _table(rows: Sequence[Comparison], tracks: StereoTracks) -> str:
    lines = [",".join(MODEL_COLUMNS)]
    for each in rows:
        numbers = (each.overlap, each.covered, each.rms_grey, each.gain, each.offset)
        start = f"{each.frame},{tracks.timestamps_ns[each.frame]},{int(each.measured)}"
        lines.append(",".join([start, *(f"{number:.4f}" for number in numbers)]))
    return "\n".join(lines) + "\n"


@contextmanager
def _optional(name: str) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # noqa: BLE001  a picture is no result: the run goes on without it
        _log.warning("no picture: %s (%s: %s)", name, type(error).__name__, error)
