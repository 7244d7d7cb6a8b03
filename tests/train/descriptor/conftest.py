"""Two small bodies from two poses under two Suns each, rendered once."""

from pathlib import Path

import pytest

from polhode.config.train_settings import Corpus, LightStudy
from polhode.runtime.progress import Silent
from polhode.train.descriptor.lit_points import prepare_lit_points
from polhode.train.descriptor.surface_points import ScenePoints
from tests.conftest import MakeOnce

STUDY = LightStudy(bodies=2, suns=2, poses=2)


@pytest.fixture(scope="session")
def lit_corpus(make_once: MakeOnce) -> Corpus:
    """Two free flyers; the second is held out. There are no sequences."""
    folder = make_once("lit_corpus", lambda folder: prepare_lit_points(_corpus(folder), STUDY, Silent(), 1))
    return _corpus(folder)


@pytest.fixture(scope="session")
def lit_points(lit_corpus: Corpus) -> ScenePoints:
    return prepare_lit_points(lit_corpus, STUDY, Silent(), 1)[0]


def _corpus(folder: Path) -> Corpus:
    return Corpus(
        folder=str(folder),
        seed=5,
        scenes=2,
        frames=3,
        validation_every=2,
        families=("free_flyer",),
        other_material=0.0,
        turn_deg=(15.0, 20.0),
        sun_phase_deg=(10.0, 50.0),
        span_px=(110.0, 120.0),
        earth_behind=0.0,
    )
