"""The archives of a small project are built reproducibly, and their faults are found.

That the wheel of polhode itself is complete, and runs, is tested in tests/test_package.py.
"""

import hashlib
import subprocess
import tomllib
import zipfile
from pathlib import Path

import pytest

from polhode.errors import InputError, RunFailure
from release.__main__ import main, make_release
from release.commands import call
from release.distribution import (
    Distribution,
    build,
    check_distribution,
    metadata_faults,
    packaged_files,
    sha256sums,
    wheel_faults,
)

ROOT = Path(__file__).parents[2]
TIME_S = 1_700_000_000


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with our metadata and one room with one module and one data file."""
    folder = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        (folder / name).write_text((ROOT / name).read_text())
    (folder / "polhode").mkdir()
    (folder / "polhode" / "__init__.py").touch()
    (folder / "room").mkdir()
    (folder / "room" / "module.py").write_text("X = 1\n")
    (folder / "room" / "data.yaml").write_text("x: 1\n")
    (folder / "polhode" / "room").symlink_to("../room")
    return folder


@pytest.fixture(scope="module")
def built(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Distribution:
    return build(source, tmp_path_factory.mktemp("built"), TIME_S)


def version() -> str:
    return str(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])


def test_a_right_distribution_passes(built: Distribution, source: Path) -> None:
    assert packaged_files(source) == {
        "polhode/__init__.py",
        "polhode/room/module.py",
        "polhode/room/data.yaml",
    }
    check_distribution(built, source, version())


def test_the_same_source_gives_the_same_bytes(built: Distribution, source: Path, tmp_path: Path) -> None:
    again = build(source, tmp_path, TIME_S)
    assert again.wheel.read_bytes() == built.wheel.read_bytes()
    assert again.sdist.read_bytes() == built.sdist.read_bytes()


def test_a_distribution_of_another_version_is_refused(built: Distribution, source: Path) -> None:
    with pytest.raises(
        RunFailure, match=r"wrong in 2 ways; the first: it is polhode .* instead of polhode 9\.9"
    ):
        check_distribution(built, source, "9.9")


def test_files_too_few_and_too_many_and_changed_ones_are_found(built: Distribution, tmp_path: Path) -> None:
    damaged = tmp_path / built.wheel.name
    with zipfile.ZipFile(built.wheel) as old, zipfile.ZipFile(damaged, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, b"X = 2\n" if name == "polhode/room/module.py" else content)
        new.writestr("polhode/stray.py", "")
    wanted = {
        "polhode/__init__.py",
        "polhode/room/module.py",
        "polhode/room/data.yaml",
        "polhode/room/weights",
    }
    assert wheel_faults(damaged, wanted) == [
        "polhode/room/weights is not in the wheel",
        "polhode/stray.py is in the wheel and not in the source",
        "polhode/stray.py is not in RECORD",
        "RECORD does not fit polhode/room/module.py",
    ]


RIGHT = """Metadata-Version: 2.4
Name: polhode
Version: 1.2.0
Summary: A summary
License-Expression: Apache-2.0
License-File: LICENSE
Requires-Python: >=3.11
Requires-Dist: numpy>=2
Description-Content-Type: text/markdown

# polhode
"""


def test_right_metadata_have_no_fault() -> None:
    assert metadata_faults(RIGHT.encode(), "1.2.0") == []


@pytest.mark.parametrize(
    ("line", "wrong", "fault"),
    [
        ("Summary: A summary\n", "", "Summary is missing"),
        ("License-File: LICENSE\n", "", "License-File is missing"),
        ("text/markdown", "text/x-rst", "Description-Content-Type is not text/markdown"),
        ("\n# polhode\n", "\n", "the description is empty"),
        ("numpy>=2", "numpy=>2", "requires-dist"),
        (
            "Requires-Dist: numpy>=2\n",
            "Requires-Dist: numpy>=2\nClassifier: No :: Such\n",
            "unknown classifier",
        ),
    ],
)
def test_wrong_metadata_are_refused(line: str, wrong: str, fault: str) -> None:
    faults = metadata_faults(RIGHT.replace(line, wrong).encode(), "1.2.0")
    assert len(faults) == 1 and fault in faults[0]


def test_checksums_are_those_that_sha256sum_accepts(tmp_path: Path) -> None:
    files = {"b": b"2", "a": b"1"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "SHA256SUMS").write_text(sha256sums(files))
    assert (tmp_path / "SHA256SUMS").read_text().startswith(f"{hashlib.sha256(b'1').hexdigest()}  a\n")
    command = ["sha256sum", "--check", "--strict", "SHA256SUMS"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "a: OK\nb: OK\n")


def test_a_program_that_fails_or_is_missing_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RunFailure, match=r"'git rev-parse' ended with exit code 128: "):
        call(tmp_path, "git", "rev-parse")
    with pytest.raises(RunFailure, match="no-such-program cannot be started: No such file"):
        call(tmp_path, "no-such-program")


def test_a_mistake_is_one_line_and_exit_2(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["--offline", "-o", str(tmp_path / "dist")]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert captured.err.startswith("release: --offline tries the wheel in no empty environment")
    assert not (tmp_path / "dist").exists()


def test_a_refused_release_writes_nothing(source: Path, tmp_path: Path) -> None:
    """``source`` cites no version."""
    (source / "CITATION.cff").write_text("version: 0\n")
    with pytest.raises(InputError, match=r"CITATION\.cff has the version 0"):
        make_release(source, tmp_path / "dist", is_dry_run=True, is_offline=True)
    assert not (tmp_path / "dist").exists()
