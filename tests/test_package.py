"""The distribution: built, installed and run where nothing of this repository can be found."""

import csv
import os
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FRAMES = 8
LIGHT = (
    *("--backend.window.enabled", "False"),
    *("--frontend.depth.method", "sgbm"),
    *("--mapping.voxel-mm", "10"),
)
"""Options that make a run of a few frames short."""


@dataclass(frozen=True)
class Installation:
    """An environment with the distribution, and a folder to work in."""

    python: Path
    packages: Path
    empty: Path

    def run(self, *command: str | Path) -> subprocess.CompletedProcess[str]:
        clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        return subprocess.run(command, cwd=self.empty, env=clean, capture_output=True, text=True)


@pytest.fixture(scope="module")
def installation(tmp_path_factory: pytest.TempPathFactory) -> Installation:
    """The wheel of the sdist, installed beside foreign packages that are named as folders of ours."""
    folder = tmp_path_factory.mktemp("package")
    _call(ROOT, sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder)
    # of our own making; Python 3.11.2 of Debian 12 has no filters of tarfile yet
    shutil.unpack_archive(next(folder.glob("*.tar.gz")), folder / "source")
    source = next((folder / "source").iterdir())
    _call(source, sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder)
    python = folder / "environment" / "bin" / "python"
    _call(folder, sys.executable, "-m", "venv", "--without-pip", folder / "environment")
    wheel = next(folder.glob("*.whl"))
    options = ("install", "--quiet", "--no-deps", "--no-index", "--no-compile")
    _call(folder, sys.executable, "-m", "pip", "--python", python, *options, wheel)
    packages = next((folder / "environment" / "lib").iterdir()) / "site-packages"
    # What polhode depends on; an editable installation there is not seen, because its own .pth is not read.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    for name in ("train", "backend"):
        (packages / name).mkdir()
        (packages / name / "__init__.py").write_text("raise ImportError('a foreign package was imported')\n")
    _give_compiled(packages / "polhode")
    (folder / "empty").mkdir()
    return Installation(python, packages, folder / "empty")


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


def _call(folder: Path, *command: str | Path) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_distribution_installs_one_package_and_one_program(installation: Installation) -> None:
    record = next(installation.packages.glob("polhode-*.dist-info")) / "RECORD"
    with record.open(newline="") as stream:
        files = [row[0] for row in csv.reader(stream)]
    tops = {name.partition("/")[0] for name in files if not name.startswith("../")}
    assert tops == {"polhode", record.parent.name}
    assert [Path(name).name for name in files if name.startswith("../")] == ["polhode"]


def test_every_file_of_the_rooms_is_installed(installation: Installation) -> None:
    """The links of ``polhode/`` are followed, and data files come along."""
    rooms = [path.name for path in (ROOT / "polhode").iterdir() if path.is_symlink()]
    listed = subprocess.run(
        ["git", "ls-files", "polhode", *rooms], cwd=ROOT, check=True, capture_output=True, text=True
    )
    names = [name for name in listed.stdout.splitlines() if not (ROOT / name).is_symlink()]
    wanted = {name if name.startswith("polhode/") else f"polhode/{name}" for name in names}
    here = installation.packages
    found = {str(path.relative_to(here)) for path in (here / "polhode").rglob("*") if path.is_file()}
    assert len(rooms) >= 9 and wanted - found == set()


def test_the_program_runs_without_configuration_from_an_empty_folder(installation: Installation) -> None:
    sequence = installation.empty / "sequence"
    _first_frames(ROOT / "sample", sequence)
    version = installation.run(installation.python, "-m", "polhode", "--version")
    assert version.returncode == 0 and version.stdout.startswith("polhode ")
    program = installation.python.with_name("polhode")
    done = installation.run(program, "run", "--data", "sequence", "-o", "result", *LIGHT)
    assert done.returncode == 0, done.stdout + done.stderr
    result = installation.empty / "result"
    assert done.stdout.rstrip().endswith(str(Path("result") / "report.html"))
    assert (result / "trajectory.csv").read_text().count("\n") == FRAMES + 1
    assert (result / "mesh.ply").is_file()


def test_the_default_configuration_is_inside(installation: Installation) -> None:
    code = "from polhode.config.loader import DEFAULT_CONFIG, load_config; print(load_config(DEFAULT_CONFIG))"
    done = installation.run(installation.python, "-c", code)
    assert done.returncode == 0, done.stderr
    assert (ROOT / "configs" / "default.yaml").samefile(ROOT / "polhode" / "config" / "default.yaml")


def _first_frames(sequence: Path, copy: Path) -> None:
    """The sample's first frames, without its truth."""
    for camera in ("cam0", "cam1"):
        source, folder = sequence / "mav0" / camera, copy / "mav0" / camera
        (folder / "data").mkdir(parents=True)
        shutil.copy(source / "sensor.yaml", folder)
        lines = (source / "data.csv").read_text().splitlines(keepends=True)[: FRAMES + 1]
        (folder / "data.csv").write_text("".join(lines))
        for line in lines[1:]:
            shutil.copy(source / "data" / f"{line.partition(',')[0]}.png", folder / "data")
