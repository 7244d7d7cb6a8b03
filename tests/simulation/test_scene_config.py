"""A wrong scene is refused in one line that names file, key and remedy."""

from pathlib import Path

import pytest

from polhode.config.loader import load_config
from polhode.errors import InputError


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("{body: {family: dragon}}", ["scene.body.family", "dragon", "free_flyer"]),
        ("{body: {famly: bus}}", ["famly", "family"]),
        ("{frames: 0}", ["scene.frames"]),
        ("{frames: many}", ["scene.frames", "many"]),
        ("{rig: {focal_px: -3}}", ["scene.rig.focal_px"]),
        ("{rig: {distortion: [0.1, 0.2]}}", ["scene.rig.distortion"]),
        ("{body: {family: mesh, path: a.obj}}", ["metres_per_unit", "never guessed"]),
        ("{body: {family: mesh, metres_per_unit: 1}}", ["path"]),
        ("{body: {family: bus, path: a.obj}}", ["family mesh only"]),
        ("{light: {sun_direction_N: [0, 0, 0]}}", ["sun_direction_N", "give a direction"]),
        ("{inspector: {position_m: [1, 0, 0]}}", ["rest", "position_m"]),
        ("{motion: {position_m: [0, 0]}}", ["scene.motion.position_m"]),
        ("{render: {samples: 5}}", ["scene.render.samples", "4"]),
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
