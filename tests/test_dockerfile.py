"""The Dockerfile's steps are the Makefile's, and nothing that they need is ignored. No image is built."""

import re
import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
Instruction = tuple[str, str]


@pytest.fixture(scope="module")
def instructions() -> list[Instruction]:
    """Names and arguments, continued lines as one."""
    text = re.sub(r"(?m)^#.*\n", "", (ROOT / "Dockerfile").read_text()).replace("\\\n", " ")
    words = (line.split(maxsplit=1) for line in text.splitlines() if line.strip())
    return [(name, " ".join(rest.split())) for name, rest in words]


def planned(*words: str) -> str:
    """What make would run."""
    command = ["make", "--always-make", "--dry-run", *words]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout


def test_all_that_a_run_needs_is_copied_and_nothing_that_is_not_tracked(
    instructions: list[Instruction],
) -> None:
    patterns = (ROOT / ".dockerignore").read_text().split()

    def ignored(name: str) -> bool:
        return any(fnmatch(name, pattern) for pattern in patterns)

    copied = [name for kind, rest in instructions if kind == "COPY" for name in rest.split()[1:-1]]
    assert copied[-1] == "." and "constraints.txt" in copied
    assert [name for name in copied[:-1] if not (ROOT / name).is_file()] == []
    needed = (*copied[:-1], "backend", "frontend", "train", "polhode", "configs", "examples", "Makefile")
    assert [name for name in needed if ignored(name)] == []
    untracked = (".git", ".venv", "data", "dist", "runs", ".mypy_cache", ".ruff_cache", ".pytest_cache")
    assert [name for name in untracked if not ignored(name)] == []


def test_it_installs_and_runs_as_make_does_and_not_as_root(instructions: list[Instruction]) -> None:
    oldest = re.search(r'requires-python = ">=(.*)"', (ROOT / "pyproject.toml").read_text())
    assert oldest is not None and instructions[0] == ("FROM", f"python:{oldest[1]}-slim-bookworm")
    install = instructions.index(("RUN", "make setup EXTRAS="))
    # without a module of the package, the installation would lead nowhere
    assert instructions[install - 1][1].endswith("polhode/__init__.py polhode/")
    assert "--constraint constraints.txt --editable '.'" in planned("setup", "EXTRAS=")
    user = instructions.index(("USER", "polhode"))
    by_root = [rest.split()[0] for name, rest in instructions[:user] if name == "RUN"]
    assert user < install and by_root == ["apt-get", "useradd"]
    assert instructions[-1] == ("CMD", '["make", "demo"]')
    assert "-o runs/demo" in planned("demo")
    directory = next(rest for name, rest in instructions if name == "WORKDIR")
    assert f'--volume "$PWD/runs:{directory}/runs" polhode' in (ROOT / "docs/release.md").read_text()
