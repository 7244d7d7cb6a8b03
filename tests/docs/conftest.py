"""The sequence and the run that the commands of the pages share."""

import contextlib
import io
from dataclasses import dataclass
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


@dataclass(frozen=True)
class StoredRuns:
    """Runs of the shared sequence, each made when it is first asked for."""

    sequence: Path
    make_once: MakeOnce

    def plain(self) -> Path:
        """That of all pairs at once, with the default configuration."""
        return self._made("docs_run", ["--data", str(self.sequence)])

    def live(self) -> Path:
        """That of the pairs one at a time."""
        return self._made("docs_live", ["--live", str(self.sequence), "--rate", "0"])

    def of(self, words: list[str]) -> Path | None:
        """The one that a command makes; None: it makes another one."""
        match [word for word in words if word not in ("configs/default.yaml", "--resume")]:
            case ["run", "--data", data, "-o", _] if Path(data).resolve() == self.sequence.resolve():
                return self.plain()
            case ["run", "--live", *_]:
                return self.live()
        return None

    def _made(self, name: str, words: list[str]) -> Path:
        def fill(folder: Path) -> None:
            succeed(["run", *words, "-o", str(folder), *QUICK_RUN])

        return self.make_once(name, fill)


@pytest.fixture(scope="session")
def runs(make_once: MakeOnce, sequence: Path) -> StoredRuns:
    """Runs of that sequence."""
    return StoredRuns(sequence, make_once)
