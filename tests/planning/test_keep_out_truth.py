"""The keep-out volume of a run beside the true body of its sequence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polhode.geometry.lie import Array
from polhode.planning.keep_out import keep_out_truth as keep_out_truth_module
from polhode.planning.keep_out.keep_out_truth import KeepOutTruth, keep_out_truth, truth_numbers
from polhode.planning.keep_out.queries import KeepOut
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.planning.plan import keep_out_of_run
from polhode.runtime.errors import InputError
from tests.pipeline.conftest import BOX_M, Example, write_example
from tests.pipeline.example_sequence import write_sequence

SHIFT_M = 1.0


@pytest.fixture(autouse=True)
def few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far points take long, and a box is known by few."""
    monkeypatch.setattr(keep_out_truth_module, "POINTS", 600)
    monkeypatch.setattr(keep_out_truth_module, "FEW_POINTS", 200)


@pytest.fixture(scope="module")
def run(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_example(folder, example)
    return folder


@pytest.fixture(scope="module")
def sequence(example: Example, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_sequence(example, tmp_path_factory.mktemp("sequence"))


@pytest.fixture(scope="module")
def volume(run: Path) -> KeepOut:
    return keep_out_of_run(run, KeepOutOptions(2.0, 0.97, members=80, cells=24))


def moved(found: KeepOut, shift_N: Array) -> KeepOut:
    """The same volumes elsewhere in N."""
    level = found.swept.level
    swept = replace(found.swept, level=replace(level, origin=level.origin + shift_N))
    motion = found.instant.motion
    instant = replace(found.instant, motion=replace(motion, p_NG=motion.p_NG + shift_N))
    return replace(found, swept=swept, instant=instant)


def numbers_of(found: KeepOutTruth) -> dict[str, float]:
    return {name: float(value) for name, value in truth_numbers(found).items() if value is not None}


def test_a_true_estimate_stays_inside_and_a_volume_that_is_moved_is_left_by_that_distance(
    example: Example, run: Path, sequence: Path, volume: KeepOut
) -> None:
    found = keep_out_truth(volume, example.surface, run, sequence)
    assert 0.5 < found.swept.seen.mean() <= 1.0
    numbers = numbers_of(found)
    assert len(numbers) == 8 and set(numbers.values()) == {0.0}
    assert found.swept.inside(found.swept.seen) == 1.0 and found.least_from_mesh_m is None
    found = keep_out_truth(moved(volume, np.array([SHIFT_M, 0.0, 0.0])), example.surface, run, sequence)
    numbers, size_m = numbers_of(found), float(np.linalg.norm(BOX_M))
    for name in ("swept_body", "swept_seen", "instant_body", "instant_seen"):
        assert numbers[f"{name}_left"] == 1.0
        # from the near side of the moved body to the far one of the true body
        assert SHIFT_M - size_m < numbers[f"{name}_farthest_m"] < SHIFT_M + size_m
    assert found.swept.inside(found.swept.seen) == 0.0
    # what comes out is on the mesh: the fault is the motion's
    assert found.least_from_mesh_m == pytest.approx(0.0, abs=1e-6)
    # a truth that ends before the horizon
    motion = replace(volume.instant.motion, time_s=volume.instant.motion.time_s + 70.0)
    late = replace(volume, instant=replace(volume.instant, motion=motion))
    with pytest.raises(InputError, match="does not cover"):
        keep_out_truth(late, example.surface, run, sequence)
