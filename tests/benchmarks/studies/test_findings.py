"""Findings: known laws are found in invented tables, and the page quotes what the command prints."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from benchmarks.studies import findings
from benchmarks.studies.confidence import (
    geometric_mean,
    median,
    powers,
    quantile,
    rank_correlation,
    share,
    share_text,
    significant,
)
from benchmarks.studies.findings import FINDINGS, missing, parts_of, with_tables
from benchmarks.studies.study_results import Part, Results
from polhode.studies.study import open_study
from polhode.studies.table import schema_of
from tests.docs.page_code import ROOT

Capture = pytest.CaptureFixture[str]
Outcome = Callable[[dict[str, Any], np.random.Generator], dict[str, Any]]
PAGE = (ROOT / "docs" / "study_findings.md").read_text()


def invented(name: str, outcome: Outcome) -> Results:
    """A ready study with results that follow a law."""
    study, rows = open_study(ROOT / "configs" / "studies" / f"{name}.yaml"), []
    for number in range(study.count):
        values = study.point(number).values
        rows.append(
            {
                "point": number,
                **values,
                **{"status": "done", "reason": None, "verdict": "ok", "doubts": None},
                **outcome(values, np.random.default_rng(number)),
            }
        )
    schema = schema_of(rows)
    return Results(
        study, pa.table({f.name: [row.get(f.name) for row in rows] for f in schema}, schema=schema)
    )


def part(parts: list[Part], title: str) -> dict[str, list[str]]:
    """Cells of a table by their first one; "" has the names of columns."""
    (found,) = (each for each in parts if title in each.title)
    lines = found.table.splitlines()
    cells = [line.strip("| ").split(" | ") for line in [lines[0], *lines[2:]]]
    return {"": cells[0][1:]} | {row[0]: row[1:] for row in cells[1:]}


def test_intervals_of_shares_and_medians_hold_for_few_points() -> None:
    # Clopper and Pearson (1934): of 10 of 10, the lower end solves p^10 = 0.025
    assert share(10, 10).low == pytest.approx(0.025**0.1)
    assert share_text(0, 8) == "0 of 8 (0% to 37%)"
    found = median(np.arange(1.0, 10.0))
    # the 2nd and the 8th of nine: at most 1 of 9 heads, 2 * 10 / 2^9
    assert (found.value, found.low, found.high) == (5.0, 2.0, 8.0)
    assert median(np.arange(4.0)).text() == "1.5" and median(np.array([np.nan])).text() == "-"
    assert not np.isfinite(quantile(np.arange(20.0), 0.9).high)


def test_a_law_of_powers_is_found_in_groups_of_their_own() -> None:
    rng = np.random.default_rng(0)
    turned, pairs = np.exp(rng.uniform(0.0, 3.0, (2, 200)))
    groups = ["a", "b"] * 100
    errors = turned**-2.0 * pairs**-0.5 * np.where(np.arange(200) % 2, 5.0, 1.0)
    errors *= np.exp(0.3 * rng.normal(size=200))
    found = powers(errors, {"turned": turned, "pairs": pairs}, groups)
    assert found is not None and found.sigma == pytest.approx(0.3, rel=0.15)
    for name, true in (("turned", -2.0), ("pairs", -0.5)):
        assert found.exponents[name].low < true < found.exponents[name].high
        assert found.exponents[name].high - found.exponents[name].low < 0.2
    assert powers(errors[:3], {"turned": turned[:3], "pairs": pairs[:3]}) is None
    # one pair count alone tells nothing of pairs
    assert powers(errors, {"turned": turned, "pairs": np.full(200, 30.0)}) is None


def test_ratios_and_correlations() -> None:
    found = geometric_mean(np.array([2.0, 8.0]))
    assert found.value == pytest.approx(4.0) and found.low < 2.0 and found.high > 8.0
    assert geometric_mean(np.array([3.0])).text() == "3" and geometric_mean(np.array([])).text() == "-"
    values = np.arange(30.0)
    assert rank_correlation(values, np.exp(values)).value == pytest.approx(1.0)
    assert rank_correlation(values, np.ones(30)).text() == "-"
    assert [significant(each) for each in (179.99, 0.05234, 7.91, float("nan"))] == [
        "180",
        "0.052",
        "7.9",
        "-",
    ]


def of_images(**factors: Callable[[Any], float]) -> Outcome:
    """Errors that are products of what the settings say; a name with an underscore is part of a setting's."""

    def outcome(values: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        size = float(np.exp(0.05 * rng.normal()))
        for key, value in values.items():
            for name, factor in factors.items():
                size *= factor(value) if key.endswith(name) else 1.0
        return {
            "evaluate.attitude_error_deg.median": 0.1 * size,
            "evaluate.rmse_position_m": 1e-3 * size,
            "evaluate.nees.position": float(rng.chisquare(3)),
        }

    return outcome


def test_of_a_rig_the_exponents_are_found() -> None:
    law = of_images(baseline_m=lambda b: b**-1.0, focal_px=lambda f: (f / 300.0) ** -1.0)
    found = part(FINDINGS["rig_for_target"].parts(invented("rig_for_target", law)), "Exponents")
    cells = dict(zip(found[""], found["position [mm]"], strict=True))
    assert float(cells["scene.rig.baseline_m"].split()[0]) == pytest.approx(-1.0, abs=0.1)
    assert float(cells["scene.rig.focal_px"].split()[0]) == pytest.approx(-1.0, abs=0.1)
    assert float(cells["scene.motion.position_m.2"].split()[0]) == pytest.approx(0.0, abs=0.1)


def test_of_a_rig_runs_are_grouped_by_the_pixels_across_the_target() -> None:
    # an image of 60 px needs a metre of baseline
    def outcome(values: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        pixels = values["scene.rig.focal_px"] / values["scene.motion.position_m.2"]
        ok = pixels > 80.0 or (pixels > 40.0 and values["scene.rig.baseline_m"] == 1.0)
        return {"verdict": "ok" if ok else "degraded", "evaluate.attitude_error_deg.median": 3.0 / pixels}

    parts = FINDINGS["rig_for_target"].parts(invented("rig_for_target", outcome))
    assert [row[0] for row in part(parts, "By pixels across").values()][1:] == [
        share_text(0, 9),
        share_text(4, 12),
        share_text(6, 6),
        share_text(6, 6),
        share_text(3, 3),
    ]
    crossed = part(parts, "Runs that are ok")
    assert crossed[""] == ["0.1 m", "0.3162 m", "1 m"]
    assert [cell.partition(";")[0] for cell in crossed["40 to 80"]] == ["0 of 4", "0 of 4", "4 of 4"]
    assert crossed["200 to 400"][0] == "1 of 1; 0.01"


def test_of_light_a_lamp_is_compared_with_the_same_scene_without() -> None:
    law = of_images(lamp=lambda lamp: 0.5 if lamp > 0.0 else 1.0)
    parts = FINDINGS["light"].parts(invented("light", law))
    found = part(parts, "Errors over those at scene.light.lamp 0")
    assert found["0.2"][0] == "20" and found["0.2"][1].startswith("0.5")
    shares = part(parts, "Share of the variance")
    assert shares[""] == ["Sun to camera [deg]", "scene.light.earth", "scene.light.lamp"]
    assert part(parts, "Runs that are ok")[""] == ["0", "0.2"]


@pytest.mark.parametrize("name", ["share_of_texture", "noise_and_resolution", "front_ends"])
def test_other_studies_of_images_have_levels_and_ratios(name: str) -> None:
    results = invented(name, of_images())
    titles = [each.title for each in FINDINGS[name].parts(results)]
    for axis in results.axes:
        assert f"Medians along {axis.name}" in titles
        assert any(title.startswith(f"Errors over those at {axis.name} ") for title in titles)


def test_of_a_mission_broken_volumes_are_counted_with_clopper_and_pearson() -> None:
    def outcome(values: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        far = values["scene.motion.position_m.2"] > 1.0
        return {
            "verdict": "degraded" if far else "ok",
            "evaluate.prediction_error_deg.30": values["scene.motion.position_m.2"] ** 3,
            "plan.truth.swept_body_left": far,
            "plan.truth.swept_body_farthest_m": 0.002 if far else 0.0,
            "plan.truth.instant_body_left": far,
            "plan.truth.instant_body_farthest_m": 0.003 if far else 0.0,
            "evaluate.attitude_error_deg.median": float(rng.uniform(0.1, 0.2)),
        }

    results = invented("one_mission", outcome)
    far = int((results.settings["scene.motion.position_m.2"] > 1.0).sum())
    parts = FINDINGS["one_mission"].parts(results)
    (title,) = (each for each in parts if each.title.startswith("Keep-out volumes"))
    rows = [list(map(str, row)) for row in title.rows]
    assert rows[0][2:] == ["all", share_text(far, 16), "2.0"]
    assert rows[1][2:] == ["ok", share_text(0, 16 - far), "-"]
    assert len(left := part(parts, "Missions whose body left")) == far + 1
    assert {row[-1] for row in left.values()} == {"farthest [mm]", "3"}
    unknowns = part(parts, "Rank correlations")
    assert unknowns["scene.motion.position_m.2"][0].startswith("1.00")


def test_of_solvers_claims_above_the_least_cost_are_named() -> None:
    def outcome(values: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        stem = "compare.flip-40-600"
        wrong = values["compare.monte_carlo.seed"] == 1
        found: dict[str, Any] = {"verdict": None}
        for solver, cost, seconds in (("good", 10.0, 1.0), ("rash", 10.5 if wrong else 10.0, 3.0)):
            found |= {
                f"{stem}.{solver}.cold0.status": "ok",
                f"{stem}.{solver}.cold0.cost": cost,
                f"{stem}.{solver}.cold0.iterations": 7,
                f"{stem}.{solver}.cold0.errors.attitude_deg": 0.1,
                f"time.{stem}.{solver}.cold0.wall_s": seconds,
            }
        return found | {
            f"{stem}.plain.cold0.status": "baseline",
            f"{stem}.plain.cold0.cost": 99.0,
            f"{stem}.plain.cold0.errors.attitude_deg": 0.4 + 0.001 * float(rng.normal()),
        }

    parts = FINDINGS["optimizers_over_bodies"].parts(invented("optimizers_over_bodies", outcome))
    assert part(parts, "Solved")["rash"] == [share_text(16, 20), "7 (7 to 7)"]
    claims = part(parts, "Convergence claimed")
    assert claims["rash"] == ["cold", share_text(4, 20), "5.0% to 5.0%"] and "good" not in claims
    assert part(parts, "Time over")["rash"][:3] == [
        share_text(0, 20),
        share_text(0, 20),
        share_text(16, 20),
    ]
    assert part(parts, "Errors of baselines")["plain"][2].startswith("4 ")


def test_a_wrong_name_and_a_missing_study_give_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="lights: no such finding; there are: frame_rate_against_spin"):
        findings.main(("lights",))
    with pytest.raises(SystemExit, match="is missing"):
        findings.main(("light",), tmp_path)
    assert missing("every_run", tmp_path) != [] and missing("every_run", findings.RESULTS) == []


SECTIONS = {
    match[1]: section
    for section in re.split(r"^## ", PAGE, flags=re.MULTILINE)
    if (match := re.search(r"python -m benchmarks\.studies\.findings (\w+)", section))
}
"""Of the page, by the finding whose command it shows"""


def test_tables_of_a_page_are_replaced_where_they_stand() -> None:
    stands = "| a |\n|---|\n| 1 |\n"
    section = f"## A\n\npython -m benchmarks.studies.findings light\n\nOne:\n\n{stands}\nAnd so on.\n"
    other = section.replace("## A", "## B").replace("light", "rig_for_target")
    parts = [Part("One", "a", [["2"]]), Part("Two", "b", [["3"]])]
    assert with_tables(section + other, "light", parts) == section.replace("| 1 |", "| 2 |") + other


def test_every_study_that_is_there_has_its_section() -> None:
    there = {name for name in FINDINGS if not missing(name, findings.RESULTS)}
    assert set(SECTIONS) == there


@pytest.mark.parametrize("name", SECTIONS)
def test_the_page_quotes_what_the_command_prints(name: str) -> None:
    section, parts = SECTIONS[name], parts_of(name)
    said = "\n".join(f"{each.title}\n{each.table}" for each in parts)
    rows = [line for line in section.splitlines() if line.startswith("|")]
    assert rows and [row for row in rows if row not in said.splitlines()] == []
    assert with_tables(section, name, parts) == section
    # decimals, percentages and "3 of 4" in the text are in the tables, too
    text = "\n".join(line for line in section.splitlines() if not line.startswith("|"))
    text = text.replace("95 %", "")
    numbers = re.findall(r"-?\d+\.\d+|\d+ of \d+|\d+(?= %)", text)
    tokens = set(re.findall(r"-?\d+\.\d+|\d+ of \d+|\d+(?=%)", said))
    assert [each for each in numbers if each not in tokens] == []
