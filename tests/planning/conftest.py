"""Runs without images that predictions, plans, exports and edges start from, made once."""

from pathlib import Path

import pytest

from tests.pipeline.conftest import Example, example, undetermined
from tests.pipeline.stored_run import stored

__all__ = ["example", "undetermined"]


@pytest.fixture(scope="session")
def run(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box with a closed mesh."""
    return stored(tmp_path_factory.mktemp("runs") / "box", example, example.surface)


@pytest.fixture(scope="session")
def bare(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without a mesh."""
    return stored(tmp_path_factory.mktemp("runs") / "bare", example)


@pytest.fixture(scope="session")
def spinning(undetermined: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A spin that does not determine the inertia, with a mesh."""
    return stored(tmp_path_factory.mktemp("runs") / "spin", undetermined, undetermined.surface)


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers alone: drawing takes most of the time."""
    monkeypatch.setattr("polhode.planning.plan_files.draw_keepout", lambda *_: b"png")
    for name in ("draw_metric", "draw_contributions"):
        monkeypatch.setattr(f"polhode.planning.observability.pictures.{name}", lambda *_: b"png")
