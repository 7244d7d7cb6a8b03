"""The pair that is drawn is the one that shares the most light among those whose motion is wrong."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.frontend import failures
from benchmarks.frontend.failures import draw, worst_pair
from benchmarks.frontend.matching import settings
from benchmarks.frontend.scenes import UnseenScene, scene_of

SAMPLE = Path(__file__).parents[3] / "sample"


def test_worst_pair_is_found_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(UnseenScene, "__len__", lambda _: 3)
    scene, config = scene_of(SAMPLE / "scene.yaml", SAMPLE), settings("rootsift-2x")
    # neighbouring frames of the sample are matched well
    assert worst_pair("sample", scene, config) is None
    monkeypatch.setattr(failures, "WRONG_DEG", 0.0)
    found = worst_pair("sample", scene, config)
    assert found is not None
    assert found.lit_px == max(scene.lit_in_both(*pair) for pair in ((0, 1), (1, 2), (0, 2)))
    assert 0.2 < found.right.mean() < 1.0
    sizes = [image.shape[::-1] for image in found.images]
    for ends, size in zip(found.ends_px, sizes, strict=True):
        assert len(ends) == len(found.right)
        assert (ends > -1).all() and (ends < size).all()
    picture = tmp_path / "failures.png"
    draw([found], picture)
    assert np.ptp(np.asarray(Image.open(picture).convert("L"))) > 100
