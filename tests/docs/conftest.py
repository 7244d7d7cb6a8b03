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
    *("--frontend.features.second", "None", "--outputs", "motion", "surface"),
    *("--mapping.voxel-mm", "8", "--frontend.depth.method", "sgbm", "--runtime.workers", "1"),
    *("--backend.bounds.intervals", "False"),
)
"""Options that make a run short, besides the small sequence: the answer is that of any run."""


def succeed(words: list[str]) -> None:
    """Run a command of the program; its exit code must be 0."""
    failed = io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(failed):
        code = main(words)
    assert code == 0, f"polhode {' '.join(words)}: {failed.getvalue()}"


@dataclass(frozen=True)
class StoredRuns:
    """Runs of the shared sequence, each made when it is first asked for."""

    sequence: Path
    make_once: MakeOnce

    def plain(self) -> Path:
        """That of all pairs at once, with the default configuration."""
        return self._make("docs_run", ["--data", str(self.sequence)])

    def of(self, words: list[str]) -> Path | None:
        """The one that a command makes; None: it makes another one."""
        match [word for word in words if word not in ("configs/default.yaml", "--resume")]:
            case ["run", "--data", data, "-o", _] if Path(data).resolve() == self.sequence.resolve():
                return self.plain()
            case ["run", "--live", *_]:
                return self._make("docs_live", ["--live", str(self.sequence), "--rate", "0"])
        return None

    def _make(self, name: str, words: list[str]) -> Path:
        return self.make_once(name, lambda folder: succeed(["run", *words, "-o", str(folder), *QUICK_RUN]))


@pytest.fixture(scope="session")
def runs(make_once: MakeOnce, rendered_sequence: Path) -> StoredRuns:
    sequence = make_once("docs_sequence", lambda folder: small_sequence(rendered_sequence, folder))
    return StoredRuns(sequence, make_once)
