"""Two small bodies from two poses under two Suns each, rendered once."""

from pathlib import Path

import pytest

from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.progress import Silent
from polhode.train.surface.lit_views import LitViews, prepare_views
from tests.conftest import MakeOnce

SURFACE = SurfaceTraining(suns=2, poses=2, max_points=150, bodies=2, images=2, crop_px=96)


@pytest.fixture(scope="session")
def lit_corpus(make_once: MakeOnce) -> Corpus:
    """Two free flyers; the second is held out."""
    folder = make_once("lit_corpus", lambda folder: prepare_views(_corpus(folder), SURFACE, Silent(), 1))
    return _corpus(folder)


@pytest.fixture(scope="session")
def lit_views(lit_corpus: Corpus) -> LitViews:
    return prepare_views(lit_corpus, SURFACE, Silent(), 1)[0]


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
        span_px=(90.0, 100.0),
        earth_behind=0.0,
    )
