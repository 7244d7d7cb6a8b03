"""Seconds of the processor of each stage after the front end, beside the loops that bound it.

    python -m benchmarks.live.stages [SEQ] [--before CHECKOUT] [--repeat 1] [--short]

A sequence is run with one process; the shipped sample unless another is named. Every stage is profiled by
itself, by the processor's time, so that other programs on the machine count little. A stage is bounded by
what must be done for its result: its factorizations and compiled loops, the semi-global matching and the
convolutions of each pair, the voxels that each depth map reaches, the rays, the encoders. ``--before`` names
another checkout of the project, which runs the same sequence in turns with this one.
"""

import cProfile
import functools
import json
import pstats
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from time import process_time
from typing import Annotated, Any

from tyro.conf import Positional, arg

from benchmarks.command import ROOT, Short, command, polhode
from benchmarks.presentation import print_table
from polhode.config import Config
from polhode.pipeline.run import run
from polhode.progress import Silent

SHORT_END_S = 7.0
Name = tuple[str, str]
"""Module within ``polhode``, and function, or class and method"""
SOLVING = (
    "_cholesky", "_cho_solve", "eliminate_chain", "_factor", "_gather", "subtract_landmarks",
    "stereo_normal_equations", "stereo_residuals", "back_substitute", "_scatter", "correlated_scores",
    "landmark_covariances", "mirror", "inv", "slogdet", "Function_call",
)  # fmt: skip
RAYS, LOOPS = (
    ("run",),
    ("update_blocks", "touched_keys", "add_view", "_marching_cubes_lewiner", "csr_matvecs"),
)
STAGES: dict[str, tuple[tuple[Name, ...], str, tuple[str, ...]]] = {
    "first motion": (
        (("backend.initialization.initialize", "initialize_motion"),),
        "factorizations, compiled loops",
        SOLVING,
    ),
    "motion and inertia": (
        (("backend.estimate", "estimate_motion"),),
        "factorizations, loops, IPOPT",
        SOLVING,
    ),
    "causal estimate": ((("backend.window.estimator", "estimate_online"),), "factorizations, IPOPT", SOLVING),
    "checks of data and answer": (
        (
            ("pipeline.data_checks.check_data", "check_data"),
            ("pipeline.answer_checks.check_answer", "check_answer"),
            ("pipeline.answer_checks.check_answer", "check_surface"),
            ("pipeline.answer_checks.image_motion", "ImageMotion._compare"),
        ),
        "factorizations, loops, optical flow, rays",
        (*SOLVING, "calc", "run"),
    ),
    "depth": (
        (("frontend.extract", "_depth_of"),),
        "semi-global matching, convolutions",
        ("compute", "conv2d", "mkldnn_convolution"),
    ),
    "fusion": (
        (("mapping.fusion.field", "Field.add"), ("mapping.fusion.field", "Field.surface")),
        "voxels and vertices in each frame",
        LOOPS,
    ),
    "finishing": (
        (
            ("pipeline.finish_surface", "_views"),
            ("mapping.finishing.hole_closing", "close_small_holes"),
            ("mapping.finishing.albedo", "divide_shading"),
            ("pipeline.coverage", "with_classes"),
            ("pipeline.coverage", "coverage_of"),
            ("mapping.finishing.detail_levels", "levels_of"),
            ("pipeline.uniform_density", "check_physics"),
        ),
        "rays, decimation",
        (*RAYS, "simplify", "csr_matvecs"),
    ),
    "pictures": (
        (("pipeline.pictures.run_pictures", "make_pictures"),),
        "rays, drawing, encoders",
        (*RAYS, "write", "encode", "print_png", "imencode", "draw"),
    ),
    "files and page": (
        (
            ("pipeline.run_directory.outputs", "write_surface"),
            ("pipeline.run_directory.outputs", "write_estimate"),
            ("pipeline.report.page", "finish_run"),
        ),
        "compression, encoders",
        ("compress", "encode", "b2a_base64", "iterencode"),
    ),
}
"""Functions of a stage, what bounds it, and the names of the functions that do that"""


def main(
    sequence: Positional[Annotated[Path, arg(metavar="SEQ", help="Folder of a sequence.")]] = ROOT / "sample",
    before: Annotated[Path | None, arg(metavar="CHECKOUT", help="Another checkout.")] = None,
    repeat: Annotated[int, arg(help="Runs of each.")] = 1,
    warm: Annotated[bool, arg(help="All is compiled already: no run before those that are counted.")] = False,
    short: Short = False,
    timed_run: Annotated[Path | None, arg(help="Only run into this folder, and print the times.")] = None,
) -> None:
    """Measure and print."""
    if timed_run is not None:
        print(json.dumps(run_in_stages(sequence, timed_run)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        if short:
            polhode("import", sequence, "-o", folder / "part", "--end", SHORT_END_S)
            sequence = folder / "part"
        checkouts = [ROOT] if before is None else [before, ROOT]
        found: dict[Path, list[dict[str, Any]]] = {checkout: [] for checkout in checkouts}
        # once without counting: compiled code and files are then where they belong
        for n in range(1 if warm else 0, repeat + 1):
            for checkout in checkouts:
                times = _run_of(checkout, sequence.resolve(), folder / f"{n}_{checkouts.index(checkout)}")
                if n > 0:
                    found[checkout].append(times)
    print_table(*table(found[ROOT], found.get(before) if before is not None else None))


def _run_of(checkout: Path, sequence: Path, run_folder: Path) -> dict[str, Any]:
    """This module's measurement, with the program of a checkout."""
    with tempfile.TemporaryDirectory() as place:
        # Python looks for modules in the current folder first
        (Path(place) / "polhode").symlink_to((checkout / "polhode").resolve())
        (Path(place) / "benchmarks").symlink_to(ROOT / "benchmarks")
        words = ["-m", "benchmarks.live.stages", str(sequence), "--timed-run", str(run_folder)]
        done = subprocess.run(
            [sys.executable, *words], cwd=place, stdout=subprocess.PIPE, text=True, check=True
        )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def table(now: list[dict[str, Any]], before: list[dict[str, Any]] | None) -> tuple[str, list[list[str]]]:
    """Columns and rows, medians over the runs; with ``before`` its seconds and the ratio."""
    columns = "stage | bounded by | s of the processor | of these in what bounds it"
    columns += "" if before is None else " | s before | before / now"
    rows = []
    for stage in [*STAGES, "all"]:
        seconds, bounding = (median(run[stage][k] for run in now) for k in (0, 1))
        bound = STAGES[stage][1] if stage in STAGES else ""
        row = [stage, bound, f"{seconds:.2f}", f"{bounding:.2f}"]
        if before is not None:
            then = median(run[stage][0] for run in before)
            row += [f"{then:.2f}", f"{then / max(seconds, 1e-3):.2f}"]
        rows.append(row)
    return columns, rows


def run_in_stages(sequence: Path, run_folder: Path) -> dict[str, tuple[float, float]]:
    """One run in this process: for each stage its seconds, and those in the functions that bound it."""
    profiles = {stage: cProfile.Profile(process_time) for stage in STAGES}
    for stage, (names, _, _) in STAGES.items():
        for name in names:
            _measure(*name, profiles[stage])
    config = Config()
    alone = config.runtime.model_copy(update={"workers": 1})
    run(config.model_copy(update={"runtime": alone}), sequence, run_folder, Silent())
    found = {stage: seconds_of(pstats.Stats(profiles[stage]), STAGES[stage][2]) for stage in STAGES}
    return found | {"all": (sum(s for s, _ in found.values()), sum(b for _, b in found.values()))}


def seconds_of(stats: pstats.Stats, bounding: tuple[str, ...]) -> tuple[float, float]:
    """Of all functions, and of the named ones, by themselves."""
    # every entry: (file, line, name) -> calls, primitive calls, own seconds, all seconds, callers
    entries: Mapping[tuple[str, int, str], tuple[Any, ...]] = stats.stats  # type: ignore[attr-defined]
    total = sum(entry[2] for entry in entries.values())
    return total, sum(entry[2] for (_, _, name), entry in entries.items() if _plain(name) in bounding)


def _plain(name: str) -> str:
    """The name of a function without what the profiler says of a built-in one."""
    words = name.strip("<>").replace("'", "").split()
    if len(words) > 1 and words[0] == "method":
        return words[1]
    return words[-1].rpartition(".")[2].removeprefix("_casadi.") if len(words) > 1 else name


def _measure(module: str, name: str, profile: cProfile.Profile) -> None:
    """Profile the calls of a function, under whatever name the program's modules know it."""
    holder = sys.modules[f"polhode.{module}"]
    owner, _, method = name.rpartition(".")
    if owner:
        setattr(getattr(holder, owner), method, _profiled(getattr(getattr(holder, owner), method), profile))
        return
    function = getattr(holder, name)
    profiled = _profiled(function, profile)
    for known in [each for key, each in sys.modules.items() if key.startswith("polhode")]:
        for attribute, value in list(vars(known).items()):
            if value is function:
                setattr(known, attribute, profiled)


def _profiled(function: Callable[..., Any], profile: cProfile.Profile) -> Callable[..., Any]:
    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        profile.enable()
        try:
            return function(*arguments, **named)
        finally:
            profile.disable()

    return call


if __name__ == "__main__":
    command(main)
