"""Measurements of a dataset: the front end and the back end's rounds with it, as ``polhode run`` does them.

Neither depth nor fusion nor the online estimate nor a report. What was found is stored beside the problems,
as it takes most of the time of a comparison that is gone on with.
"""

import hashlib
import json
from pathlib import Path

from polhode.atomic import write_text
from polhode.compare.problem.fingerprint import BASE, code_of, versions
from polhode.config import Config
from polhode.config.loader import dump_config
from polhode.pipeline.context import open_context
from polhode.pipeline.correspondences import match_frames
from polhode.pipeline.find_motion import find_motion
from polhode.pipeline.run_directory.archives import read_measurements, read_relative_poses, write_measurements
from polhode.progress import Progress
from polhode.records import RelativePoses, StereoTracks

CODE = ("polhode", "polhode.frontend", "polhode.backend", "polhode.pipeline.find_motion",
        "polhode.pipeline.context",
        "polhode.pipeline.consistency_check", "polhode.pipeline.correspondences")  # fmt: skip
DISTRIBUTIONS = (*BASE, "torch", "opencv-python-headless", "kornia")


def measure(
    sequence: Path, config: Config, progress: Progress, store: Path
) -> tuple[StereoTracks, RelativePoses | None]:
    """Tracks and relative poses of a sequence on disk, from ``store`` when they are of the same images.

    Raises InputError for a dataset that is none; RunFailure when no motion is found.
    """
    file, stamp_file = store.with_suffix(".npz"), store.with_suffix(".json")
    stamp = _stamp(sequence, config)
    if file.is_file() and stamp_file.is_file() and json.loads(stamp_file.read_text()) == stamp:
        return read_measurements(file), read_relative_poses(file)
    stamp_file.unlink(missing_ok=True)
    context = open_context(sequence, config, progress)
    # The last solution has the best measurements.
    for solution in find_motion(context, match_frames(context)):
        tracks, links = solution.tracks, solution.links
    write_measurements(tracks, file, links)
    write_text(stamp_file, json.dumps(stamp) + "\n")
    return read_measurements(file), read_relative_poses(file)


def _stamp(sequence: Path, config: Config) -> dict[str, object]:
    """Of the files of a dataset without its truth, the settings and our code."""
    digest = hashlib.sha256()
    mav0 = sequence / "mav0"
    for file in sorted(mav0.rglob("*")):
        if file.is_file() and file.relative_to(mav0).parts[0] != "target0":
            found = file.stat()
            digest.update(f"{file.relative_to(mav0)} {found.st_size} {found.st_mtime_ns}\n".encode())
    settings = dump_config(config.model_copy(update={"compare": type(config.compare)()}))
    return {"files": digest.hexdigest(), "settings": settings, "code": code_of(CODE),
            "versions": versions(DISTRIBUTIONS)}  # fmt: skip
