"""The wheel, installed into an empty environment and run there on a few pairs of the sample.

Nothing of the checkout can be found there: the folder, the home and the environment are new, and the pairs
are copies.
"""

import json
import os
import shutil
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from lab.release.commands import call
from polhode.runtime.errors import RunFailure

PAIRS = 8
LIGHT = (
    *("--backend.window.enabled", "False"),
    *("--frontend.depth.method", "sgbm"),
    *("--mapping.voxel-mm", "10"),
)
"""Options that make a run of a few frames short."""


@dataclass(frozen=True)
class Environment:
    """A virtual environment in a folder of its own."""

    folder: Path

    @property
    def python(self) -> Path:
        """Its interpreter."""
        return self.folder / "environment" / "bin" / "python"

    @property
    def packages(self) -> Path:
        """Where its packages are."""
        return next((self.folder / "environment" / "lib").iterdir()) / "site-packages"

    def run(self, *command: str | Path) -> str:
        """What a command prints that knows nothing of ours: an empty folder, a home of its own."""
        work, home = self.folder / "work", self.folder / "home"
        for each in (work, home):
            each.mkdir(exist_ok=True)
        path = f"{self.python.parent}{os.pathsep}{os.defpath}"
        return call(work, *command, environment={"HOME": str(home), "PATH": path, "LANG": "C.UTF-8"})


def make_environment(folder: Path, wheel: Path, constraints: Path | None) -> Environment:
    """An environment in ``folder`` with the wheel.

    With ``constraints`` its dependencies are installed from the package index in these versions; without,
    those of this environment are used and nothing is downloaded. Raises RunFailure: something cannot be
    installed.
    """
    environment = Environment(folder)
    call(folder, sys.executable, "-m", "venv", "--without-pip", folder / "environment")
    pip = (sys.executable, "-m", "pip", "--python", environment.python)
    install = (*pip, "install", "--quiet", "--disable-pip-version-check", "--no-compile")
    if constraints is not None:
        call(folder, *install, "--constraint", constraints, wheel)
        call(folder, *pip, "check")
    else:
        call(folder, *install, "--no-deps", "--no-index", wheel)
        # An editable installation there is not seen, because its own .pth is not read.
        (environment.packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return environment


def try_program(environment: Environment, sample: Path, version: str) -> None:
    """Version, help, weights, and a run on a copy of the first pairs of ``sample``.

    Raises RunFailure: one of them is not as it should be.
    """
    program, result = environment.python.with_name("polhode"), environment.folder / "work" / "result"
    where = environment.run(environment.python, "-c", "import polhode; print(polhode.__file__)").strip()
    _require(Path(where).is_relative_to(environment.packages), f"polhode is imported from {where}")
    printed = environment.run(program, "--version").strip()
    _require(printed == f"polhode {version}", f"'polhode --version' prints '{printed}' for version {version}")
    _require("evaluate" in environment.run(program, "--help"), "'polhode --help' lists no commands")
    copy_first_pairs(sample, environment.folder / "work" / "sequence", PAIRS)
    environment.run(program, "run", "--data", "sequence", "-o", "result", *LIGHT)
    frames = json.loads((result / "summary.json").read_text(encoding="utf-8"))["frames"]
    _require(frames == PAIRS, f"the run on {PAIRS} pairs has {frames} frames")
    for name in ("report.html", "trajectory.csv", "mesh.ply"):
        _require((result / name).is_file(), f"the run wrote no {name}")


def copy_first_pairs(sequence: Path, copy: Path, number: int) -> None:
    """Copy the first ``number`` pairs of a sequence, without its truth."""
    for camera in ("cam0", "cam1"):
        source, folder = sequence / "mav0" / camera, copy / "mav0" / camera
        (folder / "data").mkdir(parents=True)
        shutil.copy(source / "sensor.yaml", folder)
        lines = (source / "data.csv").read_text().splitlines(keepends=True)[: number + 1]
        (folder / "data.csv").write_text("".join(lines))
        for line in lines[1:]:
            shutil.copy(source / "data" / f"{line.partition(',')[0]}.png", folder / "data")


def _require(holds: bool, fault: str) -> None:
    if not holds:
        raise RunFailure(f"in the empty environment, {fault}")
