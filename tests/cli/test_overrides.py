"""Overrides on a command line: which words belong to which value."""

from typing import Any

import pytest

from polhode.cli.overrides import split_overrides
from polhode.errors import InputError


@pytest.mark.parametrize(
    ("words", "own", "overrides"),
    [
        (["run", "c.yaml", "--data", "S"], ["run", "c.yaml", "--data", "S"], {}),
        (["--seed", "3", "c.yaml"], ["c.yaml"], {"seed": "3"}),
        (["--seed=3", "c.yaml"], ["c.yaml"], {"seed": "3"}),
        (["--backend.accel-psd", "1e-8"], [], {"backend.accel_psd": "1e-8"}),
        (["--backend.accel_psd", "1e-8"], [], {"backend.accel_psd": "1e-8"}),
        (["--mapping.voxel-mm", "None"], [], {"mapping.voxel_mm": None}),
        (
            ["--scene.motion.spin-rpm", "-0.5", "10", "-.5", "-o", "S"],
            ["-o", "S"],
            {"scene.motion.spin_rpm": ["-0.5", "10", "-.5"]},
        ),
        (["--scene.motion.spin-rpm", "[1, 2, 3]", "x"], ["x"], {"scene.motion.spin_rpm": ["1", "2", "3"]}),
        (["--scene.motion.spin-rpm=1,2,3"], [], {"scene.motion.spin_rpm": ["1", "2", "3"]}),
        (
            ["--scene.mass.inertia-kg-m2", *"123456789"],
            [],
            {"scene.mass.inertia_kg_m2": [["1", "2", "3"], ["4", "5", "6"], ["7", "8", "9"]]},
        ),
        (["--backend.unknown", "1", "--seed", "2"], [], {"backend.unknown": "1", "seed": "2"}),
    ],
)
def test_words_are_split(words: list[str], own: list[str], overrides: dict[str, Any]) -> None:
    assert split_overrides(words) == (own, overrides)


@pytest.mark.parametrize("words", [["--seed"], ["--seed", "--backend.accel-psd", "1"], ["--seed", "-o", "x"]])
def test_a_missing_value_is_told(words: list[str]) -> None:
    with pytest.raises(InputError, match="--seed: a value is missing"):
        split_overrides(words)


def test_a_mistyped_key_takes_its_values_along() -> None:
    own, overrides = split_overrides(["--scene.motion.spin_rmp", "0", "8", "0", "-o", "S"])
    assert own == ["-o", "S"]
    assert list(overrides) == ["scene.motion.spin_rmp"]
