"""summary.json: fits its schema, speaks of what is undetermined with null, and gives the right status."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError

from polhode.records.estimate import CalibrationPart, EstimatedError
from polhode.report.tables import calibration_rows
from polhode.run_directory.check_table import make_check
from polhode.run_directory.summary import build_summary, read_summary, write_summary
from polhode.run_directory.summary_schema import (
    ESTIMATE_PARTS,
    SCHEMA_FILE,
    Summary,
    json_schema,
)
from polhode.run_directory.verdict import lower_status
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import N_FRAMES

CONTRACT_KEYS = {
    *("schema", "status", "warnings", "frames", "frames_used", "landmarks", "observations", "duration_s"),
    *("timing_s", "inertia", "identifiable", "identifiable_detail", "com_G", "cov_com_G", "R_GP", "cov_R_GP"),
    *("solver", "noise", "verdict", "intervals"),
}


def _strict(text: str) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def _summary(run: Any, **more: Any) -> Summary:
    return build_summary(run.tracks, run.estimate, run.surface, {"frontend": 3.0, "backend": 1.5}, **more)


def test_every_kind_of_summary_fits_the_schema_and_nothing_else(
    example: Any, undetermined: Any, tmp_path: Path
) -> None:
    assert json.loads(SCHEMA_FILE.read_text()) == json_schema(Summary)
    Draft202012Validator.check_schema(json_schema(Summary))
    validator = Draft202012Validator(json_schema(Summary))
    summaries = (
        _summary(example),
        _summary(undetermined),
        build_summary(example.tracks, None, None, {}, failure="no motion"),
        build_summary(None, None, None, {}, failure="nothing"),
    )
    for summary in summaries:
        write_summary(summary, tmp_path / "summary.json")
        content = _strict((tmp_path / "summary.json").read_text())
        validator.validate(content)
        assert content.keys() >= CONTRACT_KEYS
        assert read_summary(tmp_path) == summary
        for change in ({"status": "fine"}, {"com_G": [0.0, 0.0]}, {"frames": -1}, {"surprise": 1}):
            with pytest.raises(ValidationError):
                validator.validate(content | change)
    summary, mass = summaries[0], example.estimate.mass
    assert summary.inertia is not None
    assert (summary.inertia.k1, summary.inertia.k2, summary.com_G) == (mass.k1, mass.k2, tuple(mass.com_G))
    np.testing.assert_array_equal(summary.inertia.J_G, mass.J_G)
    np.testing.assert_array_equal(np.array(summary.inertia.cov), mass.cov_k)
    assert (summary.frames, summary.frames_used, summary.landmarks) == (24, 23, 150)
    assert (summary.observations, summary.duration_s) == (len(example.tracks.frame), 11.5)
    assert summary.timing_s.total == pytest.approx(4.5)


def test_undetermined_is_null_and_its_best_number_stays(undetermined: Any, tmp_path: Path) -> None:
    write_summary(_summary(undetermined), tmp_path / "summary.json")
    content = _strict((tmp_path / "summary.json").read_text())
    assert content["inertia"]["cov"] == [[None, None], [None, None]]
    assert content["cov_com_G"][1] == [None, None, None] and content["cov_com_G"][0][0] == 1e-8
    assert content["inertia"]["k1"] == undetermined.estimate.mass.k1
    assert content["identifiable"] == {"k1": False, "k2": False, "com": False, "axes": False}
    assert "pure spin" in content["identifiable_detail"]["k1"]


def test_the_status_follows_from_what_was_found(example: Any, undetermined: Any) -> None:
    assert _summary(example, warnings=["one frame was dropped"]).status == "ok"
    assert _summary(undetermined).status == "ok"
    assert _summary(example, failure="out of memory").status == "failed"
    assert build_summary(example.tracks, example.estimate, None, {}).status == "degraded"
    weight = np.where(np.arange(len(example.tracks.frame)) % 2 == 0, 0.0, 1.0)
    doubtful = replace(example, estimate=replace(example.estimate, inlier_weight=weight))
    assert _summary(doubtful).status == "degraded"
    assert any(
        "50% of the observations contradict the motion" in text for text in _summary(doubtful).warnings
    )
    stopped = replace(example.estimate, solver=replace(example.estimate.solver, converged=False))
    assert _summary(replace(example, estimate=stopped)).status == "failed"
    # every reason once, and the failure first
    texts = ("the light changed", "the light changed")
    own = replace(example, estimate=replace(example.estimate, warnings=texts))
    summary = _summary(own, warnings=["dropped"], failure="stopped")
    assert summary.warnings == ["stopped", "the light changed", "dropped"]
    texts = ("the light changed", "the solver stopped before convergence: time")
    summary = _summary(replace(example, estimate=replace(stopped, warnings=texts)))
    assert summary.status == "failed" and summary.warnings == [texts[1], texts[0]]


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, "no such file"), ("{}", "Field required"), ("{", "JSON"), ("[]", "valid dict")],
)
def test_a_damaged_summary_is_refused_in_one_line(content: str | None, words: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "summary.json").write_text(content)
    with pytest.raises(InputError, match=words) as caught:
        read_summary(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_check_that_does_not_hold_makes_the_run_degraded(example: Any) -> None:
    none = make_check("links", None)
    good, bad = make_check("links", 15.0), make_check("links", 15.1)
    assert none.value is None and none.reason == good.reason == "" and bad.limit == 15.0
    assert bad.reason.startswith("15% of the links between frames")
    assert make_check("links", 15.1, 16.0).reason == ""
    few: dict[str, Any] = {"start_s": 1.0, "end_s": 2.0, "count": "5 landmarks", "others": ""}
    assert (
        make_check("connection", 6).reason == ""
        and "5 landmarks" in make_check("connection", 5, **few).reason
    )
    assert _summary(example, checks=[none, good]).status == "ok"
    summary = _summary(example, checks=[good, bad])
    assert summary.status == "degraded" and summary.warnings[0] == bad.reason
    assert summary.checks[:2] == (good, bad)
    own = {each.name: each for each in summary.checks[2:]}
    assert own["frames with measurements"].value == pytest.approx(2300.0 / 24.0)
    assert own["faces of the mesh"].value
    assert own["power of the disturbances over that stated"].value is None
    noise = replace(example.estimate.noise, times_stated=64.0)
    strong = _summary(replace(example, estimate=replace(example.estimate, noise=noise)))
    assert strong.status == "degraded"
    assert strong.warnings[0].startswith("the disturbances appear 64 times as strong as stated")


def test_a_summary_that_was_changed_by_hand_is_refused(example: Any, tmp_path: Path) -> None:
    file, summary = tmp_path / "summary.json", _summary(example)
    write_summary(summary, file)
    content = json.loads(file.read_text())
    # formatting, and the order of keys, are no content
    file.write_text(json.dumps(dict(reversed(content.items()))))
    assert read_summary(file) == summary
    for change in (
        {"status": "degraded"}, {"frames": 25}, {"warnings": ["all is well"]},
        {"inertia": content["inertia"] | {"cov": [[1e-12, 0.0], [0.0, 1e-12]]}},
    ):  # fmt: skip
        file.write_text(json.dumps(content | change))
        with pytest.raises(InputError, match="changed since the run wrote it"):
            read_summary(file)


def test_a_summary_with_a_part_of_an_estimate_is_refused(example: Any, tmp_path: Path) -> None:
    """No command has to look whether one part is there when another is."""
    path = tmp_path / "summary.json"
    write_summary(_summary(example), path)
    content = json.loads(path.read_text())
    del content["own_sha256"]
    for part in ESTIMATE_PARTS:
        path.write_text(json.dumps({**content, part: None}))
        with pytest.raises(InputError, match=rf"{part} is null, but other parts .*; not a summary") as caught:
            read_summary(path)
        assert "\n" not in str(caught.value) and "Value error" not in str(caught.value)
    path.write_text(json.dumps({**content, **dict.fromkeys(ESTIMATE_PARTS)}))
    assert read_summary(path).inertia is None


@pytest.mark.parametrize(
    ("part", "value", "words"),
    [
        ("R_GP", np.diag([1.0, 1.0, -1.0]).tolist(), "R_GP: not a rotation"),
        ("R_GP", np.zeros((3, 3)).tolist(), "R_GP: not a rotation"),
        ("com_G", [1e300, 0.0, 0.0], "com_G: above 1e\\+12 m"),
        ("inertia.moments", [1.0, 1.0, 0.0], "inertia.moments: not three positive"),
        ("inertia.J_G", np.zeros((3, 3)).tolist(), "inertia.J_G: not symmetric and positive definite"),
        ("inertia.J_G", np.full((3, 3), 1e300).tolist(), "inertia.J_G: not symmetric and positive definite"),
        ("inertia.k1", 1e300, "inertia: k1 and k2 beyond 60"),
        ("noise.accel_psd", 1e300, "noise: accel_psd or torque_psd is not from 0"),
        ("noise.torque_psd", -1.0, "noise: accel_psd or torque_psd is not from 0"),
    ],
)
def test_numbers_of_no_body_are_refused(
    example: Any, part: str, value: object, words: str, tmp_path: Path
) -> None:
    """They were an endless integration, or a defect, in the commands that follow a run."""
    file = tmp_path / "summary.json"
    write_summary(_summary(example), file)
    content = json.loads(file.read_text())
    *sections, name = part.split(".")
    inner = content
    for section in sections:
        inner = inner[section]
    inner[name] = value
    file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words):
        read_summary(tmp_path)


def test_the_verdict_has_status_reasons_and_every_check_with_its_range(example: Any) -> None:
    checks = [
        make_check("push", 3.0),
        make_check("mirror", 5.0),
        make_check("links", None),
    ]
    verdict = _summary(example, checks=checks).verdict
    assert verdict is not None and verdict.status == "degraded" and verdict.reasons == (checks[1].reason,)
    found = [(each.value, each.expected, each.holds) for each in verdict.checks[:3]]
    assert found == [(3.0, (0.0, 4.0), True), (5.0, (12.0, None), False), (None, (0.0, 15.0), None)]
    assert [each.name for each in verdict.checks[:3]] == [each.name for each in checks]
    # a status that falls later takes the verdict along
    summary = _summary(example)
    fallen = lower_status(summary, "degraded", "no report: the disk is full")
    assert fallen.status == "degraded" and fallen.warnings[-1] == "no report: the disk is full"
    assert fallen.verdict is not None and fallen.verdict.reasons == ("no report: the disk is full",)
    failed = lower_status(fallen, "failed", "the disk is full", first=True)
    assert failed.verdict is not None and failed.verdict.status == "failed"
    assert failed.warnings[0] == failed.verdict.reasons[0] == "the disk is full"


def test_errors_of_the_calibration_that_were_taken_off_are_listed_with_what_they_change(example: Any) -> None:
    none = np.zeros((20, 20)), np.zeros((2, 2)), np.zeros((3, 3)), np.zeros((N_FRAMES, 6, 1))
    errors = EstimatedError({"cam0.fu": -1.4, "cam0.fv": -1.5}, -1.5, 0.3), EstimatedError({}, 0.2, 0.45)
    part = CalibrationPart("a guess", *none, estimated=errors)
    summary = _summary(replace(example, estimate=replace(example.estimate, calibration=part)))
    assert summary.calibration is not None
    assert [vars(each) for each in summary.calibration.estimated] == [vars(each) for each in errors]
    rows = [row.value for row in calibration_rows(summary) if "estimated" in row.name]
    assert rows == [
        "cam0.fu -1.4, cam0.fv -1.5: -1.50 ± 0.30 sigmas of the stated one",
        "many parameters: +0.20 ± 0.45 sigmas of the stated one",
    ]
