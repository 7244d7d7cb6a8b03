"""Motion, mass properties and shape of a tumbling target, from a stereo camera.

Rooms, from the top down; each imports only what stands below it:

polhode/cli/         the program: one file per command
polhode/studies/     many points of settings as one table, on many processes
polhode/compare/     optimizers side by side on one problem
polhode/pipeline/    the main job, from images to the run directory, its evaluation, report and products
train/       training of the front end's networks on simulated scenes
polhode/simulation/  stereo sequences with truth: bodies, motion, rendering, sensor
frontend/    images to stereo measurements and tracks, and to depth maps
backend/     tracks to motion, mass properties and their covariance
polhode/mapping/     depth maps and motion to a mesh
polhode/importers/   recordings of others (bags, videos, folders of images) as datasets
polhode/planning/    prediction, keep-out volumes, approach, edge observability, exports

Below them are the shared modules, which every room may import:

config/            the configuration: the only place where defaults live; reading and writing it
records.py         what passes between the stages: tracks, estimates, depth maps, surfaces, truth
lie.py             rotations, rigid transforms, quaternions: exponential, logarithm, conversions
rigid_body.py      Euler's equations, energy, momentum, integration; half-turns of the principal axes
rigid_fit.py       least-squares rotations and rigid transforms
small_systems.py   symmetric systems of a few unknowns, in compiled loops
camera.py          the rectified stereo camera: projection, triangulation
fisheye.py         the equidistant fisheye lens: rays to pixels and back
calibration.py     the calibration of the rig, from sensor.yaml
camera_folders.py  which folders of a sequence hold its two cameras, or its camera and ranges
range_images.py    range images in the place of a second camera: format and noise model
dataset.py         a stereo sequence on disk, without its truth
dataset_writer.py  the same layout, written
pairing.py         images of two cameras that belong together, by their timestamps
images.py          image files: reading, conversion to 8-bit grey
truth.py           the truth of a simulated sequence; only the evaluation may import it
metrics.py         errors of an estimate against the truth
mesh_metrics.py    distances between meshes
argument_names.py  errors of the library in the words of Python, not of the command line
array_files.py     archives of arrays (.npz), their headers compared with their sizes
foreign_files.py   opening the files that others made: regular ones, of a limited size
foreign_meshes/    meshes of others (PLY, STL, OBJ, GLB), their structure checked before they are read
tables.py          tables and calibrations of a dataset, with errors that name file and line
yaml_files.py      YAML, of limited size and depth
json_files.py      JSON, of limited size and depth
ply.py             binary PLY files
atomic.py          atomic writing of files
output/            what commands write: places, what may be replaced there, folders that change places
drawing_style.py   pictures by matplotlib with its own settings
rays.py            rays against triangles
code_cache.py      where compiled code is kept: where no other user can put any
compiled.py        just-in-time compilation with a cache that knows its constants
processes.py       work on many items, spread over processes
parent_death.py    processes that end with the one that started them
fork_server.py     the same for the server that forks the workers
interrupts.py      signals that end a command in order
threads.py         how many threads the libraries may use
progress.py        how stages report their progress; notes to the user
console.py         progress bars or plain lines, and warnings, on the terminal
time_left.py       how long a whole run still takes
errors.py          errors that end a command, with their exit codes; text that is safe to print

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
