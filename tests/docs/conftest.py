"""The sequence and the run that the commands of the pages share."""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import pytest

from polhode.cli.main import main
from tests.conftest import MakeOnce
from tests.docs.world import small_sequence

QUICK_RUN = (
    *("--frontend.features.second", "None", "--pictures.views", "False", "--pictures.animation", "False"),
    *("--mapping.voxel-mm", "8", "--runtime.workers", "1"),
)
"""Options that make a run short, besides the small sequence: the answer is that of any run."""


def succeed(words: list[str]) -> str:
    """Run a command of the program; its exit code must be 0. Returns what it printed."""
    printed, failed = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(failed):
        code = main(words)
    assert code == 0, f"polhode {' '.join(words)}: {failed.getvalue()}"
    return printed.getvalue()


@pytest.fixture(scope="session")
def sequence(make_once: MakeOnce, rendered_sequence: Path) -> Path:
    """A sequence of a few pairs."""
    return make_once("docs_sequence", lambda folder: small_sequence(rendered_sequence, folder))


@pytest.fixture(scope="session")
def stored_run(make_once: MakeOnce, sequence: Path) -> Callable[[], Path]:
    """A run of that sequence; it is made when it is asked for."""

    def fill(folder: Path) -> None:
        succeed(["run", "--data", str(sequence), "-o", str(folder), *QUICK_RUN])

    return lambda: make_once("docs_run", fill)
