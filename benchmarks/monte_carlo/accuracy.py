"""Monte Carlo at the thesis's size: errors against the Cramer-Rao bound, and whether the sigmas are honest.

    python -m benchmarks.monte_carlo.accuracy [--seeds 100] [--motions 6] [--workers 2] [--short]
                                  [--estimated] [--record FILE]

Per motion and noise: 115 frames, about 2,400 landmarks and 24,700 stereo observations, a cold start from
relative poses, full smoothing. ``--estimated``: the strength of the process noise is estimated too; else it
is given. What was measured before is read from the record: an interrupted benchmark goes on where it stopped.

"RMSE / bound" divides the root mean squared error over seeds and frames by that of the bound at the true
state (``benchmarks/monte_carlo/bound.py``). "NEES" is the mean normalised squared error over its expectation;
its 95 % band is that of the chi-square with as many degrees of freedom as the correlated frames are worth. *
marks what lies outside. "all": every sequence with its own bound.
"""

import time
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.stats import chi2
from tyro.conf import arg

from benchmarks.command import RECORDS, Record, Short, Workers, command
from benchmarks.presentation import table_head, table_row
from benchmarks.record import Case, complete, measured
from polhode.compare.problem.sources import SCENES
from polhode.lie import Array

RECORD = RECORDS / "accuracy.jsonl"
"""Kept in the repository: a thousand sequences take an hour, and any machine can go on with them."""
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
SHORT_MOTIONS, SHORT_SEEDS = 3, 2
HEAD = ("motion", "noise [px]", "seeds", "r", "v", "attitude", "w", "com", "inertia")


def main(
    seeds: Annotated[int, arg(help="Sequences per cell.")] = 100,
    motions: Annotated[int, arg(help="So many of the motions.")] = len(MOTIONS),
    workers: Workers = 2,
    short: Short = False,
    estimated: Annotated[bool, arg(help="Estimate the process noise too; else it is given.")] = False,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    names = list(MOTIONS)[: SHORT_MOTIONS if short else motions]
    draws = range(SHORT_SEEDS if short else seeds)
    mode = "estimated" if estimated else "given"
    # seeds outermost: an interrupted benchmark has as many of each cell
    cases = [
        {"motion": motion, "noise_px": noise, "process_noise": mode, "seed": seed}
        for seed in draws
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
    from benchmarks.monte_carlo.bound import cramer_rao_bound, errors_of, normalised_squares
    from polhode.backend import estimate_motion, initialize_motion
    from polhode.config.backend import Backend
    from polhode.errors import RunFailure
    from polhode.progress import Silent
    from polhode.simulation.monte_carlo import generate

    noise = case["noise_px"]
    scene = replace(MOTIONS[case["motion"]], sigma_uv_px=noise, sigma_d_px=noise)
    # other draws in every cell
    cell = list(MOTIONS).index(case["motion"]) * len(NOISES_PX) + NOISES_PX.index(noise)
    sequence = generate(scene, 1000 * cell + case["seed"])
    known = {"accel_psd": scene.accel_psd, "torque_psd": scene.torque_psd}
    # the simulated measurements have no error that every frame shares
    none = (0.0, 0.0, 0.0)
    given = Backend(solver="gauss_newton", process_noise="given", systematic_px=none, **known)
    estimated = Backend(solver="gauss_newton", process_noise="estimated", systematic_px=none)
    config = given if case["process_noise"] == "given" else estimated
    start = time.perf_counter()
    try:
        initial = initialize_motion(sequence.tracks, sequence.relative, config)
        estimate = estimate_motion(sequence.tracks, initial, config, Silent())
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
    """Errors, errors over the bound, consistency; and in a sentence how many cells hold."""
    print("\nRoot mean squared errors: mm, mm/s, deg, deg/s, mm, and of k1, k2\n")
    print(table_head((*HEAD[:-1], "k1", "k2")))
    for (motion, noise), lines in cells:
        good = _good(lines)
        squares = np.mean([line["squares"] for line in good], axis=0)[:5]
        ratios = np.sqrt(np.mean(np.square([line["ratios"] for line in good]), axis=0))
        unit = np.array([1e3, 1e3, np.rad2deg(1.0), np.rad2deg(1.0), 1e3])
        numbers = [f"{x:.3g}" for x in (*(unit * np.sqrt(squares)), *ratios)]
        print(table_row((motion, noise, _count(lines), *numbers)))
    print("\nRMSE / bound\n")
    print(table_head(HEAD))
    over = [over_bound(_good(lines)) for _, lines in cells]
    for ((motion, noise), lines), values in zip(cells, over, strict=True):
        print(
            table_row((motion, noise, _count(lines), *(f"{x:.3f}{'*' if x > 1.15 else ''}" for x in values)))
        )
    runs = [line for _, lines in cells for line in lines]
    together = np.sqrt(np.mean([np.divide(line["squares"], line["bound"]) for line in _good(runs)], axis=0))
    print(table_row(("all", "", _count(runs), *(f"{x:.3f}" for x in together))))
    print("\nNEES over its expectation (95 % band)\n")
    print(table_head(HEAD))
    inside = []
    for (motion, noise), lines in cells:
        nees, low, high = consistency(_good(lines))
        inside += list((nees >= low) & (nees <= high))
        print(table_row((motion, noise, _count(lines), *_with_band(nees, low, high))))
    print(table_row(("all", "", _count(runs), *_with_band(*consistency(_good(runs))))))
    seconds = np.median([line["seconds"] for line in _good(runs)])
    print(
        f"\nRMSE at most {np.max(over):.3f} of the bound, "
        f"at most 1.15 in {np.mean(np.array(over) <= 1.15):.1%} "
        f"of the cells; NEES inside its band in {np.mean(inside):.1%}; "
        f"{len(runs) - len(_good(runs))} of {len(runs)} runs failed; {seconds:.1f} s a run."
    )


def print_cost_of_estimating(estimated: list[Case], given: list[Case]) -> None:
    """The same sequences with the process noise estimated and given, all together."""
    pairs = same_sequences(_good(estimated), _good(given))
    if not pairs:
        return
    ours, theirs = (list(lines) for lines in zip(*pairs, strict=True))
    squares = [
        np.mean([np.divide(line["squares"], line["bound"]) for line in some], axis=0)
        for some in (ours, theirs)
    ]
    print(f"\nThe same {len(pairs)} sequences with the process noise given\n")
    print(table_head(("", *HEAD[3:])))
    print(table_row(("RMSE, estimated over given", *(f"{x:.3f}" for x in np.sqrt(squares[0] / squares[1])))))
    for name, some in (("NEES, estimated", ours), ("NEES, given", theirs)):
        print(table_row((name, *_with_band(*consistency(some)))))


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
    from benchmarks.monte_carlo.bound import COMPONENTS

    nees, freedom = (np.array([line[name] for line in lines]) for name in ("nees", "freedom"))
    known = np.isfinite(nees)
    total = np.sum(freedom * known, axis=0)
    # each sequence weighs as much as its degrees of freedom
    mean = np.nansum(freedom * nees / COMPONENTS, axis=0) / total
    return np.asarray(mean), chi2.ppf(0.025, total) / total, chi2.ppf(0.975, total) / total


def _with_band(values: Array, low: Array, high: Array) -> list[str]:
    return [
        f"{x:.2f}{'' if a <= x <= b else '*'} ({a:.2f}-{b:.2f})"
        for x, a, b in zip(values, low, high, strict=True)
    ]


def _cell(line: Case) -> tuple[str, float]:
    return line["case"]["motion"], line["case"]["noise_px"]


def _good(lines: list[Case]) -> list[Case]:
    return [line for line in lines if "failure" not in line]


def _count(lines: list[Case]) -> str:
    failed = len(lines) - len(_good(lines))
    return f"{len(lines)}" + (f" ({failed} failed)" if failed else "")


if __name__ == "__main__":
    command(main)
