"""A corpus of two small scenes, rendered once."""

from pathlib import Path

import pytest

from polhode.config.train_settings import Corpus
from polhode.runtime.progress import Silent
from polhode.train.corpus import render_corpus
from tests.conftest import MakeOnce


@pytest.fixture(scope="session")
def tiny_corpus(make_once: MakeOnce) -> Corpus:
    """Two free flyers, four pairs each; the second is held out."""
    folder = make_once("corpus", lambda folder: render_corpus(_corpus(folder), Silent(), 1))
    return _corpus(folder)


def _corpus(folder: Path) -> Corpus:
    return Corpus(
        folder=str(folder),
        seed=3,
        scenes=2,
        frames=4,
        validation_every=2,
        families=("free_flyer",),
        other_material=0.0,
        turn_deg=(15.0, 20.0),
        sun_phase_deg=(10.0, 40.0),
        span_px=(240.0, 260.0),
        earth_behind=0.0,
    )


@pytest.fixture
def training_file(tiny_corpus: Corpus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A configuration that trains the descriptor on it for a few steps and scores it on one pair an angle."""
    monkeypatch.setattr("polhode.train.descriptor.scores.PAIRS_PER_SCENE", 1)
    path = tmp_path / "train.yaml"
    path.write_text(
        f"""seed: 2
runtime: {{workers: 1}}
train:
  task: descriptor
  output: {tmp_path / "out"}
  corpus: {tiny_corpus.model_dump_json()}
  schedule: {{steps: 3, warmup_steps: 1, checkpoint_every: 2, validate_every: 100, log_every: 1}}
  descriptor: {{batch: 48, frame_pairs: 2}}
"""
    )
    return path
