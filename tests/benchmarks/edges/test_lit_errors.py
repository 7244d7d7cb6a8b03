"""Errors under a Sun: one small measurement, and the tables of drawn ones."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.edges import lit_errors
from benchmarks.edges.lit_errors import PREDICTIONS, SURFACES, cases, draw, measure
from polhode.lie import Array

SIGMA = np.array([1e-3, 1e-3, 5e-3, 4e-3, 4e-3, 1e-3])


def line(body: str, seed: int) -> dict[str, Any]:
    """Errors of the size that is expected under the Sun, which the metric knows only on average."""
    rng = np.random.default_rng(seed)
    lit = []
    for surface in SURFACES:
        for sun_deg in (30.0, 50.0, 70.0, 90.0):
            size = np.exp(rng.normal(size=6))
            told: dict[str, Array] = {
                "metric": 20.0 * SIGMA * np.exp(0.1 * rng.normal(size=6)),
                "any Sun": SIGMA * np.exp(0.1 * rng.normal(size=6)),
                "this Sun": SIGMA * size,
            }
            trials = [
                {"error": (SIGMA * size * rng.normal(size=6)).tolist(), "off_px": 0.2, "agreement": 0.95}
                for _ in range(6)
            ]
            trials.append({"error": [0.1] * 6, "off_px": 9.0, "agreement": 0.3})
            lit.append(
                {"surface": surface, "sun_deg": sun_deg, "trials": trials}
                | {name: value.tolist() for name, value in told.items()}
            )
    return {"case": {"body": body}, "lit": lit}


def test_a_case_has_every_sun_and_both_surfaces() -> None:
    case = {**cases(True)[1], "suns": 2, "images": 1}
    told = measure(case)["lit"]
    assert [each["surface"] for each in told] == ["matte"] * 2 + ["own"] * 2
    for matte, own in zip(told[:2], told[2:], strict=True):
        # what is expected knows the shape, not the surface
        assert all(matte[name] == own[name] for name in (*PREDICTIONS, "sun_deg"))
        assert matte["trials"] != own["trials"]
    assert told[0]["this Sun"] != told[1]["this Sun"] and told[0]["any Sun"] == told[1]["any Sun"]
    assert all(20.0 <= each["sun_deg"] <= 100.0 for each in told)
    assert told == measure(case)["lit"]


def test_tables_tell_which_prediction_the_errors_follow(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    lines = [line(body, seed) for seed in range(6) for body in ("bus", "dish")]
    monkeypatch.setattr(lit_errors, "measured", lambda record, wanted: lines)
    lit_errors.main(stored=True, output=tmp_path / "lit.png")
    rows = [row.split(" | ") for row in capsys.readouterr().out.splitlines() if row.startswith("| ")]
    r = {
        (row[0][2:], row[3]): [float(each.strip(" |")) for each in row[4:]]
        for row in rows
        if len(row) == 10 and row[1].isdigit()
    }
    assert min(r["matte, all Suns", "this Sun"]) > 0.7
    assert max(r["matte, all Suns", "any Sun"]) < 0.5
    by_body = {(row[0][2:], row[1]): row[2:] for row in rows if row[0] in ("| bus", "| dish")}
    assert by_body["bus", "own"][:3] == ["86%", "86%", "100%"]
    assert 0.7 < float(by_body["dish", "matte"][3]) < 1.3
    assert (tmp_path / "lit.png").stat().st_size > 10_000


def test_predictions_beyond_the_start_are_not_compared() -> None:
    told = line("bus", 1)
    for each in told["lit"]:
        each["any Sun"][2] = 0.5
    assert not lit_errors._compared(list(lit_errors._lit(told)))
    assert len(lit_errors._compared(list(lit_errors._lit(line("bus", 1))))) == 8


def test_the_picture_of_nothing_is_drawn(tmp_path: Path) -> None:
    draw([], tmp_path / "none.png")
    assert (tmp_path / "none.png").is_file()
