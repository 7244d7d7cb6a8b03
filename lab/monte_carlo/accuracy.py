"""Monte Carlo at the thesis's size: errors against the Cramer-Rao bound, and consistency of the sigmas.

    python -m lab.monte_carlo.accuracy [--seeds 100] [--motions 6] [--workers 2] [--short]
                                  [--estimated] [--record FILE]

Per motion and noise: 115 frames, about 2,400 landmarks and 24,700 stereo observations, a cold start from
relative poses, full smoothing. ``--estimated``: the strength of the process noise is estimated too; else it
is given.

"RMSE / bound" divides the root mean squared error over seeds and frames by that of the bound at the true
state (``lab/monte_carlo/bound.py``). "NEES" is the mean normalised squared error over its expectation;
its 95 % band is that of the chi-square with as many degrees of freedom as the correlated frames are worth. *
marks what lies outside. "all": every sequence with its own bound.
"""

import time
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.stats import chi2
from tyro.conf import arg

from lab.command import RECORDS, Record, Seeds, Short, Workers, command
from lab.monte_carlo.bound import (
    COMPONENTS,
    UNITS,
    cold_start,
    cramer_rao_bound,
    errors_of,
    normalised_squares,
)
from lab.presentation import numbers, print_table
from lab.record import Case, complete, measured
from polhode.compare.problem.sources import SCENES
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array
from polhode.runtime.errors import RunFailure
from polhode.simulation.monte_carlo import generate

RECORD = RECORDS / "accuracy"
"""Kept in the repository: a thousand sequences take an hour, and any machine can continue."""
MOTIONS = {
    "spin of 10 RPM near the middle axis (TS38)": SCENES["ts38"],
    "flip of a box, 8 RPM": SCENES["flip"],
    "minor-axis wobble, 8 RPM": SCENES["minor_wobble"],
    "triaxial tumble, 7 RPM": SCENES["tumble"],
    "slow tumble, 5 deg/s, a pair every 2 s": SCENES["slow_tumble"],
    "fast tumble, 20 RPM, 4 pairs a second": SCENES["fast_tumble"],
    "clear flip, nearly equal moments": replace(SCENES["ts38"], w_G=(0.16, 1.04, 0.16)),
    "major-axis wobble, 8 RPM": SCENES["major_wobble"],
}
NOISES_PX = (1.0, 0.3)
SHORT_MOTIONS, SHORT_SEEDS = 1, 1
QUANTITIES = ("r", "v", "attitude", "w", "com", "inertia")
HEAD = ("motion", "noise [px]", "seeds", *QUANTITIES)


def main(
    seeds: Seeds = 100,
    motions: Annotated[int, arg(help="So many of the motions.")] = len(MOTIONS),
    workers: Workers = 2,
    short: Short = False,
    estimated: Annotated[bool, arg(help="Estimate the process noise too; else it is given.")] = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    names = list(MOTIONS)[: SHORT_MOTIONS if short else motions]
    mode = "estimated" if estimated else "given"
    # seeds outermost: an interrupted benchmark has as many of each cell
    cases = [
        {"motion": motion, "noise_px": noise, "process_noise": mode, "seed": seed}
        for seed in range(SHORT_SEEDS if short else seeds)
        for motion in names
        for noise in NOISES_PX
    ]
    lines = complete(record, cases, measure, workers)
    cells = [(motion, noise) for motion in names for noise in NOISES_PX]
    print_tables([(cell, [line for line in lines if _cell(line) == cell]) for cell in cells])
    if estimated:
        given = measured(record, [{**case, "process_noise": "given"} for case in cases])
        print_cost_of_estimating(lines, given)


def measure(case: Case) -> Case:
    """One sequence: squared errors, those of the bound, normalised squares, degrees of freedom."""
    noise = case["noise_px"]
    scene = replace(MOTIONS[case["motion"]], sigma_uv_px=noise, sigma_d_px=noise)
    # other seeds in every cell
    cell = list(MOTIONS).index(case["motion"]) * len(NOISES_PX) + NOISES_PX.index(noise)
    sequence = generate(scene, 1000 * cell + case["seed"])
    known = {"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd}
    # the simulated measurements have no error that every frame shares
    none = (0.0, 0.0, 0.0)
    given = Backend(solver="gauss_newton", process_noise="given", systematic_px=none, light_px=0.0, **known)
    estimated = Backend(solver="gauss_newton", process_noise="estimated", systematic_px=none, light_px=0.0)
    config = given if case["process_noise"] == "given" else estimated
    start = time.perf_counter()
    try:
        _, estimate = cold_start(sequence, config)
    except RunFailure as failure:
        return {"failure": str(failure)}
    seconds = time.perf_counter() - start
    bound, errors = cramer_rao_bound(sequence, given), errors_of(estimate, sequence, config)
    return {
        "observations": len(sequence.tracks.frame),
        "squares": errors.mean_squares.tolist(),
        "bound": bound.mean_squares.tolist(),
        "nees": normalised_squares(errors, estimate).tolist(),
        "freedom": bound.freedom.tolist(),
        "ratios": errors.ratios.tolist(),
        "converged": estimate.solver.converged,
        "accel_psd": estimate.noise.accel_psd,
        "torque_psd": estimate.noise.torque_psd,
        "seconds": round(seconds, 2),
    }


def print_tables(cells: list[tuple[tuple[str, float], list[Case]]]) -> None:
    """Errors, errors over the bound, consistency; and in how many cells these hold."""
    names = [(*name, _count(lines)) for name, lines in cells]
    good_cells = [good(lines) for _, lines in cells]
    all_lines = [line for _, lines in cells for line in lines]
    all_good = good(all_lines)
    print("\nRoot mean squared errors: mm, mm/s, deg, deg/s, mm, and of k1, k2\n")
    rows = []
    for name, lines in zip(names, good_cells, strict=True):
        squares = np.mean([line["squares"] for line in lines], axis=0)[:5]
        ratios = np.sqrt(np.mean(np.square([line["ratios"] for line in lines]), axis=0))
        rows.append([*name, *numbers((*(UNITS[:5] * np.sqrt(squares)), *ratios), ".3g")])
    print_table((*HEAD[:-1], "k1", "k2"), rows)
    over = [over_bound(lines) for lines in good_cells]
    everything = ("all", "", _count(all_lines))
    together = np.sqrt(np.mean([np.divide(line["squares"], line["bound"]) for line in all_good], axis=0))
    print("\nRMSE / bound\n")
    rows = [
        [*name, *(f"{x:.3f}{'*' if x > 1.15 else ''}" for x in values)]
        for name, values in zip(names, over, strict=True)
    ]
    print_table(HEAD, [*rows, [*everything, *numbers(together, ".3f")]])
    print("\nNEES over its expectation (95 % band)\n")
    consistent = [consistency(lines) for lines in good_cells]
    inside = [(low <= nees) & (nees <= high) for nees, low, high in consistent]
    rows = [[*name, *with_band(lines)] for name, lines in zip(names, good_cells, strict=True)]
    print_table(HEAD, [*rows, [*everything, *with_band(all_good)]])
    seconds = np.median([line["seconds"] for line in all_good])
    print(
        f"\nRMSE at most {np.max(over):.3f} of the bound, "
        f"at most 1.15 in {np.mean(np.array(over) <= 1.15):.1%} "
        f"of the cells; NEES inside its band in {np.mean(inside):.1%}; "
        f"{len(all_lines) - len(all_good)} of {len(all_lines)} runs failed; {seconds:.1f} s a run."
    )


def print_cost_of_estimating(estimated: list[Case], given: list[Case]) -> None:
    """The same sequences with the process noise estimated and given, all together."""
    pairs = same_sequences(good(estimated), good(given))
    if not pairs:
        return
    ours, theirs = (list(lines) for lines in zip(*pairs, strict=True))
    squares = [
        np.mean([np.divide(line["squares"], line["bound"]) for line in some], axis=0)
        for some in (ours, theirs)
    ]
    print(f"\nThe same {len(pairs)} sequences with the process noise given\n")
    rows = [
        ["RMSE, estimated over given", *numbers(np.sqrt(squares[0] / squares[1]), ".3f")],
        ["NEES, estimated", *with_band(ours)],
        ["NEES, given", *with_band(theirs)],
    ]
    print_table(("", *QUANTITIES), rows)


def same_sequences(estimated: list[Case], given: list[Case]) -> list[tuple[Case, Case]]:
    """Pairs of lines that differ in the process noise only."""
    by_name = {(*_cell(line), line["case"]["seed"]): line for line in given}
    names = [(*_cell(line), line["case"]["seed"]) for line in estimated]
    return [(line, by_name[name]) for line, name in zip(estimated, names, strict=True) if name in by_name]


def over_bound(lines: list[Case]) -> Array:
    """(6,) root mean squared error over root mean squared bound."""
    squares, bound = (np.array([line[name] for line in lines]) for name in ("squares", "bound"))
    return np.asarray(np.sqrt(squares.mean(axis=0) / bound.mean(axis=0)))


def consistency(lines: list[Case]) -> tuple[Array, Array, Array]:
    """Mean NEES over its expectation (6,), with the ends of its 95 % band (6,) each."""
    nees, freedom = (np.array([line[name] for line in lines]) for name in ("nees", "freedom"))
    known = np.isfinite(nees)
    total = np.sum(freedom * known, axis=0)
    # each sequence weighs as much as its degrees of freedom
    mean = np.nansum(freedom * nees / COMPONENTS, axis=0) / total
    return np.asarray(mean), chi2.ppf(0.025, total) / total, chi2.ppf(0.975, total) / total


def with_band(lines: list[Case]) -> list[str]:
    """Cells of `consistency`; * marks what lies outside of its band."""
    return [
        f"{x:.2f}{'' if a <= x <= b else '*'} ({a:.2f}-{b:.2f})"
        for x, a, b in zip(*consistency(lines), strict=True)
    ]


def _cell(line: Case) -> tuple[str, float]:
    return line["case"]["motion"], line["case"]["noise_px"]


def good(lines: list[Case]) -> list[Case]:
    """Those of runs that did not fail."""
    return [line for line in lines if "failure" not in line]


def _count(lines: list[Case]) -> str:
    failed = len(lines) - len(good(lines))
    return f"{len(lines)}" + (f" ({failed} failed)" if failed else "")


if __name__ == "__main__":
    command(main)
