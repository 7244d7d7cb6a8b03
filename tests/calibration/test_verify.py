"""A calibration is judged by images of a board: what holds passes, what was knocked is named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.calibration.boards import make_board
from polhode.calibration.formats import calibration_files
from polhode.calibration.image_pairs import pairs_of_files
from polhode.calibration.verify import lens_of, verify
from polhode.cli.main import main
from polhode.geometry.lie import exp_so3
from polhode.importers.calibrations.rig import Camera
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Silent
from tests.calibration.rendered_rigs import SIZE, Scene, make_scene, write_images

BOARD = make_board("chessboard", "7x5", 0.03)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Path]:
    scene = make_scene(BOARD, 5, 11)
    folder = tmp_path_factory.mktemp("fresh")
    poses = enumerate(scene.truth.X_CB)
    write_images(folder, [(scene.image(0, X, 2 * k), scene.image(1, X, 2 * k + 1)) for k, X in poses])
    return scene, folder


def written(folder: Path, scene: Scene, turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Path:
    """The true calibration in a folder, its right camera turned."""
    X_10 = scene.truth.X_10.copy()
    X_10[:3, :3] = exp_so3(np.radians(turn_deg)) @ X_10[:3, :3]
    for name, content in calibration_files(replace(scene.truth, X_10=X_10), (SIZE, SIZE)).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


def judge(images: Path, calibration: Path) -> dict[str, CheckoutCheck]:
    pairs = pairs_of_files([str(images / "left")], [str(images / "right")])
    done = verify(pairs, BOARD, [calibration], 1.0, Silent())
    return {check.name: check for check in done.result.checks}


def test_the_true_calibration_passes(fresh: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, images = fresh
    checks = judge(images, written(tmp_path, scene))
    assert {check.status for check in checks.values()} == {"PASS"}
    length = checks["error of lengths"].value
    assert length is not None and length < 0.2


def test_a_turned_camera_is_named_with_its_angle(fresh: tuple[Scene, Path], tmp_path: Path) -> None:
    scene, images = fresh
    checks = judge(images, written(tmp_path, scene, (0.2, -0.1, 0.0)))
    assert checks["epipolar error"].status == "FAIL" and checks["pitch of the right camera"].status == "FAIL"
    for name, turned in (("pitch", 0.2), ("yaw", 0.1), ("roll", 0.0)):
        check = checks[f"{name} of the right camera"]
        assert check.value is not None and check.sigma is not None
        assert abs(check.value - turned) < 4.0 * check.sigma + 0.005
    assert checks["roll of the right camera"].status == "PASS"


def words_of(left: Path, right: Path, out: Path) -> list[str]:
    """The command for the board of this file."""
    images = ["--left", str(left), "--right", str(right)]
    return ["calibrate", *images, "--board", "7x5", "--square-mm", "30", "-o", str(out)]


def test_a_calibration_of_another_size_or_order_or_with_nan_is_one_line(
    fresh: tuple[Scene, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, images = fresh
    rig, out = written(tmp_path / "rig", scene), tmp_path / "out"
    left, right = images / "left", images / "right"

    def refused(words: list[str]) -> str:
        assert main([*words, "--verify", str(rig)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1 and str(rig) in error and not out.exists()
        return error

    exchanged = refused(words_of(right, left, out))
    assert "only with left and right exchanged; exchange --left and --right" in exchanged
    sensor = rig / "cam0" / "sensor.yaml"
    text = sensor.read_text()
    sensor.write_text(text.replace("[320, 240]", "[640, 480]"))
    error = refused(words_of(left, right, out))
    assert "calibrated for images of 640x480 px, but the left ones have 320x240" in error
    sensor.write_text(text.replace("[300.0,", "[.nan,"))
    error = refused(words_of(left, right, out))
    assert "sensor.yaml" in error and "intrinsics" in error


def test_a_verification_beside_the_calibration_leaves_it_there(
    fresh: tuple[Scene, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, images = fresh
    rig, out = written(tmp_path / "rig", scene), tmp_path / "out"
    words = words_of(images / "left", images / "right", out)
    assert main(words) == 0
    before = (out / "cam0" / "sensor.yaml").read_bytes()
    assert main([*words, "--verify", str(rig)]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"Verification: {out / 'verification.html'}")
    assert json.loads((out / "verification.json").read_text())["status"] == "PASS"
    assert (out / "cam0" / "sensor.yaml").read_bytes() == before and (out / "report.html").exists()


def test_lenses_of_other_programs_are_taken_as_they_are() -> None:
    camera = Camera(
        "a.yaml", (300.0, 301.0, 160.0, 120.0), "radial-tangential", (0.1, 0.2, 0.3, 0.4), np.eye(4)
    )
    found = lens_of(camera)
    assert found.model == "brown5" and found.coefficients.tolist() == [*camera.distortion, 0.0]
    rational = replace(camera, distortion=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8))
    assert lens_of(rational).model == "brown8"
    with pytest.raises(InputError, match="12 distortion coefficients, with thin prism"):
        lens_of(replace(camera, distortion=(*rational.distortion, 0.1, 0.0, 0.0, 0.0)))
