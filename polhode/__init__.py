"""Motion, mass properties and shape of a tumbling target, from a stereo camera.

Rooms, from the top down; each imports only what stands below it:

cli/            the program: one file per command
studies/        many points of settings as one table, on many processes
compare/        optimizers side by side on one problem
calibration/    the calibration of a rig from images of a board
viewer/         a run, a sequence or a stream in Rerun
pipeline/       the flow, from images to the run directory (run.py), live and long sequences, checks
planning/       prediction, keep-out volumes, approach, edge observability, exports
report/         figures, pictures and page of a run; its evaluation
run_directory/  the files of a run, typed
train/          training of the front end's networks on simulated scenes (../train)
simulation/     stereo sequences with truth: bodies, motion, rendering, sensor
frontend/       images to stereo measurements and tracks, and to depth maps (../frontend)
backend/        tracks to motion, mass properties and their covariance (../backend)
mapping/        depth maps and motion to a mesh
importers/      recordings of others (bags, videos, folders of images) as datasets
records/        what passes between the rooms, and the dataset on disk
config/         the configuration: the only place where defaults live; reading and writing it
files/          foreign files read within limits, own files written whole
geometry/       rotations, cameras, rigid bodies, rays
runtime/        processes, threads, progress, interrupts, compiled code

Above all of them is api.py, the library: ``polhode.run``, ``load``, ``load_study``, ``simulate``,
``evaluate``, ``Run``.
``polhode.Session`` is the live estimate: pairs are pushed, each gives a state (docs/live.md).
``polhode.stages`` is the main job stage by stage (stages.py).
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from polhode import stages
    from polhode.api import Run, evaluate, load, load_study, run, simulate
    from polhode.pipeline.live.session import Session

__all__ = ["Run", "Session", "evaluate", "load", "load_study", "run", "simulate", "stages"]


def __getattr__(name: str) -> Any:
    """What the library offers, loaded when it is first asked for: the program starts without it."""
    if name not in __all__:
        raise AttributeError(f"module 'polhode' has no attribute {name!r}")
    if name == "stages":
        return import_module("polhode.stages")
    return getattr(
        import_module("polhode.pipeline.live.session" if name == "Session" else "polhode.api"), name
    )


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
