"""Every reader of files: its corpus, what fuzzing found, seeded mutations: success or one line."""

from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest

from benchmarks.robustness.fuzz_check import Checker
from benchmarks.robustness.fuzz_mutation import mutated
from benchmarks.robustness.fuzz_targets import TARGETS, Target
from polhode.errors import InputError

CASES = Path(__file__).parents[2] / "fuzz_cases"
MUTATIONS = 60
"""Of each target; make bench-fuzz tries them for ten minutes."""


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_no_input_leads_to_anything_but_success_or_one_line(target: Target, tmp_path: Path) -> None:
    check, seeds, rng = Checker(target, tmp_path), target.seeds(), Random(target.name)  # noqa: S311
    assert check.warm_up(seeds) == []
    cases = [file.read_bytes() for file in sorted((CASES / target.name).glob("*"))]
    for content in (*cases, *(mutated(target, rng.choice(seeds), rng) for _ in range(MUTATIONS))):
        assert check(content) is None
    assert check.changed_folder() is None


def test_every_corpus_is_valid(tmp_path: Path) -> None:
    for target in TARGETS:
        folder = tmp_path / target.name
        folder.mkdir()
        Checker(target, folder)
        read = 0
        for seed in target.seeds():
            (folder / target.file).write_bytes(seed)
            try:
                target.read(folder / target.file)
                read += 1
            except InputError:
                continue
        assert read, target.name


def test_stored_cases_belong_to_targets() -> None:
    folders = {folder.name for folder in CASES.iterdir() if folder.is_dir()}
    assert folders <= {target.name for target in TARGETS}


def _forever() -> Iterator[bool]:
    while True:
        yield True


@pytest.mark.parametrize(
    ("read", "place"),
    [
        (lambda file: file.with_name("other").write_text("x"), "touched open"),
        (lambda file: print("words"), "printed words"),
        (lambda file: {}[file], "KeyError"),
        (lambda file: bytearray(2**30 + 2**26), "memory"),
        (lambda file: all(_forever()), "slow"),
    ],
)
def test_what_a_reader_must_not_do_is_found(
    read: object, place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if place == "slow":
        monkeypatch.setattr("benchmarks.robustness.fuzz_check.LIMIT_S", 0.2)
    target = Target("bad", "input", "text", lambda: [b"x"], read)  # type: ignore[arg-type]
    found = Checker(target, tmp_path)(b"x")
    assert found is not None and found.place.startswith(place)


def test_mutation_is_reproducible() -> None:
    target = TARGETS[0]
    seed = target.seeds()[0]
    first, second = (mutated(target, seed, Random(3)) for _ in range(2))  # noqa: S311
    assert first == second != seed
