"""The wheel: built, installed and run where nothing of this repository can be found."""

import csv
import os
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.docs.world import FRAMES, small_sequence

ROOT = Path(__file__).parents[1]
LIGHT = (
    *("--frontend.features.second", "None", "--frontend.depth.method", "sgbm"),
    *("--backend.window.enabled", "False", "--backend.bounds.intervals", "False", "--mapping.voxel-mm", "10"),
    *("--outputs", "motion", "surface"),
)
"""Options that make a run of a few frames short."""


@dataclass(frozen=True)
class Environment:
    """A virtual environment in a folder of its own, with the dependencies of this one."""

    folder: Path

    @property
    def python(self) -> Path:
        return self.folder / "environment" / "bin" / "python"

    @property
    def packages(self) -> Path:
        return next((self.folder / "environment" / "lib").iterdir()) / "site-packages"

    def run(self, *command: str | Path) -> str:
        """What a command prints that knows nothing of ours: an empty folder, a home of its own."""
        work, home = self.folder / "work", self.folder / "home"
        for each in (work, home):
            each.mkdir(exist_ok=True)
        path = f"{self.python.parent}{os.pathsep}{os.defpath}"
        given = {"HOME": str(home), "PATH": path, "LANG": "C.UTF-8"}
        done = subprocess.run(command, cwd=work, env=given, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """The wheel, installed beside foreign packages that are named as folders of ours."""
    environment = Environment(tmp_path_factory.mktemp("package"))
    archives = environment.folder / "archives"
    build = (sys.executable, "-m", "hatchling", "build", "-d", archives, "-t", "wheel")
    subprocess.run(build, cwd=ROOT, check=True)
    venv = (sys.executable, "-m", "venv", "--without-pip", environment.folder / "environment")
    subprocess.run(venv, check=True)
    options = ("--quiet", "--disable-pip-version-check", "--no-compile", "--no-deps", "--no-index")
    pip = (sys.executable, "-m", "pip", "--python", environment.python, "install", *options)
    subprocess.run((*pip, next(archives.glob("*.whl"))), check=True)
    # An editable installation there is not seen, because its own .pth is not read.
    (environment.packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    for name in ("train", "backend"):
        (environment.packages / name).mkdir()
        foreign = environment.packages / name / "__init__.py"
        foreign.write_text("raise ImportError('a foreign package was imported')\n")
    _give_compiled(environment.packages / "polhode")
    return environment


def _give_compiled(package: Path) -> None:
    """Machine code that numba compiled from the same files: compiling them again is not what is tested."""
    for index in (ROOT / "polhode").glob("*/**/__pycache__/*.nbi"):
        folder = package / index.parent.relative_to(ROOT / "polhode")
        folder.mkdir(exist_ok=True)
        for file in (index, *index.parent.glob(f"{index.stem}.*.nbc")):
            shutil.copy(file, folder)
    for source in (ROOT / "polhode").glob("*/**/*.py"):
        # numba knows a file by its size and its time
        copy = package / source.relative_to(ROOT / "polhode")
        if copy.is_file():
            os.utime(copy, ns=(source.stat().st_atime_ns, source.stat().st_mtime_ns))


def test_the_distribution_installs_one_package_and_one_program(installation: Environment) -> None:
    record = next(installation.packages.glob("polhode-*.dist-info")) / "RECORD"
    with record.open(newline="") as stream:
        files = [row[0] for row in csv.reader(stream)]
    tops = {name.partition("/")[0] for name in files if not name.startswith("../")}
    assert tops == {"polhode", record.parent.name}
    assert [Path(name).name for name in files if name.startswith("../")] == ["polhode"]


def test_every_file_of_the_rooms_is_installed(installation: Environment) -> None:
    """The links of ``polhode/`` are followed, and data files come along."""
    rooms = ("backend", "frontend", "train")
    listed = subprocess.run(
        ["git", "ls-files", "polhode", *rooms], cwd=ROOT, check=True, capture_output=True, text=True
    )
    names = [name for name in listed.stdout.splitlines() if not (ROOT / name).is_symlink()]
    wanted = {name if name.startswith("polhode/") else f"polhode/{name}" for name in names}
    here = installation.packages
    found = {str(path.relative_to(here)) for path in (here / "polhode").rglob("*") if path.is_file()}
    assert wanted - found == set() and "polhode/py.typed" in found


def test_the_program_runs_without_configuration_from_an_empty_folder(
    installation: Environment, rendered_sequence: Path
) -> None:
    small_sequence(rendered_sequence, installation.folder / "work" / "sequence")
    assert installation.run(installation.python, "-m", "polhode", "--version").startswith("polhode ")
    program = installation.python.with_name("polhode")
    said = installation.run(program, "run", "--data", "sequence", "-o", "result", *LIGHT)
    result = installation.folder / "work" / "result"
    assert said.rstrip().endswith(str(Path("result") / "report.html"))
    assert (result / "trajectory.csv").read_text().count("\n") == FRAMES + 1
    assert (result / "mesh.ply").is_file()
