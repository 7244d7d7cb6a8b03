"""The benchmark of leaks: a leak is distinguished from noise and from caches that fill."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.record import Case
from benchmarks.robustness import leaks
from benchmarks.robustness.leaks import estimates, fitted, grows, main, read, resources, sample, verdict
from polhode.errors import RunFailure


def samples(memory_mb: Callable[[float], float], files: int = 0) -> list[Case]:
    rng = np.random.default_rng(5)
    lines: list[Case] = [
        {
            "runs": 100 * k,
            "failed": 0,
            "seconds": k,
            "memory_mb": memory_mb(100.0 * k) + rng.normal(0.0, 0.05),
            "files": 6 + (files if k > 50 else 0),
            "threads": 1,
            "objects": 1000,
        }
        for k in range(101)
    ]
    lines[0]["made"] = {}
    return lines


def test_a_leak_of_a_few_kilobytes_a_run_is_found() -> None:
    lines = samples(lambda runs: 300.0 + runs * 3.0 / 1024.0)
    assert len(grows(lines)) == 1 and "memory by 3.0" in grows(lines)[0]
    assert "It grows: memory" in verdict(lines)


def test_noise_and_a_cache_that_fills_are_no_leak() -> None:
    assert grows(samples(lambda runs: 300.0 - 200.0 * np.exp(-runs / 100.0))) == []
    assert verdict(samples(lambda runs: 300.0)).endswith("No growth.")


def test_files_that_stay_open_are_found() -> None:
    assert grows(samples(lambda runs: 300.0, files=1)) == ["files from 6 to 7"]


def test_the_uncertainty_of_a_slope_covers_its_error_when_errors_are_correlated() -> None:
    rng, x, off = np.random.default_rng(2), np.arange(100.0), []
    for _ in range(200):
        y = np.convolve(rng.normal(size=109), np.ones(10) / 10.0, mode="valid")
        rate, sigma = fitted(x, y)
        off.append(rate / sigma)
    assert 0.6 < np.std(off) < 1.5


def test_samples_are_recorded_and_failures_counted(tmp_path: Path) -> None:
    def work() -> Iterator[Callable[[], None]]:
        def fail() -> None:
            raise RunFailure("no motion")

        while True:
            yield fail
            yield lambda: None

    lines = sample(work(), 10, tmp_path / "new" / "r.jsonl")
    assert [line["runs"] for line in lines] == list(range(11))
    assert lines[-1]["failed"] == 5
    assert read(tmp_path / "new" / "r.jsonl") == lines


def test_resources_see_an_open_file(tmp_path: Path) -> None:
    before = resources()
    with (tmp_path / "x").open("w"):
        assert resources()["files"] == before["files"] + 1
    assert resources()["files"] == before["files"]


def test_a_cold_start_of_the_benchmark_works() -> None:
    next(estimates())()


def test_a_complete_record_is_printed_instead_of_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "r.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in samples(lambda runs: 300.0)))
    monkeypatch.setattr(leaks, "sample", lambda *_: pytest.fail("measured again"))
    main(record=path, runs=10_000)
    out = capsys.readouterr().out
    assert out.startswith("| runs |") and "10000 runs, 0 of them failed" in out
