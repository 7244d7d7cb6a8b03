"""The study of the simplified problem: the slides' findings, and the figure."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmarks.edges.planar import (
    CASES,
    HALF_HEIGHT_M,
    MEAN_OVER_RMS,
    SIGMA_RAD,
    exponent,
    folded_errors,
    main,
    mean_errors,
    middles,
    model,
    monte_carlo,
    six_models,
)


def test_the_middle_edge_goes_from_the_top_to_the_centre() -> None:
    places = middles()
    assert len(places) == 6 and places[-1] == 0.0 and 0.0 < places[0] < HALF_HEIGHT_M
    np.testing.assert_allclose(np.diff(places), places[1] - places[0])


def test_model_6_is_best_in_the_metric_of_each_component() -> None:
    diagonal, _ = six_models(1, 0)
    assert np.all(np.diff(diagonal, axis=0) < 0.0)


@pytest.mark.parametrize("seed", [0, 1])
def test_errors_follow_the_root_of_the_metric(seed: int) -> None:
    diagonal, errors = six_models(20 * CASES, seed)
    assert all(each.ended.all() for each in errors)
    means = mean_errors(errors)
    # of 2000 mean absolute values: sigma 1.7 %
    np.testing.assert_allclose(means / (MEAN_OVER_RMS * SIGMA_RAD * np.sqrt(diagonal)), 1.0, atol=0.08)
    for i in range(3):
        assert np.corrcoef(np.sqrt(diagonal[:, i]), means[:, i])[0, 1] > 0.995
        assert exponent(diagonal[:, i], means[:, i]) == pytest.approx(0.5, abs=0.05)


def test_one_step_from_afar_costs_much_and_convergence_does_not() -> None:
    errors = monte_carlo(model(0.0), 500, (0,), spread=20.0)
    assert errors.ended.all()
    one_step, converged = ((each**2).mean(axis=0) for each in (errors.one_step, errors.converged))
    assert np.all(one_step > 4.0 * converged)


def test_arccos_fails_where_an_edge_is_near_the_axis_and_only_there() -> None:
    crossed, signed, folded = folded_errors(0.01, 1000, 0)
    assert 0.1 < crossed < 0.25 and np.all(folded > 5.0 * signed)
    crossed, signed, folded = folded_errors(0.2, 1000, 0)
    assert crossed == 0.0
    np.testing.assert_allclose(folded, signed, rtol=0.01)


def test_the_command_prints_its_tables_and_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("MANY", "REPEATS"):
        monkeypatch.setattr(f"benchmarks.edges.planar.{name}", 20)
    path = tmp_path / "new" / "planar.png"
    main(output=path)
    out = capsys.readouterr().out
    assert sum(line.startswith("|---") for line in out.splitlines()) == 6
    assert "All 600 cases converged: True" in out and not {"nan", "inf"} & set(out.split())
    with Image.open(path) as picture:
        assert picture.width > 1000 and len(picture.getcolors(1 << 24) or []) > 10
