"""The run directory: every file that a run leaves, its writer and its reader (docs/run_directory.md).

``write_run`` writes them all; a run that may fail calls the writer of each stage as the stage ends, so that
what was found is written. Bytes of every file but summary.json (timings), log.txt and report.html depend on
the content alone.
"""

import json
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import perf_counter

from polhode.atomic import write_bytes, write_text
from polhode.config import Config
from polhode.config.loader import dump_config
from polhode.errors import InputError
from polhode.mapping.finishing.detail_levels import Level
from polhode.mapping.mesh_files import write_glb, write_ply
from polhode.pipeline.report import finding, refresh_report, write_report
from polhode.pipeline.run_directory.archives import (
    Covariance,
    Residuals,
    read_covariance,
    read_measurements,
    read_relative_poses,
    read_residuals,
    write_covariance,
    write_measurements,
)
from polhode.pipeline.run_directory.disturbances_file import write_pushes
from polhode.pipeline.run_directory.online_file import read_online, write_online
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks, write_landmarks
from polhode.pipeline.run_directory.run_folder import RunFolder
from polhode.pipeline.run_directory.summary import Summary, build_summary, read_summary, write_summary
from polhode.pipeline.run_directory.trajectory_file import (
    TRAJECTORY_COLUMNS,
    Trajectory,
    read_trajectory,
    trajectory_of,
    write_trajectory,
)
from polhode.records import MotionEstimate, OnlineEstimate, RelativePoses, StereoTracks, SurfaceModel

__all__ = [
    "TRAJECTORY_COLUMNS",
    "Covariance",
    "Residuals",
    "RunFolder",
    "Summary",
    "Trajectory",
    "build_summary",
    "finding",
    "finish_run",
    "read_covariance",
    "read_landmarks",
    "read_measurements",
    "read_online",
    "read_relative_poses",
    "read_residuals",
    "read_summary",
    "read_trajectory",
    "refresh_report",
    "trajectory_of",
    "write_config",
    "write_estimate",
    "write_measurements",
    "write_online_estimate",
    "write_picture",
    "write_pictures",
    "write_report",
    "write_run",
    "write_surface",
]

_log = logging.getLogger(__name__)


def write_config(folder: Path, config: Config) -> None:
    """config.yaml with every default written out: running it repeats the run."""
    write_text(folder / "config.yaml", dump_config(config))


def write_estimate(
    folder: Path, tracks: StereoTracks, estimate: MotionEstimate, relative: RelativePoses | None = None
) -> None:
    """trajectory.csv, covariance.npz and landmarks.ply; measurements.npz again, now with the residuals;
    pushes.csv where something unknown may have pushed.

    Also a first summary.json, so that a run that fails later has one with all its numbers.
    """
    write_trajectory(trajectory_of(estimate), folder / "trajectory.csv")
    write_covariance(estimate, folder / "covariance.npz")
    write_landmarks(estimate.landmarks, folder / "landmarks.ply")
    write_measurements(tracks, folder / "measurements.npz", relative, estimate)
    (folder / "pushes.csv").unlink(missing_ok=True)
    if estimate.pushes is not None:
        write_pushes(estimate.pushes, folder / "pushes.csv")
    write_summary(build_summary(tracks, estimate, None, {}), folder / "summary.json")


def write_online_estimate(folder: Path, online: OnlineEstimate) -> None:
    """trajectory_online.csv and online.npz: what was known when each frame came."""
    write_trajectory(trajectory_of(online), folder / "trajectory_online.csv")
    write_online(online, folder / "online.npz")


def write_surface(folder: Path, surface: SurfaceModel, levels: Sequence[Level] = ()) -> None:
    """mesh.ply, mesh.glb and the lighter meshes; nothing when the surface is empty: that helps no viewer."""
    if len(surface.mesh.faces) == 0:
        return
    write_ply(path=folder / "mesh.ply", surface=surface)
    write_glb(path=folder / "mesh.glb", surface=surface)
    for number, level in enumerate(levels, start=1):
        write_glb(path=folder / f"mesh_lod{number}.glb", surface=level.surface)


def write_pictures(folder: Path, pictures: Mapping[str, bytes]) -> None:
    """Sample images for the report: caption -> PNG or JPEG file content. Kept in RUN/pictures/."""
    for number, (caption, content) in enumerate(pictures.items()):
        suffix = ".png" if content.startswith(b"\x89PNG") else ".jpg"
        write_picture(folder, f"{number:02d}{suffix}", content, caption)


def write_picture(folder: Path, name: str, content: bytes, caption: str) -> None:
    """One image of the report, with its caption in RUN/pictures/captions.json."""
    target = folder / "pictures"
    target.mkdir(exist_ok=True)
    write_bytes(target / name, content)
    file = target / "captions.json"
    captions = json.loads(file.read_text()) if file.is_file() else {}
    write_text(file, json.dumps(captions | {name: caption}, indent=2) + "\n")


def finish_run(folder: Path, summary: Summary) -> Summary:
    """Write summary.json and report.html; the timings then hold the report too. Returns the summary."""
    write_summary(summary, folder / "summary.json")
    start = perf_counter()
    try:
        write_report(folder)
    except InputError as error:
        # the results stand without their page
        _log.warning("no report: %s", error)
        summary = summary.model_copy(update={"warnings": [*summary.warnings, f"no report: {error}"]})
    seconds = perf_counter() - start
    times = summary.timing_s
    timing = times.model_copy(update={"report": times.report + seconds, "total": times.total + seconds})
    timed = summary.model_copy(update={"timing_s": timing})
    write_summary(timed, folder / "summary.json")
    return timed


def write_run(
    folder: Path,
    *,
    config: Config,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    surface: SurfaceModel | None,
    timing_s: Mapping[str, float],
    relative: RelativePoses | None = None,
    warnings: Sequence[str] = (),
    degraded: Sequence[str] = (),
    pictures: Mapping[str, bytes] | None = None,
) -> Summary:
    """Write every file of a run that reached its end; see ``build_summary`` for warnings and degraded."""
    write_config(folder, config)
    write_estimate(folder, tracks, estimate, relative)
    if surface is not None:
        write_surface(folder, surface)
    if pictures:
        write_pictures(folder, pictures)
    return finish_run(folder, build_summary(tracks, estimate, surface, timing_s, warnings, degraded))
