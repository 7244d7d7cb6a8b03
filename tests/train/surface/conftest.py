"""Three small bodies from two poses under two Suns each, rendered once."""

from pathlib import Path

import pytest

from polhode.config.train_settings import Corpus, SurfaceTraining
from polhode.runtime.progress import Silent
from polhode.train.surface.landmarks import KnownBody, prepare_bodies
from tests.conftest import MakeOnce

CONFIG = SurfaceTraining(bodies=3, suns=2, poses=2, pairs=2, points=40, crop_px=96)


@pytest.fixture(scope="session")
def lit_body_corpus(make_once: MakeOnce) -> Corpus:
    """The second body is held out."""
    folder = make_once("lit_bodies", lambda folder: prepare_bodies(_corpus(folder), CONFIG, Silent(), 1))
    return _corpus(folder)


@pytest.fixture(scope="session")
def bodies(lit_body_corpus: Corpus) -> dict[int, KnownBody]:
    return prepare_bodies(lit_body_corpus, CONFIG, Silent(), 1)


def _corpus(folder: Path) -> Corpus:
    return Corpus(
        folder=str(folder),
        seed=5,
        scenes=3,
        frames=3,
        validation_every=2,
        families=("free_flyer", "asteroid"),
        other_material=0.0,
        turn_deg=(15.0, 20.0),
        sun_phase_deg=(10.0, 50.0),
        span_px=(110.0, 120.0),
        earth_behind=0.0,
    )
