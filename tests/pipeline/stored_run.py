"""A finished run on disk, from its parts and without the front end."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from polhode.config import Config
from polhode.records.estimate import MotionEstimate, OnlineEstimate
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.report import finish_run
from polhode.run_directory import outputs
from polhode.run_directory.summary import build_summary
from polhode.run_directory.summary_schema import Intervals, Summary


def stored(
    folder: Path,
    run: Any,
    surface: SurfaceModel | None = None,
    online: OnlineEstimate | None = None,
    **more: Any,
) -> Path:
    """The folder with the tracks and the estimate of a run and the causal one, as by ``write_run``."""
    folder.mkdir(parents=True, exist_ok=True)
    if online is not None:
        outputs.write_online_estimate(folder, online)
    given = {"config": Config(), "timing_s": {}, "tracks": run.tracks, "estimate": run.estimate}
    write_run(folder, surface=surface, **(given | more))
    return folder


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
    pictures: Mapping[str, bytes] | None = None,
    intervals: Intervals | None = None,
) -> Summary:
    """Write what a run writes, stage by stage; ``pictures``: PNG or JPEG by caption."""
    outputs.write_config(folder, config)
    outputs.write_estimate(folder, tracks, estimate, relative)
    if surface is not None:
        outputs.write_surface(folder, surface)
    for number, (caption, content) in enumerate((pictures or {}).items()):
        suffix = ".png" if content.startswith(b"\x89PNG") else ".jpg"
        outputs.write_picture(folder, f"{number:02d}{suffix}", content, caption)
    summary = build_summary(tracks, estimate, surface, timing_s, warnings)
    return finish_run(folder, summary.model_copy(update={"intervals": intervals}))
