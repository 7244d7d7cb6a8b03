"""The comparison of runs before a background and before the sky: factors, and what is not determined."""

from typing import Any

import pytest

from benchmarks.end_to_end.backgrounds import HEAD, SCENES, factors, rows_of, verdict


def _figures(scale: float, k1: float | None = 0.002) -> dict[str, Any]:
    errors: dict[str, float | None] = dict.fromkeys(
        ("position", "velocity", "w", "attitude", "axes", "k2", "com", "chamfer"), 0.1 * scale
    )
    sigma: dict[str, float | None] = dict.fromkeys(("position", "velocity", "w", "k2", "com"), 0.2)
    return {
        "errors": {**errors, "k1": k1},
        "sigma": {**sigma, "k1": k1},
        "doubtful": 3.4,
        "pairs": [59, 60],
        "status": "ok",
    }


def _line(scale: float, k1: float | None = 0.002) -> dict[str, Any]:
    case = {"config": "configs/scenes/earth_behind.yaml", "short": False}
    return {"case": case, "background": _figures(scale, k1), "sky": {**_figures(1.0), "doubtful": None}}


def test_factors_are_those_of_the_errors() -> None:
    found = factors(_line(1.2), "errors")
    assert found["position"] == pytest.approx(1.2) and found["k1"] == pytest.approx(1.0)
    assert factors(_line(1.2, None), "errors")["k1"] is None
    assert factors(_line(1.2), "sigma")["attitude"] is None


def test_the_table_has_both_runs_and_their_factor() -> None:
    rows = [list(row) for row in rows_of(_line(1.2))]
    assert all(len(row) == HEAD.count("|") + 1 for row in rows)
    assert rows[0][:3] == ["earth_behind", "no mask", "0.120"] and rows[0][-2:] == ["3 %", "59 of 60"]
    assert rows[2][1:3] == ["factor", "1.20"]
    assert list(rows_of(_line(1.2, None))[2])[7] == "-"


def test_figures_above_the_factor_are_named() -> None:
    assert verdict([_line(1.4)]) == "Within a factor 1.5: 9 of 9 errors."
    assert verdict([_line(1.4), _line(1.6, None)]).startswith(
        "Within a factor 1.5: 9 of 17 errors; above: earth_behind position 1.60, "
    )


def test_every_scene_is_there() -> None:
    assert all(path.is_file() for path in SCENES)
