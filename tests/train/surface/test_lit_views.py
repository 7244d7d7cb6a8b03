"""Images of one pose show the same surface; their sightings are where the truth says."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from polhode.config.train_settings import Corpus
from polhode.errors import InputError
from polhode.progress import Silent
from polhode.train.surface.lit_views import (
    FACING_AWAY,
    LIT,
    RIGHT_PX,
    SKY,
    LitViews,
    main,
    prepare_views,
    views_path,
)
from tests.train.surface.conftest import SURFACE


def test_images_of_one_pose_differ_in_their_light_alone(lit_views: LitViews) -> None:
    first, again = np.flatnonzero(lit_views.pose == 0)
    assert np.array_equal(lit_views.light[first] == SKY, lit_views.light[again] == SKY)
    assert np.array_equal(lit_views.corner_px[first], lit_views.corner_px[again])
    assert (lit_views.light[first] != lit_views.light[again]).mean() > 0.02
    assert np.abs(lit_views.grey[first].astype(float) - lit_views.grey[again]).mean() > 5.0


def test_what_faces_away_from_the_sun_is_darker(lit_views: LitViews) -> None:
    lit, away = lit_views.light == LIT, lit_views.light == FACING_AWAY
    assert lit.sum() > 1000 and away.sum() > 100
    assert lit_views.grey[away].mean() < 0.5 * lit_views.grey[lit].mean()


def test_under_another_sun_the_true_place_is_the_same_pixel(lit_views: LitViews) -> None:
    views, found = lit_views, np.flatnonzero(lit_views.match >= 0)
    same = found[views.pose[views.view[views.point[found]]] == views.pose[views.other[found]]]
    off = views.uv_px[views.match[same]] - views.uv_px[views.point[same]]
    assert len(same) > 40
    np.testing.assert_allclose(views.off_px[same], off, atol=1e-3)
    assert np.array_equal(views.view[views.match[found]], views.other[found])


def test_matches_are_near_the_true_place_and_better_than_chance(lit_views: LitViews) -> None:
    off = np.linalg.norm(lit_views.off_px, axis=1)
    assert off.max() < RIGHT_PX
    assert np.all(off[lit_views.match < 0] == 0.0)
    found = off[lit_views.match >= 0]
    # chance would spread them over the disc: half of them beyond 2.1 px
    assert np.median(found) < 1.0
    assert 0.05 < np.mean(lit_views.match >= 0) < 0.95


def test_only_missing_bodies_are_rendered_and_a_damaged_file_is_refused(
    lit_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(lit_corpus.folder, folder)
    corpus = lit_corpus.model_copy(update={"folder": str(folder)})
    path = views_path(corpus, SURFACE, 1)
    before = path.stat().st_mtime_ns
    views = prepare_views(corpus, SURFACE, Silent(), 1)
    assert path.stat().st_mtime_ns == before and sorted(views) == [0, 1]
    config = tmp_path / "config.yaml"
    config.write_text(f"train: {{corpus: {corpus.model_dump_json()}, surface: {SURFACE.model_dump_json()}}}")
    main([str(config), "--workers", "1"])
    assert capsys.readouterr().out == f"2 bodies: {folder}\n"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match=r"remove this file, and it is made again"):
        prepare_views(corpus, SURFACE, Silent(), 1)
    other = corpus.model_copy(update={"turn_deg": (15.0, 40.0)})
    with pytest.raises(InputError, match=r"contains a corpus with another turn_deg"):
        prepare_views(other, SURFACE, Silent(), 1)
