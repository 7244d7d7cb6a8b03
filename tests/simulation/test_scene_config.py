"""A wrong scene is refused in one line that names file, key and remedy."""

from pathlib import Path

import pytest

from polhode.cli.main import main
from polhode.config.loader import load_config
from polhode.runtime.errors import InputError


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("{body: {family: dragon}}", ["scene.body.family", "dragon", "free_flyer"]),
        ("{body: {famly: bus}}", ["famly", "family"]),
        ("{body: {family: mesh, path: a.obj}}", ["metres_per_unit", "never guessed"]),
        ("{body: {family: mesh, metres_per_unit: 1}}", ["path"]),
        ("{body: {family: bus, path: a.obj}}", ["family mesh only"]),
        ("{light: {sun_direction_N: [0, 0, 0]}}", ["sun_direction_N", "give a direction"]),
        ("{inspector: {position_m: [1, 0, 0]}}", ["rest", "position_m"]),
    ],
)
def test_a_wrong_scene_gives_one_line(tmp_path: Path, scene: str, words: list[str]) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"scene: {scene}\n")
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert "\n" not in message
    assert "scene.yaml" in message
    for word in words:
        assert word in message


ENDLESS: dict[str, tuple[str, str]] = {
    "a torque of 1e12 N m": ("{motion: {pushes: [{torque_P: [1.0e+12, 0, 0]}]}}", "steps of integration"),
    "a body of 1e-18 kg m^2": (
        "{mass: {inertia_kg_m2: [[1.0e-18, 0, 0], [0, 1.0e-18, 0], [0, 0, 1.0e-18]], mass_kg: 1},"
        " motion: {pushes: [{torque_P: [1, 0, 0]}]}}",
        "steps of integration",
    ),
    "disturbances for months": (
        "{truth_horizon_s: 1.0e+7, interval_s: 100, motion: {torque_psd: 1.0e-9}}",
        "disturbances or pushes over 1.00114e+07 s take",
    ),
    "disturbances in steps of 50 ns": (
        "{interval_s: 1.0e-6, frames: 500000, truth_horizon_s: 0, motion: {torque_psd: 1.0e-9}}",
        "above 2e+06; give fewer frames",
    ),
}


@pytest.mark.parametrize("name", ENDLESS)
def test_a_motion_without_end_is_refused_before_it_is_integrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    scene, words = ENDLESS[name]
    (tmp_path / "c.yaml").write_text(f"scene: {scene}")
    assert main(["simulate", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error and error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]
