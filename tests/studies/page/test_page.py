"""study.html: what it says of invented results."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from polhode.cli.main import main
from polhode.studies.page.columns import axes_of, choose_metrics, metrics_of
from polhode.studies.page.write_page import consistencies, write_page
from polhode.studies.steps import FAILED
from polhode.studies.store import Store
from polhode.studies.table import read_table
from tests.studies.page.conftest import StoreStudy, of_metrics

Capture = pytest.CaptureFixture[str]
INTERVAL = "scene.interval_s"
STUDY: dict[str, Any] = {
    "title": "Frame rate <and> front end",
    "axes": {
        INTERVAL: {"log_range": [0.1, 2.0], "count": 4},
        "front end": {
            "variants": {
                "learned": {"frontend.depth.method": "network"},
                "classical": {"frontend.depth.method": "sgbm"},
            }
        },
        "seed": {"range": [0, 7], "count": 8},
    },
    "steps": ["simulate", "run", "evaluate"],
}


def invented(number: int, values: dict[str, Any]) -> dict[str, Any]:
    """Errors that grow with the interval; the slowest of the classical front end fail."""
    rng = np.random.default_rng(number)
    if values[INTERVAL] > 1.0 and values["front end"] == "classical":
        reason = f"run: only {rng.integers(2, 9)} of 12 frames are connected"
        return {"status": FAILED, "reason": reason, "verdict": "failed"}
    error = 0.02 * np.exp(values[INTERVAL] + 0.4 * rng.normal())
    found = of_metrics(
        evaluate__attitude_error_deg__median=error,
        evaluate__rmse_position_m=1e-3 * error * rng.uniform(0.5, 1.5),
        evaluate__error_k1=0.01 * rng.normal(),
        evaluate__mesh__completeness_3mm=rng.uniform(0.6, 0.9),
        evaluate__nees__position=rng.chisquare(3),
        evaluate__nees__attitude=4.0 * rng.chisquare(3),
        evaluate__coverage_3sigma__position=0.998,
    )
    doubts = {"verdict": "degraded", "doubts": "the surface is not closed"} if number == 0 else {}
    return (
        found
        | {"times": {"run.total_s": float(rng.uniform(10.0, 20.0)), "finished": "2026-01-01T00:00:00"}}
        | doubts
    )


@pytest.fixture
def page(store_study: StoreStudy) -> Path:
    study, folder = store_study(invented, **STUDY)
    row = Store(folder).run_folder(study.point(0).address) / "run"
    row.mkdir(parents=True)
    (row / "report.html").write_text("")
    write_page(study, folder)
    return folder / "study.html"


def test_the_page_says_what_holds_what_matters_and_what_failed(page: Path) -> None:
    text = page.read_text()
    assert "Frame rate &lt;and&gt; front end" in text and "64 points: 55 ok, 1 degraded, 8 failed" in text
    sections = re.findall(r'<details class="section" id="([a-z0-9-]+)"', text)
    assert sections[:3] == ["outcome", "variance", "metric-0"]
    assert sections[-4:] == ["consistency", "reasons", "worst", "numbers"]
    # two axes for each metric; the seed is no axis
    assert len(re.findall(r'data-target="plot-metric-0-', text)) == 2
    assert "seed repeats the points" in text
    # reasons that differ by numbers alone are one
    assert "frames are connected" in text and "(and the same with other numbers)" in text
    assert text.count("the surface is not closed") == 1
    # the worst points are told with their seeds
    assert re.search(r"scene\.interval_s \d\S*, front end learned, seed \d", text)
    assert "evaluate.error_k1" in text
    # the report of point 0 was kept
    assert re.search(r'<a href="runs/[0-9a-f]{24}/run/report.html">point 0</a>', text)
    assert "point 1</a>" not in text
    # nothing is loaded from elsewhere
    assert "default-src 'none'" in text and not re.search(r'(src|href)="https?:', text)


def test_columns_are_axes_and_metrics_and_the_study_chooses_what_is_drawn(store_study: StoreStudy) -> None:
    study, folder = store_study(invented, **STUDY, metrics=["evaluate.mesh.*", "time.run.total_s"])
    table = read_table(folder)
    axes, metrics = axes_of(study, table), metrics_of(table)
    assert [(each.name, each.labels, each.is_logarithmic) for each in axes] == [
        (INTERVAL, (), True),
        ("front end", ("learned", "classical"), False),
    ]
    chosen = choose_metrics(metrics, study.settings.metrics, 9)
    assert [each.column for each in chosen] == ["evaluate.mesh.completeness_3mm", "time.run.total_s"]
    assert chosen[0].more_is_better and not chosen[1].more_is_better
    main_ones = choose_metrics(metrics, (), 3)
    titles = ("evaluate.attitude_error_deg.median", "evaluate.rmse_position_m", "|evaluate.error_k1|")
    assert tuple(each.title for each in main_ones) == titles
    assert (main_ones[2].known >= 0.0).all() and main_ones[2].is_logarithmic
    assert "evaluate.coverage_3sigma.position" not in {each.column for each in metrics}  # the same everywhere
    # standard deviations that are too small are called so
    found = consistencies(table)
    assert {each["name"]: each["sigmas"] for each in found} == {
        "NEES, position": "right",
        "NEES, attitude": "too small",
        "coverage, position": "right",
    }
    low, high = map(float, found[1]["band"].split(" to "))
    assert float(found[1]["expected_band"].split()[2]) < low < 12.0 < high and found[1]["expected"] == "3"
    assert int(found[1]["inside"][:-1]) < 80 < int(found[0]["inside"][:-1])
    # of a large table rows at random are read
    few = read_table(folder, 10)
    assert few.num_rows == 10 and few.schema == table.schema
    numbers = few.column("point").to_pylist()
    assert numbers == sorted(set(numbers)) and few == table.take(pa.array(numbers))


def test_a_study_without_results_or_axes_has_a_page_too(store_study: StoreStudy) -> None:
    study, folder = store_study(lambda number, _: {"status": FAILED, "reason": "run: no motion"}, steps=[])
    write_page(study, folder)
    text = (folder / "study.html").read_text()
    assert "1 point: 1 point without a result." in text
    assert "run: no motion" in text


def test_the_page_is_written_again_when_asked_and_nothing_is_computed(
    page: Path, tmp_path: Path, capsys: Capture
) -> None:
    page.unlink()
    words = ["sweep", str(tmp_path / "study.yaml"), "-o", str(page.parent)]
    assert main([*words, "--page-only"]) == 0
    assert f"Page: {page}" in capsys.readouterr().out and page.is_file()
    assert main([*words, "--page-only", "--dry-run"]) == 2
    assert "contradict each other" in capsys.readouterr().err
    assert main([*words[:-1], str(tmp_path / "new"), "--page-only"]) == 2
    printed = capsys.readouterr().err
    assert "no study of polhode sweep" in printed and printed.count("\n") == 1
    assert not (tmp_path / "new").exists()
