"""Values of axes and designs."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from polhode.config.study_settings import Axis, Design
from polhode.runtime.errors import InputError
from polhode.studies.factors import Factor, factor_of_axis, factor_of_design

COUNT = 64


def levels(name: str = "backend.accel_psd", **axis: Any) -> list[Any]:
    factor = factor_of_axis(name, Axis(**axis), "study.yaml")
    assert factor.columns == (name,)
    assert [each[name] for each in factor.changes] == [row[0] for row in factor.values]
    return [row[0] for row in factor.values]


def drawn(method: str, **settings: Any) -> Factor:
    return factor_of_design(
        Design.model_validate({"method": method, "count": COUNT, "seed": 3, "settings": settings})
    )


def test_lists_ranges_and_variants() -> None:
    assert levels(values=("a", 1, 2.5, (0, 1))) == ["a", 1, 2.5, [0, 1]]
    assert levels(range=(1.0, 2.0), count=5) == [1.0, 1.25, 1.5, 1.75, 2.0]
    found = np.array(levels(log_range=(0.01, 100.0), count=5))
    np.testing.assert_allclose(found[1:] / found[:-1], 10.0)
    # settings that are whole numbers get whole numbers
    whole = levels("scene.frames", range=(10, 20), count=3)
    assert whole == [10, 15, 20] and all(type(each) is int for each in whole)
    assert all(type(each) is float for each in levels("scene.interval_s", range=(1, 3), count=3))
    for values in ({"values": (3, 4, 3)}, {"range": (1, 3), "count": 10}):
        with pytest.raises(InputError, match=r"the value . comes twice"):
            levels("scene.frames", **values)
    # variants set several settings under one name
    named = {"small": {"scene": {"body": {"size_m": 0.1}}}, "far": {"scene.frames": 3}}
    factor = factor_of_axis("target", Axis.model_validate({"variants": named}), "study.yaml")
    assert factor.values == (("small",), ("far",))
    assert factor.changes == ({"scene.body.size_m": 0.1}, {"scene.frames": 3})
    assert factor.settings == {"scene.body.size_m", "scene.frames"}
    # validity is tried at the ends of numbers and at every listed word
    numbers = factor_of_axis("a.b", Axis(uniform=(0, 1), count=1000), "")
    drawn = [row[0] for row in numbers.values]
    assert set(numbers.extremes()) == {0, drawn.index(min(drawn)), drawn.index(max(drawn))}
    assert list(factor_of_axis("a.b", Axis(values=("x", "y", "z")), "").extremes()) == [0, 1, 2]


def test_draws_follow_their_seed_and_two_axes_with_one_seed_are_independent() -> None:
    one = levels("a.b", uniform=(0, 1), count=200, seed=5)
    assert one == levels("a.b", uniform=(0, 1), count=200, seed=5)
    assert one != levels("a.b", uniform=(0, 1), count=200, seed=6)
    # of 200 independent pairs, one correlation in 1000 is beyond 3.3 sigma
    other = levels("a.c", uniform=(0, 1), count=200, seed=5)
    assert abs(np.corrcoef(one, other)[0, 1]) < 3.3 / np.sqrt(200)
    laws: dict[str, Any] = {
        "uniform": ((2.0, 5.0), stats.uniform(2.0, 3.0)),
        "log_uniform": ((0.1, 10.0), stats.loguniform(0.1, 10.0)),
        "normal": ((4.0, 0.5), stats.norm(4.0, 0.5)),
    }
    for name, (pair, law) in laws.items():
        assert stats.kstest(levels(count=500, seed=1, **{name: pair}), law.cdf).pvalue > 0.01


def test_designs_fill_their_settings_evenly() -> None:
    factor = drawn("latin_hypercube", **{"a.b": {"uniform": (0, COUNT)}, "a.c": {"uniform": (0, COUNT)}})
    for column in np.array(factor.values).T:
        assert sorted(np.floor(column).astype(int)) == list(range(COUNT))
    settings = {"a.b": {"uniform": (0, 1)}, "a.c": {"uniform": (0, 1)}}
    discrepancy = [
        stats.qmc.discrepancy(np.array(drawn(method, **settings).values))
        for method in ("sobol", "latin_hypercube", "random")
    ]
    assert discrepancy == sorted(discrepancy)
    factor = drawn("latin_hypercube", **{"backend.solver": {"values": ["ipopt", "gauss_newton"]}})
    assert [row[0] for row in factor.values].count("ipopt") == COUNT // 2
