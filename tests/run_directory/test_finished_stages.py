"""Finished stages: computed once for the same inputs, whatever happens to what is stored."""

import errno
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import polhode.run_directory.finished_stages as stages_module
from polhode.run_directory.finished_stages import KeptStages, StageStore
from polhode.run_directory.summary_schema import Recording
from polhode.runtime.errors import InputError, RunFailure

RECORDING = Recording(width_px=64, height_px=48, left_images=())


@dataclass(frozen=True)
class Squares:
    values: NDArray[np.float64]


calls: list[float] = []


def squares(store: StageStore, values: NDArray[np.float64], power: float) -> Squares:
    """The powers, or those that are stored."""

    def compute(_: list[int]) -> list[Squares]:
        calls.append(power)
        return [Squares(values**power)]

    (found,) = store.each("squares", Squares, [store.key(values, power)], compute)
    return found


@pytest.fixture(autouse=True)
def no_calls() -> None:
    calls.clear()


def files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.npz"))


def test_a_stage_is_computed_once_for_the_same_inputs_and_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.arange(4.0)
    results = [squares(StageStore(tmp_path), values, 2.0) for _ in range(2)]
    assert calls == [2.0]
    np.testing.assert_array_equal(results[0].values, results[1].values)
    squares(StageStore(tmp_path), values, 3.0)
    squares(StageStore(tmp_path), values + 1.0, 3.0)
    squares(StageStore(tmp_path, "4 threads"), values, 3.0)
    monkeypatch.setattr(stages_module, "program_digest", lambda: "of a later version")
    squares(StageStore(tmp_path), values, 2.0)
    assert calls == [2.0, 3.0, 3.0, 3.0, 2.0]
    # without a folder nothing is kept, and the result has the same layout
    for _ in range(2):
        assert squares(StageStore(), np.asfortranarray(np.ones((2, 3))), 2.0).values.flags.c_contiguous
    assert calls[-2:] == [2.0, 2.0] and len(calls) == 7


@pytest.mark.parametrize("damage", ["cut", "empty", "other"])
def test_a_damaged_result_is_computed_again(damage: str, tmp_path: Path) -> None:
    squares(StageStore(tmp_path), np.ones(2), 2.0)
    squares(StageStore(tmp_path), np.ones(2), 3.0)
    one, other = files(tmp_path)
    content = {"cut": one.read_bytes()[:-30], "empty": b"", "other": other.read_bytes()}
    one.write_bytes(content[damage])
    for power in (2.0, 3.0):
        found = squares(StageStore(tmp_path), np.ones(2) * 1.0, power)
        np.testing.assert_array_equal(found.values, np.ones(2))
    assert len(calls) == 3
    squares(StageStore(tmp_path), np.ones(2), calls[-1])
    assert len(calls) == 3


def test_of_many_results_those_that_miss_are_computed_and_each_is_stored_as_it_comes(tmp_path: Path) -> None:
    asked: list[list[int]] = []

    def compute(indices: list[int]) -> Iterator[int]:
        asked.append(indices)
        yield from (10 * k for k in indices)

    store = StageStore(tmp_path)
    keys = [store.key(k) for k in range(5)]
    begun = store.each("tens", int, keys, compute)
    assert [next(begun), next(begun)] == [0, 10]
    assert len(files(tmp_path)) == 2
    del begun
    files(tmp_path)[0].write_bytes(b"damaged")
    assert list(StageStore(tmp_path).each("tens", int, keys, compute)) == [0, 10, 20, 30, 40]
    assert asked[0] == [0, 1, 2, 3, 4] and [2, 3, 4] in asked and len(asked) == 3
    assert [0] in asked or [1] in asked
    assert list(StageStore(tmp_path).each("tens", int, keys, compute)) == [0, 10, 20, 30, 40]
    assert len(asked) == 3


def test_where_nothing_can_be_written_the_run_goes_on_and_its_stages_make_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    store = StageStore(tmp_path / "stages")
    squares(store, np.ones(2), 2.0)

    def full(*_: object) -> None:
        raise RunFailure(f"cannot be written ({errno.ENOSPC})")

    monkeypatch.setattr(stages_module, "write_record", full)
    for power in (3.0, 4.0):
        assert squares(store, np.ones(2), power).values.tolist() == [1.0, 1.0]
    assert not (tmp_path / "stages").exists()
    assert caplog.text.count("stages are not kept") == 1


def kept(tmp_path: Path, resume: bool) -> KeptStages:
    return KeptStages(tmp_path / "hidden" / "stages", tmp_path / "RUN", resume)


def opened(stages: KeptStages, recording: Recording | None = None) -> StageStore:
    (stages.folder.parent).mkdir(exist_ok=True)
    stages.take_over()
    return stages.open(recording or RECORDING, None, Path("sequence"), "kept", "")


def test_a_resumed_run_keeps_what_it_uses_and_a_published_one_its_results(tmp_path: Path) -> None:
    store, published = opened(kept(tmp_path, False)), tmp_path / "RUN" / "stages"
    for power in (2.0, 3.0):
        squares(store, np.ones(2), power)
    squares(StageStore(published), np.ones(2), 4.0)
    again = kept(tmp_path, True)
    resumed = opened(again)
    squares(resumed, np.ones(2), 3.0)
    squares(resumed, np.ones(2), 4.0)
    assert calls == [2.0, 3.0, 4.0]
    again.finish()
    assert len(files(again.folder)) == 2 and len(files(published)) == 1
    assert not (again.folder / "earlier").exists()


def test_results_of_another_recording_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    squares(opened(kept(tmp_path, False)), np.ones(2), 2.0)

    def refuse(*_: object) -> None:
        raise InputError("not the sequence of this run")

    monkeypatch.setattr(stages_module, "require_recording", refuse)
    with pytest.raises(InputError, match="not the sequence"):
        opened(kept(tmp_path, True))
    assert kept(tmp_path, True).has_results
