"""Which recording a run was made from: digests of some of its images, in summary.json.

All simulated scenes begin at the same instant, and so may recordings of one camera: timestamps alone do not
tell whether a truth is that of a run.
"""

import hashlib
import logging
from pathlib import Path

import numpy as np

from polhode.files.foreign_files import MIB, sha256_of
from polhode.files.images import UnreadableImage, read_raw
from polhode.files.tables import read_listing
from polhode.records.dataset import StereoSequence
from polhode.run_directory.summary_schema import RecordedImage, Recording
from polhode.runtime.errors import InputError

_log = logging.getLogger(__name__)


def recording_of(sequence: StereoSequence) -> Recording:
    """The first, the middle and the last left image that the run uses. Raises InputError if one has gone."""
    last, calibration = len(sequence) - 1, sequence.calibration
    width_px, height_px = calibration.width_px, calibration.height_px
    images = []
    for k in sorted({0, last // 2, last}):
        file = sequence.left_file(k)
        try:
            pixels = _pixels(file, width_px, height_px)
        except UnreadableImage as error:
            raise InputError(f"{file}: changed while in use: {error}") from None
        stamp = int(sequence.timestamps_ns[k])
        images.append(RecordedImage(timestamp_ns=stamp, file_sha256=_file(file), pixels_sha256=pixels))
    return Recording(width_px=width_px, height_px=height_px, left_images=tuple(images))


TRUTH_BESIDE = "give the one that the run was made from, with its truth in mav0/target0"


def require_recording(recording: Recording | None, sequence_folder: Path, remedy: str = TRUTH_BESIDE) -> None:
    """Raise InputError unless the images of a sequence are those of the run.

    What counts is what the camera saw, and when: the folder may have been moved or copied, its files renamed
    or re-encoded without loss, its calibration corrected, frames added. Images that were changed (exposure,
    compression with loss, fewer bits) are another recording: nothing tells them from those of another scene,
    and the truth belongs beside the images that the run has seen. An image is the same if its bytes are, or
    its pixels; the bytes, too, because decoders of JPEG differ between versions. None (an earlier version
    recorded nothing) passes; so does, with a warning, a sequence whose images were removed.
    """
    if recording is None or not recording.left_images:
        return
    camera = sequence_folder / "mav0" / "cam0"
    listed = (camera / "data.csv").exists()
    names, compared = read_listing(camera / "data.csv") if listed else {}, 0
    for image in recording.left_images if listed else ():
        where = f"left image at {image.timestamp_ns} ns"
        if image.timestamp_ns not in names:
            raise _other(sequence_folder, f"it has no {where}", remedy)
        file = camera / "data" / names[image.timestamp_ns]
        if not file.exists():
            continue
        if not _is_same(file, image, recording):
            raise _other(sequence_folder, f"its {where} is another one", remedy)
        compared += 1
    if not compared:
        _log.warning("%s: no images that show whether it is the sequence of this run", sequence_folder)


def _is_same(file: Path, image: RecordedImage, recording: Recording) -> bool:
    if _file(file) == image.file_sha256:
        return True
    try:
        return _pixels(file, recording.width_px, recording.height_px) == image.pixels_sha256
    except UnreadableImage:
        return False


def _other(folder: Path, why: str, remedy: str) -> InputError:
    return InputError(f"{folder}: not the sequence of this run ({why}); {remedy}")


def _file(file: Path) -> str:
    return sha256_of(file, 1024 * MIB, "an image")


def _pixels(file: Path, width_px: int, height_px: int) -> str:
    """Of the values as stored, whose size is part of the recording. Raises UnreadableImage."""
    raw = read_raw(file, width_px, height_px)
    return hashlib.sha256(raw.astype(np.dtype(raw.dtype).newbyteorder("<")).tobytes()).hexdigest()
