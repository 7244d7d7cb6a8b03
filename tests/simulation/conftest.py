"""Bodies for small scenes: what several tests see is built once, which takes longer than their images."""

from collections.abc import Iterator
from functools import lru_cache

import pytest

from polhode.config.scene_settings import TargetBody
from polhode.simulation.bodies import Body, build_body

_built = lru_cache(maxsize=16)(build_body)


def _build_once(body: TargetBody, seed: int) -> Body:
    # a file may have changed
    return build_body(body, seed) if body.family == "mesh" else _built(body, seed)


@pytest.fixture(scope="module", autouse=True)
def bodies_are_built_once() -> Iterator[None]:
    """Where sequences are planned and drawn; tests of the bodies themselves build their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("polhode.simulation.dataset.plan.build_body", _build_once)
        yield
