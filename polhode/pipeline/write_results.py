"""The stages that write files of a run, each as soon as there is what it writes."""

from pathlib import Path

from polhode.mapping.finishing.detail_levels import DetailLevel
from polhode.pipeline.context import RunContext
from polhode.pipeline.correspondences import Correspondences
from polhode.pipeline.find_motion import Attempt, MotionSolution
from polhode.pipeline.finish_surface import Coloured, Sentences
from polhode.pipeline.run_pictures import make_pictures
from polhode.pipeline.runner import stage
from polhode.records.estimate import OnlineEstimate
from polhode.run_directory import outputs
from polhode.run_directory.archives import write_measurements


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
    """The motion with its measurements."""
    links = motion.links if len(motion.links) else None
    outputs.write_estimate(folder, motion.tracks, motion.estimate, links)


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


@stage("report", ["pictures"], is_stored=False)
def write_pictures(context: RunContext, folder: Path, motion: MotionSolution, coloured: Coloured) -> None:
    """The pictures, which are no result: no other stage waits for them."""
    make_pictures(context, folder, motion.tracks, motion.estimate, coloured.surface, coloured.sun_N)
