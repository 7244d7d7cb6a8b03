"""Rules of thumb: a known law is found, bands hold what they promise, and what is beyond the runs is said."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from polhode.cli.main import main
from polhode.studies.rules import (
    PREDICTORS,
    SHIPPED,
    Observation,
    Rule,
    Rules,
    checked,
    expected,
    fit,
    outside,
    read_rules,
)

Capture = pytest.CaptureFixture[str]
LAW = np.array([-3.0, -1.0, -0.5, 0.3, -0.8, 0.4])
WORDS = [
    *("--size", "3", "--range", "10", "--rpm", "2", "--focal-px", "1200", "--baseline", "0.3"),
    *("--interval", "0.5", "--pairs", "20"),
]


def observations(count: int, seed: int) -> list[Observation]:
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        size, away = np.exp(rng.uniform(np.log(0.3), np.log(3.0))), rng.uniform(3.0, 6.0)
        focal, share = rng.uniform(200.0, 2000.0), rng.uniform(0.02, 0.2)
        times = rng.uniform(1.0, 20.0), rng.uniform(0.1, 2.0)
        pairs, sun = int(rng.integers(10, 30)), rng.uniform(10.0, 100.0)
        found.append(
            Observation(size, away * size, times[0], focal, share * away * size, times[1], pairs, sun)
        )
    return found


def errors(seen: list[Observation], scatter: float, seed: int) -> Any:
    noise = np.random.default_rng(seed).normal(0.0, scatter, len(seen))
    return np.exp(np.array([each.row for each in seen]) @ LAW + noise)


def rule_of(count: int, scatter: float, **about: Any) -> Rule:
    seen = observations(count, 1)
    return fit(seen, errors(seen, scatter, 2), **({"quantity": "e", "unit": "deg"} | about))


def rules_of(*found: Rule) -> Rules:
    ranges = dict.fromkeys(PREDICTORS, (0.001, 10000.0))
    return Rules(made_by="a test", runs=100, failed=7, ranges=ranges, rules=found)


def written(path: Path, rules: Rules, /, **change: Any) -> Path:
    path.write_text(yaml.safe_dump(rules.model_dump(mode="json") | change))
    return path


@pytest.mark.parametrize("count", [24, 120])
def test_nine_tenths_of_new_runs_are_inside_the_band_also_of_a_fit_to_few(count: int) -> None:
    inside = []
    for seed in range(30):
        seen, new = observations(count, seed), observations(30, 1000 + seed)
        rule = fit(seen, errors(seen, 0.5, seed), quantity="e", unit="deg")
        measured = errors(new, 0.5, 500 + seed)
        bands = [expected(rules_of(rule), each)[0] for each in new]
        inside.append(sum(b.low <= error <= b.high for b, error in zip(bands, measured, strict=True)))
        # runs that were left out, and new ones, are counted by the same band
        found = checked(rule, new, measured)
        assert (found.new, found.new_inside, found.held_out) == (30, inside[-1], count)
    # runs of one fit share its error, so that these are no 900 independent draws
    assert 0.86 < np.mean(inside) / 30 < 0.94
    rule = rule_of(300, 0.4)
    assert rule.held_out == 300 and 0.85 < rule.inside / 300 < 0.95


def test_rules_of_this_version_are_used_if_it_has_any(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    if SHIPPED.is_file():
        own = read_rules()
        assert own.rules and all(rule.new > 0 for rule in own.rules)
    shipped = tmp_path / "rules_of_thumb.yaml"
    monkeypatch.setattr("polhode.studies.rules.SHIPPED", shipped)
    assert main(["expect", *WORDS]) == 2
    printed = capsys.readouterr().err
    assert "no rules of thumb come with this version: give with --rules" in printed
    assert printed.count("\n") == 1
    rule = rule_of(90, 0.3).model_copy(update={"new": 30, "new_inside": 28})
    written(shipped, rules_of(rule))
    assert main(["expect", *WORDS]) == 0
    assert "28 of 30\n" in capsys.readouterr().out


def test_a_law_of_powers_is_found_and_an_error_over_the_size_grows_with_it() -> None:
    rule = rule_of(400, 0.2)
    assert np.abs(np.array(rule.coefficients) - LAW).max() < 0.25 and rule.explained > 0.9
    assert rule.sigma == pytest.approx(0.2, rel=0.1) and rule.freedom == 394
    rules = rules_of(rule_of(60, 0.1, over="size", factor=1000.0, unit="mm"), rule_of(60, 0.1))
    small = Observation(1.0, 4.0, 3.0, 600.0, 0.3, 0.5, 20, 45.0)
    large = Observation(2.0, 8.0, 3.0, 600.0, 0.6, 0.5, 20, 45.0)
    assert small.predictors == large.predictors
    (a, c), (b, d) = expected(rules, small), expected(rules, large)
    assert b.value == pytest.approx(2.0 * a.value) and c == d
    assert a.value == pytest.approx(1000.0 * c.value)


def test_the_command_answers_with_a_band_and_says_what_is_beyond(tmp_path: Path, capsys: Capture) -> None:
    path = written(tmp_path / "rules.yaml", rules_of(rule_of(90, 0.3)))
    assert main(["expect", "--rules", str(path), *WORDS]) == 0
    text = capsys.readouterr().out
    assert "90 % band" in text and "100 simulated runs, 7 of which had no answer" in text
    assert main(["--json", "expect", "--rules", str(path), *WORDS]) == 0
    answer = json.loads(capsys.readouterr().out)
    (found,) = answer["figures"]["expected"]
    assert found["low"] < found["value"] < found["high"] and answer["status"] == "ok"
    assert list(answer["figures"]["predictors"]) == list(PREDICTORS)
    assert list(answer["figures"]["predictors"].values()) == [360.0, 36.0, 6.0, 20.0, 45.0]
    narrow = rules_of(rule_of(90, 0.3)).model_copy(update={"ranges": dict.fromkeys(PREDICTORS, (1.0, 50.0))})
    written(path, narrow)
    assert main(["expect", "--rules", str(path), *WORDS]) == 0
    said = capsys.readouterr().out
    assert said.startswith("Beyond the runs of the fit, where this is no estimate: size_px 360 is outside")
    assert outside(narrow, Observation(1.0, 30.0, 2.0, 1200.0, 0.3, 0.5, 20, 45.0)) == []


def test_more_pairs_than_the_fit_are_answered_with_what_supports_it(tmp_path: Path, capsys: Capture) -> None:
    fitted = rules_of(rule_of(90, 0.3).model_copy(update={"more": 40, "more_inside": 37}))
    ranges = fitted.ranges | {"pairs": (10.0, 24.0)}
    path = written(tmp_path / "rules.yaml", fitted.model_copy(update={"ranges": ranges, "checked_pairs": 80}))
    found = {}
    for pairs, words in ((60, "up to 80: 37 of 40."), (80, "up to 80"), (900, "No run had more than 80")):
        assert main(["--json", "expect", "--rules", str(path), *WORDS[:-1], str(pairs)]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert words in answer["warnings"][0] and answer["status"] == ("ok" if pairs <= 80 else "degraded")
        (found[pairs],) = answer["figures"]["expected"]
    # no promise beyond what runs have shown, and no claim that more are worse
    assert found[60]["value"] > found[80]["value"] == found[900]["value"]
    assert found[900]["low"] < found[80]["low"] and found[900]["high"] == found[80]["high"]


def test_what_no_rule_can_answer_gives_one_line(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "rules.yaml"
    short = rule_of(30, 0.3).model_dump(mode="json") | {"coefficients": [1.0]}
    cases: tuple[tuple[list[str], dict[str, Any] | None, str], ...] = (
        (["--range", "1.4"], {}, "--range 1.4: the camera would be inside the target"),
        (["--interval", "20"], {}, "--interval 20: the target would turn by 240 deg between two pairs"),
        (["--pairs", "2"], {}, "--pairs 2: give a whole number from 3 to"),
        (["--sun-angle", "400"], {}, "--sun-angle 400: give a number from 0 to 180"),
        (["--size", "0"], {}, "--size"),
        ([], None, "is missing"),
        ([], {"runs": "many"}, "runs"),
        ([], {"ranges": {}}, "ranges: size_px is missing"),
        ([], {"rules": [short]}, "is incomplete"),
    )
    for words, change, said in cases:
        path.unlink(missing_ok=True)
        if change is not None:
            written(path, rules_of(rule_of(30, 0.3)), **change)
        assert main(["expect", "--rules", str(path), *WORDS, *words]) == 2
        printed = capsys.readouterr().err
        assert printed.startswith("polhode: error: ") and printed.count("\n") == 1 and said in printed
