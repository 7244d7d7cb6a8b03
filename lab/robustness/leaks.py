"""Whether memory or open files grow over thousands of runs in one process: slopes with their uncertainty.

    python -m lab.robustness.leaks [estimator|images] [--runs 10000] [--short] [--record FILE]

"estimator": cold starts of the back end on small generated sequences, each with a seed of its own, by both
solvers and both parameterizations of the inertia. "images": a small dataset is opened, matched, estimated
and fused, again and again (300 runs unless stated). A failed estimate counts as a run: it must leave nothing
either.

After each hundredth of the runs: the resident memory, open files, threads, and objects that Python's garbage
collector knows. The slope is fitted to what follows the first tenth, in which caches fill; its uncertainty
takes account of the correlation of successive samples. It is no growth when the slope is compatible with
zero, or adds less than a megabyte in a thousand runs. The record is written along the way; a complete one is
printed.
"""

import gc
import itertools
import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from lab.command import ROOT, Short, command
from lab.presentation import print_table
from lab.record import Case
from polhode.runtime.errors import RunFailure

Load = Literal["estimator", "images"]
RUNS: dict[Load, int] = {"estimator": 10_000, "images": 300}
SHORT_RUNS: dict[Load, int] = {"estimator": 8, "images": 1}
SAMPLES = 100
WARM_UP = 0.1
"""Share of the runs in which caches fill, libraries load and loops compile"""
MAX_GROWTH_KB = 1.0
"""Growth of a run that does not matter: 10 MB over ten thousand."""
SIGMAS = 2.0
ROWS = (0, 1, 5, 10, 25, 50, 75, 100)
"""Samples that the table shows"""
RPM = np.pi / 30.0


def main(
    load: Positional[Annotated[Load, arg(help="What is run.")]] = "estimator",
    runs: Annotated[int | None, arg(help="How often.")] = None,
    short: Short = False,
    record: Annotated[Path | None, arg(help="File of the samples.")] = None,
) -> None:
    """Measure, unless the record is complete; print the table and the verdict."""
    wanted = runs or (SHORT_RUNS if short else RUNS)[load]
    path = record or ROOT / "runs" / f"leaks_{load}{'_short' if short else ''}.jsonl"
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []
    if not lines or lines[-1]["runs"] < wanted:
        lines = sample(estimates() if load == "estimator" else pipelines(), wanted, path)
    columns = ("runs", "failed", "seconds", "memory_mb", "files", "threads", "objects")
    chosen = [lines[k] for k in ROWS if k < len(lines)]
    print_table(columns, ([str(line[name]) for name in columns] for line in chosen), right_from=0)
    print(f"\n{verdict(lines)}")


def estimates() -> Iterator[Callable[[], None]]:
    """Cold starts: five pairs, sixty landmarks; the cheaper settings more often."""
    from lab.monte_carlo.bound import cold_start
    from polhode.config.backend_settings import Backend
    from polhode.simulation.monte_carlo import SyntheticScene, generate

    given = Backend(process_noise="given", unknown_wrench="none")
    settings = [given] * 7 + [
        given.model_copy(update={"inertia": "ratios_axes"}),
        given.model_copy(update={"solver": "ipopt"}),
        Backend(),
    ]
    scene = SyntheticScene(
        frames=5,
        landmarks=60,
        detection=1.0,
        w_G=(0.3 * RPM, 4.0 * RPM, 0.5 * RPM),
        sigma_uv_px=0.5,
        sigma_d_px=0.5,
    )
    for seed, config in enumerate(itertools.cycle(settings)):
        yield lambda seed=seed, config=config: cold_start(generate(scene, seed), config)  # type: ignore[misc]


def pipelines() -> Iterator[Callable[[], None]]:
    """A dataset of eight pairs to its surface, without pictures and pages."""
    from lab.robustness.small_data import write_sequence
    from polhode.config import Config
    from polhode.frontend.extract import extract_depth
    from polhode.mapping.fusion.field import fuse
    from polhode.pipeline.context import open_context
    from polhode.pipeline.correspondences import match_frames
    from polhode.pipeline.find_motion import find_motion
    from polhode.runtime.progress import Silent

    config = Config.model_validate({"runtime": {"workers": 1}})

    def run(folder: Path) -> None:
        context = open_context(folder, config, Silent())
        X_RG = find_motion(context, match_frames(context)).X_RG
        maps = extract_depth(context.sequence, context.rectifier, config.frontend, [None] * len(X_RG), 1)
        fuse(zip(maps, X_RG, strict=True), context.rig, config.mapping, Silent(), len(X_RG))

    with TemporaryDirectory(prefix="polhode-leaks-") as place:
        folder = write_sequence(Path(place) / "S")
        while True:
            yield lambda: run(folder)


def sample(work: Iterator[Callable[[], None]], runs: int, path: Path) -> list[Case]:
    """Run so many, and take a sample after each hundredth of them, which is written at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    marks = {round(runs * k / SAMPLES) for k in range(SAMPLES + 1)}
    lines: list[Case] = []
    failed, start = 0, time.perf_counter()
    with path.open("w") as stream:
        for done in range(runs + 1):
            if done in marks:
                lines.append({"runs": done, "failed": failed, "seconds": round(time.perf_counter() - start)})
                lines[-1] |= resources()
                stream.write(json.dumps(lines[-1]) + "\n")
                stream.flush()
            if done < runs:
                try:
                    next(work)()
                except RunFailure:
                    failed += 1
    return lines


def resources() -> Case:
    """Of this process, after a collection of garbage: resident memory [MB], open files, threads, objects."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "memory_mb": round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 3),
        "files": len(list(Path("/proc/self/fd").iterdir())) - 1,  # less the folder itself
        "threads": threading.active_count(),
        "objects": len(gc.get_objects()),
    }


def slope(lines: list[Case], name: str) -> tuple[float, float]:
    """Growth of a quantity per run after the warm-up, and its standard deviation.

    The correlation r of successive residuals leaves (1 - r) / (1 + r) of the points' information.
    """
    first = WARM_UP * lines[-1]["runs"]
    x, y = (np.array([line[key] for line in lines if line["runs"] >= first], float) for key in ("runs", name))
    centred = x - x.mean()
    rate = float(centred @ y / (centred @ centred))
    residuals = y - y.mean() - rate * centred
    total = float(residuals @ residuals)
    if total <= 0.0 or len(x) < 4:
        return rate, 0.0
    r = min(max(float(residuals[1:] @ residuals[:-1]) / total, 0.0), 0.99)
    variance = total / (len(x) - 2) / (centred @ centred)
    return rate, float(np.sqrt(variance * (1.0 + r) / (1.0 - r)))


def verdict(lines: list[Case]) -> str:
    """The slopes with their uncertainty, and the conclusion."""
    rate, sigma = (1024.0 * value for value in slope(lines, "memory_mb"))
    objects, spread = slope(lines, "objects")
    growth = []
    if rate - SIGMAS * sigma > 0.0 and rate > MAX_GROWTH_KB:
        growth.append(f"memory by {rate:.2f} kB a run")
    first = next(line for line in lines if line["runs"] >= WARM_UP * lines[-1]["runs"])
    for name in ("files", "threads"):
        if lines[-1][name] > first[name]:
            growth.append(f"{name} from {first[name]} to {lines[-1][name]}")
    return (
        f"{lines[-1]['runs']} runs, {lines[-1]['failed']} of them failed estimates. Memory: "
        f"{rate:+.3f} +- {sigma:.3f} kB a run after the warm-up; objects: {objects:+.4f} +- {spread:.4f} a "
        f"run. {'It grows: ' + ', '.join(growth) if growth else 'No growth'}."
    )


if __name__ == "__main__":
    command(main)
