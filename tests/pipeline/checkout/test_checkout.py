"""polhode checkout: its files, its status, another calibration, bad input, and what a run warns of."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml

from polhode.cli.main import main
from polhode.frontend.rectification import make_rectifier
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.pipeline.checkout.checkout import Checkout, checkout, warn_before_run
from polhode.pipeline.checkout.page import render
from polhode.pipeline.checkout.result import SCHEMA_FILE, CheckoutResult
from polhode.pipeline.checkout.sample import places
from polhode.records.dataset import open_sequence
from polhode.records.dataset_writer import image_path, write_camera_csv, write_png
from polhode.run_directory.summary_schema import json_schema, json_text

Capture = pytest.CaptureFixture[str]
FEW_MATCHES = ("median number of matches between successive pairs", "successive pairs that match")


@pytest.fixture(scope="module")
def done(rendered_sequence: Path) -> Checkout:
    return checkout(rendered_sequence, workers=1, count=3)


def test_a_sound_sequence_passes_but_for_its_large_turns(done: Checkout) -> None:
    result = done.result
    assert (result.pairs, result.pairs_examined, result.rig) == (14, 6, "sequence")
    beyond = {check.name: check.status for check in result.checks if check.status != "PASS"}
    assert set(beyond) <= set(FEW_MATCHES) and set(beyond.values()) == {"WARN"} and result.status == "WARN"
    unmeasured = {check.name for check in result.checks if check.value is None}
    assert unmeasured <= {
        "images with a mask, where some have one",
        "distance from an image to the nearest inspector pose",
        "delay between the cameras",
    }
    # 9.7 RPM, twice a second
    assert result.named("rotation between successive frames").value == pytest.approx(29.1, abs=0.5)
    # a free flyer of 0.22 m, 0.5 m away
    assert " their median 0.4" in result.named("smallest disparity").finding
    assert result.named("vertical disparity").value < 0.1  # type: ignore[operator]


def test_the_files_have_every_check_and_the_command_says_what_does_not_pass(
    rendered_sequence: Path, done: Checkout, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    schema = json.loads(SCHEMA_FILE.read_text())
    assert schema == json.loads(json.dumps(json_schema(CheckoutResult)))
    monkeypatch.setattr("polhode.pipeline.checkout.checkout.checkout", lambda *_: done)
    assert main(["checkout", str(rendered_sequence), "-o", str(tmp_path / "out")]) == 0
    printed, checks = capsys.readouterr().out, done.result.checks
    assert printed.splitlines()[-1] == f"Checkout: {tmp_path / 'out' / 'checkout.html'}"
    passed = sum(check.status == "PASS" for check in checks)
    assert f"WARN: {passed} of {len(checks)} checks pass, 6 of 14 pairs examined" in printed
    found = f"{done.result.named(FEW_MATCHES[0]).value:.0f}"
    assert f"WARN  {FEW_MATCHES[0]}: {found} (at least 20). Record at a higher" in printed
    content = json.loads((tmp_path / "out" / "checkout.json").read_text())
    assert content == json.loads(json_text(done.result))
    jsonschema.validate(content, schema)
    page = render(done, "<seq>")
    assert "&lt;seq&gt;" in page and "<seq>" not in page
    assert "data:image/jpeg;base64," in page and 'src="http' not in page
    assert page.count('data-target="plot-') == 1
    for check in checks:
        assert check.name in page and check.advice.endswith(".") and check.finding.endswith(".")


def tilted(X_BC: Array) -> Array:
    """The pose of a camera that looks 0.3 deg up."""
    return X_BC @ make_pose(exp_so3([np.deg2rad(0.3), 0.0, 0.0]), np.zeros(3))


def test_another_rig_is_checked_against_the_images(rendered_sequence: Path, tmp_path: Path) -> None:
    rig = tmp_path / "rig"
    for camera in ("cam0", "cam1"):
        shutil.copytree(
            rendered_sequence / "mav0" / camera, rig / camera, ignore=shutil.ignore_patterns("data*")
        )
    # the right camera is stated to look 0.3 deg up
    sensor = rig / "cam1" / "sensor.yaml"
    content = yaml.safe_load(sensor.read_text())
    content["T_BS"]["data"] = tilted(np.array(content["T_BS"]["data"]).reshape(4, 4)).ravel().tolist()
    sensor.write_text(yaml.safe_dump(content))
    result = checkout(rendered_sequence, rig, workers=1, count=2).result
    pitch = result.named("pitch of the right camera")
    assert (result.rig, result.status, pitch.status) == ("given", "FAIL", "FAIL")
    assert pitch.value == pytest.approx(0.3, abs=0.03) and "deg down" in pitch.finding
    # rows are levelled for the other checks
    assert result.named("rotation between successive frames").status == "PASS"
    assert result.named("median number of stereo features per pair").value > 100  # type: ignore[operator]


def shift_clock(sequence: Path, offset_ns: int) -> None:
    """The right camera's clock differs."""
    camera = sequence / "mav0" / "cam1"
    stamps = sorted(int(file.stem) for file in (camera / "data").iterdir())
    for stamp in stamps:
        image_path(camera, stamp).rename(image_path(camera, stamp + offset_ns))
    write_camera_csv(camera, [stamp + offset_ns for stamp in stamps])


def test_clocks_that_differ_are_a_warning_and_without_a_common_time_fail(
    small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    shift_clock(small_sequence, 4_000)
    result = checkout(small_sequence, workers=1, count=1).result
    check = result.named("clock offset of the right camera")
    assert (check.value, check.status, result.pairs) == (4.0, "WARN", 6)
    shift_clock(small_sequence, 3_600_000_000_000)
    assert main(["checkout", str(small_sequence), "-o", str(tmp_path / "out")]) == 0
    assert "FAIL  unpaired images: 100 % (at most 60 %)" in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "checkout.json").read_text())
    assert (content["status"], content["pairs"]) == ("FAIL", 0)
    names = {check["name"] for check in content["checks"]}
    assert names == {"clock offset of the right camera", "unpaired images"}
    page = (tmp_path / "out" / "checkout.html").read_text()
    assert "No stamp of the left camera is near enough to one of the right camera" in page


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("no sequence", "is not a folder: give the folder that contains mav0/"),
        ("no camera", "cam1 is missing"),
        ("black", "all frames are black"),
        ("no rig", "sensor.yaml"),
        ("other size", "the images have 64x48; give the calibration of these cameras"),
        ("damaged calibration", "intrinsics"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    change: str, words: str, small_sequence: Path, tmp_path: Path, capsys: Capture
) -> None:
    sequence, rig, out = small_sequence, "", tmp_path / "out"
    mav0 = sequence / "mav0"
    match change:
        case "no sequence":
            sequence = tmp_path / "nothing"
        case "no camera":
            shutil.rmtree(mav0 / "cam1")
        case "black":
            for file in mav0.rglob("*.png"):
                write_png(file, np.zeros((48, 64), dtype=np.uint8))
        case "no rig":
            rig = "no_rig"
        case "other size":
            rig = "rig"
            shutil.copytree(mav0, tmp_path / rig)
            for file in (tmp_path / rig).rglob("sensor.yaml"):
                file.write_text(file.read_text().replace("[64, 48]", "[128, 96]"))
        case _:
            file = mav0 / "cam0" / "sensor.yaml"
            file.write_text(file.read_text().replace("intrinsics: [", "intrinsics: [.nan, "))
    more = ["--rig", str(tmp_path / rig)] if rig else []
    assert main(["checkout", str(sequence), *more, "-o", str(out)]) == 2
    stderr = capsys.readouterr().err
    assert words in stderr and stderr.count("\n") == 1
    assert not out.exists()


def test_a_run_warns_of_a_tilted_rig_and_not_of_a_sound_one(
    rendered_sequence: Path, caplog: pytest.LogCaptureFixture
) -> None:
    sequence = open_sequence(rendered_sequence)
    warn_before_run(sequence, make_rectifier(sequence.calibration))
    assert caplog.messages == []
    calibration = replace(sequence.calibration, X_BC1=tilted(sequence.calibration.X_BC1))
    warn_before_run(replace(sequence, calibration=calibration), make_rectifier(calibration))
    assert any(line.startswith("checkout: FAIL: pitch of the right camera") for line in caplog.messages)


def test_places_are_spread_and_avoid_gaps() -> None:
    stamps = 500_000_000 * np.arange(100, dtype=np.int64)
    found = places(stamps)
    assert len(found) == 20 and found[0] == 0 and found[-1] == 99
    assert (np.diff(found)[::2] == 1).all()
    np.testing.assert_array_equal(places(stamps[:7]), np.arange(7))
    # every other step is a gap
    uneven = np.cumsum(np.tile([500_000_000, 500_000_000, 5_000_000_000], 20)).astype(np.int64)
    pairs = places(uneven, 4).reshape(-1, 2)
    assert (np.diff(uneven[pairs], axis=1) == 500_000_000).all()
