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


def test_listed_values_stay_as_they_are() -> None:
    assert levels(values=("a", 1, 2.5, (0, 1))) == ["a", 1, 2.5, [0, 1]]


def test_a_range_has_equal_steps_and_a_logarithmic_one_equal_ratios() -> None:
    assert levels(range=(1.0, 2.0), count=5) == [1.0, 1.25, 1.5, 1.75, 2.0]
    found = np.array(levels(log_range=(0.01, 100.0), count=5))
    np.testing.assert_allclose(found[1:] / found[:-1], 10.0)


def test_settings_that_are_whole_numbers_get_whole_numbers() -> None:
    found = levels("scene.frames", range=(10, 20), count=3)
    assert found == [10, 15, 20] and all(type(each) is int for each in found)
    assert all(type(each) is float for each in levels("scene.interval_s", range=(1, 3), count=3))


def test_draws_follow_their_seed_and_two_axes_with_one_seed_are_independent() -> None:
    one = levels("a.b", uniform=(0, 1), count=200, seed=5)
    assert one == levels("a.b", uniform=(0, 1), count=200, seed=5)
    assert one != levels("a.b", uniform=(0, 1), count=200, seed=6)
    other = levels("a.c", uniform=(0, 1), count=200, seed=5)
    # of 200 independent pairs, one correlation in 1000 is beyond 3.3 sigma
    assert abs(np.corrcoef(one, other)[0, 1]) < 3.3 / np.sqrt(200)


@pytest.mark.parametrize(
    ("axis", "law"),
    [
        ({"uniform": (2.0, 5.0)}, stats.uniform(2.0, 3.0)),
        ({"log_uniform": (0.1, 10.0)}, stats.loguniform(0.1, 10.0)),
        ({"normal": (4.0, 0.5)}, stats.norm(4.0, 0.5)),
    ],
)
def test_draws_have_the_distribution_that_is_asked_for(axis: dict[str, Any], law: Any) -> None:
    assert stats.kstest(levels(count=500, seed=1, **axis), law.cdf).pvalue > 0.01


def test_a_latin_hypercube_has_one_draw_in_every_slice_of_every_setting() -> None:
    factor = drawn("latin_hypercube", **{"a.b": {"uniform": (0, COUNT)}, "a.c": {"uniform": (0, COUNT)}})
    for column in np.array(factor.values).T:
        assert sorted(np.floor(column).astype(int)) == list(range(COUNT))


def test_sobols_sequence_fills_the_square_more_evenly_than_independent_draws() -> None:
    settings = {"a.b": {"uniform": (0, 1)}, "a.c": {"uniform": (0, 1)}}
    discrepancy = {
        method: stats.qmc.discrepancy(np.array(drawn(method, **settings).values))
        for method in ("random", "latin_hypercube", "sobol")
    }
    assert discrepancy["sobol"] < discrepancy["latin_hypercube"] < discrepancy["random"]


def test_a_design_draws_listed_values_equally_often() -> None:
    factor = drawn("latin_hypercube", **{"backend.solver": {"values": ["ipopt", "gauss_newton"]}})
    assert [row[0] for row in factor.values].count("ipopt") == COUNT // 2


def test_variants_set_several_settings_under_one_name() -> None:
    axis = Axis.model_validate(
        {"variants": {"small": {"scene": {"body": {"size_m": 0.1}}}, "far": {"scene.frames": 3}}}
    )
    factor = factor_of_axis("target", axis, "study.yaml")
    assert factor.values == (("small",), ("far",))
    assert factor.changes == ({"scene.body.size_m": 0.1}, {"scene.frames": 3})
    assert factor.settings == {"scene.body.size_m", "scene.frames"}


def test_a_value_that_comes_twice_is_refused() -> None:
    with pytest.raises(InputError, match="the value 3 comes twice"):
        levels("seed", values=(3, 4, 3))
    # rounded to whole numbers, these are no longer ten
    with pytest.raises(InputError, match="comes twice"):
        levels("scene.frames", range=(1, 3), count=10)


def test_validity_is_tried_at_the_ends_of_numbers_and_at_every_listed_word() -> None:
    numbers = factor_of_axis("a.b", Axis(uniform=(0, 1), count=1000), "")
    values = [row[0] for row in numbers.values]
    assert set(numbers.extremes()) == {0, values.index(min(values)), values.index(max(values))}
    assert list(factor_of_axis("a.b", Axis(values=("x", "y", "z")), "").extremes()) == [0, 1, 2]
