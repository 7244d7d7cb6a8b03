"""The archives of a small project are built reproducibly, and their faults are found.

That the wheel of polhode itself is complete, and runs, is tested in tests/test_package.py.
"""

import shutil
import tomllib
import zipfile
from pathlib import Path

import pytest

from lab.release.__main__ import main, make_release
from lab.release.commands import call
from lab.release.distribution import Distribution, build, check_distribution, metadata_faults, packaged_files
from polhode.runtime.errors import InputError, RunFailure

ROOT = Path(__file__).parents[2]
VERSION = str(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"])
TIME_S = 1_700_000_000
METADATA = """Metadata-Version: 2.4
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


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with our metadata and one linked room with one module and one data file."""
    folder = tmp_path_factory.mktemp("source")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, folder)
    for path, text in {
        "polhode/__init__.py": "",
        "room/module.py": "X = 1\n",
        "room/data.yaml": "x: 1\n",
    }.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text)
    (folder / "polhode" / "room").symlink_to("../room")
    return folder


@pytest.fixture(scope="module")
def built(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Distribution:
    return build(source, tmp_path_factory.mktemp("built"), TIME_S)


def test_a_right_distribution_passes_and_has_the_same_bytes_again(
    built: Distribution, source: Path, tmp_path: Path
) -> None:
    assert packaged_files(source) == {
        "polhode/__init__.py",
        "polhode/room/module.py",
        "polhode/room/data.yaml",
    }
    check_distribution(built, source, VERSION)
    again = build(source, tmp_path, TIME_S)
    assert again.wheel.read_bytes() == built.wheel.read_bytes()
    assert again.sdist.read_bytes() == built.sdist.read_bytes()


def test_another_version_and_files_too_few_and_too_many_are_found(
    built: Distribution, source: Path, tmp_path: Path
) -> None:
    with pytest.raises(RunFailure, match=r"in 2 ways; the first: it is polhode .* instead of polhode 9\.9"):
        check_distribution(built, source, "9.9")
    damaged = tmp_path / built.wheel.name
    with zipfile.ZipFile(built.wheel) as old, zipfile.ZipFile(damaged, "w") as new:
        for name in old.namelist():
            if name != "polhode/room/module.py":
                new.writestr(name, old.read(name))
        new.writestr("polhode/stray.py", "")
    with pytest.raises(
        RunFailure, match=r"in 2 ways; the first: polhode/room/module\.py is not in the wheel"
    ):
        check_distribution(Distribution(built.sdist, damaged), source, VERSION)


@pytest.mark.parametrize(
    ("line", "wrong", "fault"),
    [
        ("Summary: A summary\n", "Summary: A summary\n", None),
        ("Summary: A summary\n", "", "summary is missing"),
        ("License-File: LICENSE\n", "", "license_files is missing"),
        ("text/markdown", "text/x-rst", "Description-Content-Type is not text/markdown"),
        ("\n# polhode\n", "\n", "description is missing"),
        ("numpy>=2", "numpy=>2", "requires-dist"),
        ("Summary:", "Classifier: No :: Such\nSummary:", "unknown classifier"),
    ],
)
def test_wrong_metadata_are_refused(line: str, wrong: str, fault: str | None) -> None:
    faults = metadata_faults(METADATA.replace(line, wrong).encode(), "1.2.0")
    assert len(faults) == (fault is not None) and all(fault in each for each in faults if fault)


def test_a_program_that_fails_or_is_missing_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(RunFailure, match=r"'git rev-parse' ended with exit code 128: "):
        call(tmp_path, "git", "rev-parse")
    with pytest.raises(RunFailure, match="no-such-program cannot be started: No such file"):
        call(tmp_path, "no-such-program")


def test_a_refused_release_is_one_line_and_writes_nothing(
    source: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["--offline", "-o", str(tmp_path / "dist")]) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1
    assert captured.err.startswith("release: --offline tries the wheel in no empty environment")
    (source / "CITATION.cff").write_text("version: 0\n")
    with pytest.raises(InputError, match=r"CITATION\.cff has the version 0"):
        make_release(source, tmp_path / "dist", is_dry_run=True, is_offline=True)
    assert not (tmp_path / "dist").exists()
