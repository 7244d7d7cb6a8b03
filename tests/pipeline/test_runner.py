"""Stages that are run: once for the same inputs, in this process or beside it, with the same result."""

import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import parent_process
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from polhode.config import Config
from polhode.geometry.lie import Ints
from polhode.pipeline.context import RunContext
from polhode.pipeline.runner import Job, MadeByPair, Result, Runner, Stopwatch, stage
from polhode.run_directory.finished_stages import StageStore
from polhode.runtime.errors import RunFailure
from polhode.runtime.progress import Silent

_log = logging.getLogger("polhode.test")
calls: list[str] = []


@dataclass(frozen=True)
class Sums:
    values: NDArray[np.float64]
    process: int


@dataclass(frozen=True)
class Images:
    """In the place of a sequence and of a rectifier."""

    content_digest: str = "1"


@stage("frontend", ["seed"])
def begin(context: RunContext) -> Sums:
    calls.append("begin")
    return Sums(np.asfortranarray(np.full((2, 3), float(context.config.seed))), os.getpid())


@stage("backend", ["mapping.levels"])
def grow(context: RunContext, before: Sums) -> Sums:
    calls.append("grow")
    # the other process takes what is not of this one meanwhile
    sleep(0.5 if context.workers > 1 else 0.0)
    return Sums(before.values + len(context.config.mapping.levels), os.getpid())


@stage("checks", is_stored=False)
def judge(context: RunContext, before: Sums, word: str) -> Sums:
    _log.info("judged %s", word)
    if word == "kill" and parent_process() is not None:
        os.kill(os.getpid(), 9)
    if word == "wrong":
        raise ValueError(word)
    return Sums(before.values * 2.0, os.getpid())


@stage("report", writes=True)
def write(context: RunContext, folder: Path, before: Sums) -> None:
    (folder / "sum").write_text(str(before.values[0, 0]))


@stage("report", is_stored=False)
def peek(context: RunContext, before: Sums) -> float:
    return context.config.seed


@stage("fusion", is_stored=False)
def end(context: RunContext, *before: Sums) -> float:
    return float(sum(each.values[0, 0] for each in before))


def runner_of(folder: Path | None, workers: int = 1, images: Any = Images(), **settings: Any) -> Runner:
    config = Config.model_validate({"seed": 3, **settings, "runtime": {"workers": workers}})
    return Runner(RunContext(images, images, config, Silent(), StageStore(folder)), Stopwatch())


def flow(run: Runner, folder: Path, word: str = "well") -> tuple[Result[float], Result[Sums]]:
    calls.clear()
    first = run(begin)
    grown = run(grow, first)
    run(write, folder, first)
    judged = run(judge, first, word)
    found = run(end, grown, judged)
    run.finish()
    return found, judged


@pytest.mark.parametrize("workers", [1, 2])
def test_results_and_files_are_the_same_for_any_number_of_processes(
    workers: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run = runner_of(None, workers)
    with caplog.at_level(logging.INFO, "polhode"):
        found, judged = flow(run, tmp_path)
    assert found.value == (3.0 + 2.0) + 2.0 * 3.0
    assert (tmp_path / "sum").read_text() == "3.0"
    assert (judged.value.process == os.getpid()) == (workers == 1)
    assert [record.getMessage() for record in caplog.records] == ["judged well"]
    assert set(run.clock.seconds) == {"frontend", "backend", "checks", "report", "fusion"}
    # read or not, a result has the layout that it has when it is read
    assert begin(run.context).values.flags.c_contiguous


def test_only_what_depends_on_a_change_is_computed_again(tmp_path: Path) -> None:
    def computed(**settings: Any) -> list[str]:
        flow(runner_of(tmp_path / "stages", **settings), tmp_path)
        return list(calls)

    assert computed() == ["begin", "grow"] and computed() == []
    # a setting that no stage sees, one of the second stage, one of the first, other images
    assert computed(backend={"window": {"enabled": False}}) == []
    assert computed(mapping={"levels": (0.5,)}) == ["grow"]
    assert computed(seed=4) == computed(images=Images("2")) == ["begin", "grow"]
    found, _ = flow(runner_of(tmp_path / "stages", mapping={"levels": (0.5,)}), tmp_path)
    assert found.value == 10.0 and calls == []


def test_a_stage_sees_only_the_settings_that_it_declares() -> None:
    run = runner_of(None, mapping={"levels": (0.5,)})
    seen = grow.seen(run.context).config
    assert seen.mapping.levels == (0.5,) and seen.runtime.workers == 1
    assert not hasattr(seen.mapping, "hole_share")
    assert not any(hasattr(seen, unseen) for unseen in ("seed", "frontend", "backend"))
    run(peek, run(begin))
    with pytest.raises(AttributeError, match="seed"):
        run.finish()


@pytest.mark.parametrize(("word", "error"), [("wrong", ValueError), ("kill", RunFailure)])
def test_what_goes_wrong_beside_this_process_is_raised_here(
    word: str, error: type[Exception], tmp_path: Path
) -> None:
    with pytest.raises(error, match=r"wrong|was killed, perhaps for lack of memory"):
        flow(runner_of(None, 2), tmp_path, word)
    assert (tmp_path / "sum").is_file()


@dataclass(frozen=True)
class Items(MadeByPair):
    """Files with their number, each made by whoever comes first."""

    folder: Path
    max_stored_bytes: int = 10**6

    def __len__(self) -> int:
        return 6

    def __iter__(self) -> Iterator[int]:
        return (self[k] for k in range(len(self)))

    def __getitem__(self, k: Any) -> Any:
        file = self.folder / f"item{k}"
        return int(file.read_text()) if file.is_file() else os.getpid()

    def jobs(self) -> Iterator[Job]:
        return (Write(self.folder / f"item{k}") for k in range(len(self)))


@dataclass(frozen=True)
class Write:
    file: Path

    def __call__(self, context: RunContext) -> int:
        self.file.write_text(str(os.getpid()))
        return 1000


@stage("depth", is_stored=False)
def items_of(context: RunContext, folder: Path, before: Sums, max_stored_bytes: int) -> Items:
    return Items(folder, max_stored_bytes)


@stage("backend", is_stored=False)
def slow(context: RunContext, before: Sums, folder: Path, items: int) -> Sums:
    """Until so many items are there, at most a minute."""
    for _ in range(600):
        sleep(0.1)
        if len(list(folder.glob("item*"))) >= items:
            break
    return before


@stage("fusion", is_stored=False)
def collect(context: RunContext, items: Items, before: Sums) -> Ints:
    sleep(0.05)
    return np.array(list(items))


@pytest.mark.parametrize("limit", [2500, 10**6])
def test_what_is_made_by_pair_is_begun_beside_this_process(limit: int, tmp_path: Path) -> None:
    run = runner_of(None, 2)
    first = run(begin)
    count = 6 if limit > 2500 else 3
    items, later = run(items_of, tmp_path, first, limit), run(slow, run(grow, first), tmp_path, count)
    found = run(collect, items, later)
    run.finish()
    assert np.sum(found.value != os.getpid()) == count
    # the time until an item is there counts for it, not what went on meanwhile
    assert 0.0 < run.clock.seconds["depth"] < run.clock.seconds["backend"]


def test_seconds_of_a_block_within_another_are_its_own() -> None:
    clock = Stopwatch()
    with clock("outer"):
        sleep(0.05)
        with clock("inner"):
            sleep(0.2)
    assert clock.seconds["inner"] > 0.19 and clock.seconds["outer"] < clock.seconds["inner"]
    clock.add("inner", 1.0)
    assert clock.seconds["inner"] > 1.19 and clock.with_total()["total"] > 0.24
