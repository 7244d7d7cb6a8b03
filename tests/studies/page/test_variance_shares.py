"""Shares of the variance: exact for a function whose shares are known, by groups and by Sobol indices."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polhode.studies.factors import saltelli
from polhode.studies.page.columns import axes_of, metric_of
from polhode.studies.page.variance_shares import VarianceShares, between_groups, variance_shares
from polhode.studies.table import read_table
from tests.studies.page.conftest import StoreStudy, of_metrics

X, Y, Z = "scene.rig.baseline_m", "scene.interval_s", "backend.accel_psd"


def _stored(store_study: StoreStudy, method: str, count: int) -> VarianceShares:
    def outcome(number: int, values: dict[str, Any]) -> dict[str, Any]:
        x, y, z = (values[name] - 1.5 for name in (X, Y, Z))
        # variances of uniform draws of width 1: 1/12 each; of their product: 1/144
        return of_metrics(evaluate__e=2.0 * x + y + 12.0**0.5 * x * z)

    settings = {name: {"uniform": [1.0, 2.0]} for name in (X, Y, Z)}
    study, folder = store_study(
        outcome, design={"method": method, "count": count, "settings": settings}, steps=[]
    )
    table = read_table(folder)
    return variance_shares(study, axes_of(study, table), metric_of(table, "evaluate.e"))


# 4, 1 and 1 (together) of 6 parts
FIRST, TOTAL = (4 / 6, 1 / 6, 0.0), (5 / 6, 1 / 6, 1 / 6)


def test_sobol_indices_of_a_known_function_are_found(store_study: StoreStudy) -> None:
    pytest.importorskip("SALib", reason="the extra `studies` is not installed: make extras")
    found = _stored(store_study, "saltelli", 256)
    assert found.is_sobol
    for share, first, total in zip(found.shares, FIRST, TOTAL, strict=True):
        assert share.first == pytest.approx(first, abs=0.06) and share.total == pytest.approx(total, abs=0.06)
        assert share.low < first + 0.02 and first - 0.02 < share.high


def test_without_such_a_design_the_groups_give_the_first_order(store_study: StoreStudy) -> None:
    found = _stored(store_study, "sobol", 512)
    assert not found.is_sobol
    for share, first in zip(found.shares, FIRST, strict=True):
        # bins of an eighth of the range leave out 1/64 of the variance of a line
        assert share.first == pytest.approx(first, abs=0.06) and share.total is None
        assert share.low <= share.first <= share.high


def test_points_of_a_saltelli_design_are_those_of_salib() -> None:
    sample = pytest.importorskip(
        "SALib.sample.sobol", reason="the extra `studies` is not installed: make extras"
    )
    points = saltelli(np.random.default_rng(0).uniform(size=(4, 6)))
    first, second = points[0], points[4]
    expected = [first, *([*first[:k], second[k], *first[k + 1 :]] for k in range(3)), second]
    assert np.array_equal(points[:5], np.array(expected))
    problem = {"num_vars": 3, "names": list("abc"), "bounds": [[0.0, 1.0]] * 3}
    theirs = sample.sample(problem, 4, calc_second_order=False, seed=1)
    assert theirs.shape == points.shape
    # in both, a row differs from the first of its five in the same columns
    apart = [np.abs(each.reshape(4, 5, 3) - each.reshape(4, 5, 3)[:, :1]) > 0.0 for each in (points, theirs)]
    assert np.array_equal(apart[0], apart[1])


def test_noise_alone_explains_nothing_and_a_line_everything() -> None:
    rng, group = np.random.default_rng(5), np.repeat(np.arange(5), 40)
    noise = [between_groups(rng.normal(size=200), group) for _ in range(200)]
    # without the correction for chance the mean would be 4 / 199
    assert np.mean(noise) < 0.012
    assert between_groups(group.astype(float), group) == pytest.approx(1.0)


def test_too_few_rows_have_no_share(store_study: StoreStudy, tmp_path: Path) -> None:
    study, folder = store_study(
        lambda number, _: of_metrics(evaluate__e=float(number)), axes={X: [0.1, 0.2]}, steps=[]
    )
    table = read_table(folder)
    found = variance_shares(study, axes_of(study, table), metric_of(table, "evaluate.e"))
    assert np.isnan(found.shares[0].first)
