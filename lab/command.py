"""The command line of a benchmark: the parameters of its ``main`` are the options."""

import fcntl
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, arg

from polhode.runtime.threads import limit_threads

ROOT = Path(__file__).resolve().parents[1]
RECORDS = Path(__file__).with_name("records")
"""Records that are kept in the repository: they take hours to measure, on any machine."""

Short = Annotated[bool, arg(help="A small version that takes seconds to minutes.")]
Workers = Annotated[int, arg(help="Processes.")]
Record = Annotated[
    Path,
    arg(help="Folder of the results, a study; cases that it holds are not measured again.", metavar="DIR"),
]
Png = Annotated[Path | None, arg(aliases=["-o"], metavar="PNG", help="Draw the figure to this file.")]
Runs = Positional[Annotated[tuple[Path, ...], arg(metavar="RUN", help="Folders of runs.")]]
Sequences = Positional[Annotated[tuple[Path, ...], arg(metavar="SEQ", help="Folders of sequences.")]]
Configuration = Annotated[Path, arg(help="Configuration.")]
Seeds = Annotated[int, arg(help="Generated sequences of each kind.")]
DEFAULT = Path("configs/default.yaml")


def command(main: Callable[..., None]) -> None:
    """Call ``main`` with the options of the command line; the help is the docstring of its module.

    BLAS, OpenCV and torch use one thread each.
    """
    limit_threads(1)
    module = sys.modules[main.__module__]
    name = module.__spec__.name if module.__spec__ is not None else module.__name__
    name = name.removesuffix(".__main__")
    tyro.cli(main, prog=f"python -m {name}", description=module.__doc__, config=(FlagCreatePairsOff,))


def polhode(*arguments: object, may_fail: bool = False) -> None:
    """Run the program as a user does; with ``may_fail`` a failed run (exit code 1) is accepted."""
    words = [sys.executable, "-m", "polhode", *map(str, arguments)]
    done = subprocess.run(words, cwd=ROOT, check=False)
    if done.returncode > (1 if may_fail else 0):
        raise SystemExit(done.returncode)


QUICK = ("--scene.render.samples", "1", "--scene.render.bounces", "0", "--runtime.workers", "1")
"""Options that make rendering quick, for short forms."""
LIGHT = {
    "frontend.features.second": None,
    "outputs": ("motion", "surface"),
    "mapping.voxel_mm": 10.0,
}
"""Settings that make a run quick, for short forms."""


def simulated(config: Path, folder: Path, *options: str) -> Path:
    """The sequence of a scene, simulated unless it is there."""
    return _made_once(folder, "simulate", config, "-o", folder, *options)


def _made_once(folder: Path, *words: object) -> Path:
    """The sequence that a command makes, unless it is there; another benchmark that wants it waits."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_name(f".{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "mav0").is_dir():
            polhode(*words)
    return folder


def evaluated_run(config: Path) -> Path:
    """The run of a scene with the default configuration, with its errors; made unless it is in runs/.

    A run that fails says so in its summary.json and has no metrics.json.
    """
    sequence, run = simulated(config, ROOT / "data" / config.stem), ROOT / "runs" / config.stem
    if not (run / "summary.json").is_file():
        polhode("run", DEFAULT, "--data", sequence, "-o", run, "--overwrite", may_fail=True)
    if (run / "trajectory.csv").is_file() and not (run / "metrics.json").is_file():
        polhode("evaluate", run, sequence)
    return run


def short_scene() -> Path:
    """A few pairs of a body that no network was trained on, for short forms; made once."""
    config = ROOT / "configs/frontend_test/asteroid.yaml"
    return simulated(config, ROOT / "runs/short/frontend", "--scene.frames", "5", *QUICK)


def beginning_of_sample() -> Path:
    """The first seconds of the sample as a sequence, for short forms; made once."""
    folder = ROOT / "runs/short/beginning"
    return _made_once(folder, "import", "examples/sample", "-o", folder, "--end", 4.0, "--overwrite")
