"""The shares, the areas and their limit; the command prints them by family."""

from pathlib import Path

import numpy as np
import pytest

from polhode.config.train_settings import Corpus
from polhode.frontend.features.patch_descriptors import descriptor_network
from polhode.train.descriptor.scores import area_under_curve
from polhode.train.descriptor.surface_points import ScenePoints
from polhode.train.light.predictability import (
    Predictability,
    area_within_pairs,
    limit,
    main,
    predictability,
    table,
)
from tests.train.light.conftest import STUDY


@pytest.mark.parametrize(("a", "b"), [(0.5, 2.0), (2.0, 2.0), (8.0, 20.0)])
def test_the_limit_is_the_area_of_the_true_probabilities(a: float, b: float) -> None:
    rng = np.random.default_rng(7)
    probability = rng.beta(a, b, 20_000)
    shown = rng.integers(4, 9, len(probability))
    found = rng.binomial(shown, probability)
    known = area_under_curve(probability, rng.random(len(probability)) < probability)
    assert limit(found, shown) == pytest.approx(known, abs=0.015)
    # the counts themselves know less
    assert area_under_curve(found / shown, rng.random(len(probability)) < probability) < known


def test_points_that_are_all_alike_have_no_limit() -> None:
    """Their counts differ less than by chance: there is nothing to know."""
    shown = np.full(100, 8)
    assert np.isnan(limit(np.full(100, 4), shown))
    assert np.isnan(limit(np.zeros(100, dtype=int), shown))
    assert np.isnan(limit(np.full(10, 4), np.full(10, 8)))


def test_areas_are_taken_within_pairs_of_images() -> None:
    """A value that only tells the two pairs apart knows nothing within them."""
    pair, found = np.repeat([0, 1], 40), np.arange(80) % 4 < np.repeat([1, 3], 40)
    assert area_within_pairs(pair, found.astype(float), found) == 1.0
    assert area_under_curve(pair + 1e-9 * np.arange(80), found) > 0.7
    assert area_within_pairs(pair, pair + 1e-9 * (np.arange(80) * 7 % 40), found) == pytest.approx(
        0.5, abs=0.1
    )
    assert np.isnan(area_within_pairs(pair, pair.astype(float), np.ones(80, dtype=bool)))


def test_other_light_and_another_pose_cost_matches(lit_points: ScenePoints) -> None:
    result = predictability(lit_points, STUDY, descriptor_network())
    for share in (result.light, result.pose, result.both):
        assert 0.0 < share < 1.0
    assert result.both < max(result.light, result.pose)
    assert result.auc_similarity > max(0.6, result.auc_reliability)
    assert 0.5 < result.auc_limit < 1.0


def test_means_leave_out_what_a_body_does_not_have() -> None:
    one, two = (
        Predictability(0.2, 0.4, 0.1, 0.5, 0.8, float("nan")),
        Predictability(0.4, 0.6, float("nan"), 0.5, 0.8, 0.7),
    )
    rows = table({"bus": [one], "dish": [two]}).splitlines()
    assert rows[-1] == "| all | 2 | 30 | 50 | 10 | 0.50 | 0.80 | 0.70 |"


def test_the_command_prints_a_row_for_each_family(
    lit_corpus: Corpus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(f"train: {{corpus: {lit_corpus.model_dump_json()}, light: {STUDY.model_dump_json()}}}")
    main([str(config), "--workers", "1"])
    rows = [line.split("|")[1:3] for line in capsys.readouterr().out.splitlines()]
    assert [name.strip() for name, _ in rows[2:]] == ["free_flyer", "all"]
    assert rows[3][1].strip() == "2"
