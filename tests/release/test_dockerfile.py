"""The Dockerfile's steps are the Makefile's, their files exist, and nothing that they need is ignored."""

import re
import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
Instruction = tuple[str, str]


@pytest.fixture(scope="module")
def instructions() -> list[Instruction]:
    """Names and arguments, continued lines as one."""
    text = re.sub(r"(?m)^#.*\n", "", (ROOT / "Dockerfile").read_text()).replace("\\\n", " ")
    words = (line.split(maxsplit=1) for line in text.splitlines() if line.strip())
    return [(name, " ".join(rest.split())) for name, rest in words]


def ignored(name: str) -> bool:
    """Whether a name at the top of the repository is left out of what is copied."""
    return any(fnmatch(name, pattern) for pattern in (ROOT / ".dockerignore").read_text().split())


def planned(*words: str) -> str:
    """What make would run."""
    command = ["make", "--always-make", "--dry-run", *words]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def test_it_begins_from_an_image_of_the_oldest_python_that_is_supported(
    instructions: list[Instruction],
) -> None:
    oldest = re.search(r'requires-python = ">=(.*)"', (ROOT / "pyproject.toml").read_text())
    assert oldest is not None
    assert instructions[0] == ("FROM", f"python:{oldest[1]}-slim-bookworm")


def test_what_it_copies_exists_and_is_not_ignored(instructions: list[Instruction]) -> None:
    copies = [rest.split()[1:-1] for name, rest in instructions if name == "COPY"]
    assert copies[-1] == ["."] and "constraints.txt" in copies[0]
    names = [name for each in copies[:-1] for name in each]
    assert [name for name in names if not (ROOT / name).is_file() or ignored(name)] == []


def test_all_that_a_run_needs_is_copied_and_nothing_that_is_not_tracked() -> None:
    rooms = [path.name for path in (ROOT / "polhode").iterdir() if path.is_symlink()]
    assert [name for name in (*rooms, "polhode", "configs", "sample", "Makefile") if ignored(name)] == []
    untracked = (".git", ".venv", "data", "dist", "runs", ".mypy_cache", ".ruff_cache", ".pytest_cache")
    assert [name for name in untracked if not ignored(name)] == []


def test_dependencies_are_a_layer_of_their_own_in_their_tested_versions(
    instructions: list[Instruction],
) -> None:
    names = [name for name, _ in instructions]
    install = instructions.index(("RUN", "make setup EXTRAS="))
    assert names[install - 1 : install + 2] == ["COPY", "RUN", "COPY"]
    # without a module of the package, the installation would lead nowhere
    assert instructions[install - 1][1].endswith("polhode/__init__.py polhode/")
    assert "--constraint constraints.txt --editable '.'" in planned("setup", "EXTRAS=")
    assert "--constraint constraints.txt --editable '.[dev]'" in planned("setup")


def test_nothing_but_the_system_is_set_up_by_root(instructions: list[Instruction]) -> None:
    users = [place for place, (name, _) in enumerate(instructions) if name == "USER"]
    by_root = [rest for name, rest in instructions[: users[0]] if name == "RUN"]
    assert len(users) == 1 and instructions[users[0]] == ("USER", "polhode")
    assert [rest.split()[0] for rest in by_root] == ["apt-get", "useradd"]


def test_the_demo_is_what_make_demo_runs_into_the_folder_that_is_mounted(
    instructions: list[Instruction],
) -> None:
    assert instructions[-1] == ("CMD", '["make", "demo"]')
    directory = next(rest for name, rest in instructions if name == "WORKDIR")
    commands = planned("demo")
    assert ".venv/bin/polhode run configs/default.yaml --data sample -o runs/demo" in commands
    assert "runs/demo/report.html" in commands
    for page in ("Dockerfile", "docs/release.md"):
        assert f'--volume "$PWD/runs:{directory}/runs" polhode' in (ROOT / page).read_text()
