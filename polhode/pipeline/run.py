"""The main job, as the data flows: images, matches, motion, depth, surface, checks, report."""

from collections.abc import Callable
from pathlib import Path

from polhode.config import Config
from polhode.pipeline import finish_surface as finish
from polhode.pipeline import judge_motion as judge
from polhode.pipeline import write_results as write
from polhode.pipeline.build_surface import fuse_depth, no_surface, no_symmetry_check, symmetry_check
from polhode.pipeline.correspondences import features_of_frames, match_features
from polhode.pipeline.depth_maps import depth_maps_of
from polhode.pipeline.find_motion import best_motion, first_motion, initial_motion, second_correspondences
from polhode.pipeline.long_sequence import is_long, solve_long, stream_sequence
from polhode.pipeline.open_run import open_run
from polhode.pipeline.run_result import RunResult, report_run
from polhode.pipeline.stream_results import Streamed
from polhode.report import write_report
from polhode.run_directory.run_folder import RunFolder, atomic_run_folder
from polhode.runtime.progress import Progress
from polhode.runtime.threads import single_threaded

__all__ = ["RunResult", "fill_run_folder", "run"]


@single_threaded
def run(
    config: Config,
    sequence_folder: Path,
    run_folder: Path,
    progress: Progress,
    overwrite: bool = False,
    even_if_failed: bool = False,
    streamed: Streamed | None = None,
    resume: bool = False,
) -> RunResult:
    """A stereo sequence on disk to a run directory (docs/run_directory.md).

    ``overwrite`` replaces an existing run; a failed run only a failed one, unless ``even_if_failed``.
    ``streamed``: what a stream of these pairs has found already. ``resume``: stages that an earlier run has
    finished there are not computed again, and that run is replaced. Raises InputError for bad input and then
    writes nothing; RunFailure when no consistent motion is found: what was found before is then there.
    """
    with atomic_run_folder(run_folder, overwrite, write_report, even_if_failed, resume) as written:
        published = fill_run_folder(written, config, sequence_folder, progress, streamed)
    return published(written)


@single_threaded
def fill_run_folder(
    written: RunFolder,
    config: Config,
    sequence_folder: Path,
    progress: Progress,
    streamed: Streamed | None = None,
) -> Callable[[RunFolder], RunResult]:
    """The whole run, into a folder that is open. Returns what makes its result once it is published."""
    run, known = open_run(written, config, sequence_folder, progress, streamed)
    folder = written.path
    if is_long(run.context):
        stream = run(stream_sequence, known)
        frames, features, motion, answer, online, of_all = run.parts(solve_long, stream)
        run(write.write_motion, folder, answer)
        run(write.write_online, folder, of_all)
        run.of_frames(frames.value)
        depth = run(depth_maps_of, features)
    else:
        features = run(features_of_frames, known)
        matches = run(match_features, features, known)
        run(write.write_matches, folder, matches)
        initial = run(initial_motion, matches)
        first = run(first_motion, matches, initial)
        run(write.write_first_motion, folder, matches, first)
        second = run(second_correspondences, matches, first)
        answer = motion = run(best_motion, matches, first, second)
        run(write.write_motion, folder, motion)
        depth = run(depth_maps_of, features, known)
        online = run(judge.causal_estimate, motion, streamed)
        run(write.write_online, folder, online)

    data = run(judge.data_checks, features, motion)
    doubts = run(judge.answer_checks, motion)
    if run.context.config.makes_surface:
        fused = run(fuse_depth, depth, motion)
        turning = run(symmetry_check, depth, motion)
    else:
        fused, turning = run(no_surface), run(no_symmetry_check)
    views = run(finish.views_of_surface, fused, motion)
    coloured = run(finish.colour_surface, fused, views)
    run(write.write_pictures, folder, motion, coloured)
    levels = run(finish.lighter_meshes, coloured)
    run(write.write_surface, folder, coloured, levels)
    covered = run(finish.cover, coloured, views)
    if run.context.config.makes_surface:
        occupied = run(finish.occupied_space, coloured, views, depth, motion)
        run(write.write_occupancy, folder, occupied)
    compared = run(finish.compare_mass, coloured, motion)
    shape = run(finish.describe_shape, motion, views, coloured, covered, levels, compared)
    intervals = run(judge.motion_intervals, motion, coloured, covered)
    checks = run(judge.all_checks, turning, doubts, data)
    warnings = run(judge.all_warnings, streamed, answer, fused, data, intervals)
    run.finish()
    return report_run(run, written, answer, coloured, shape, checks, intervals, warnings)
