"""Edges that lie side by side: the tracker of stripes against that of single edges, on the same images.

    python -m benchmarks.edges.thin_parts [--short] [--workers 1] [--record DIR]

Images, poses, starts and models are those of ``benchmarks.edges.observability`` (all edges, and the longest
that make up half of their length). "off": root mean square displacement in the image, at the estimated pose,
of the control points of all edges. "NEES": squared error of the pose, normalised by the covariance, over its
six degrees of freedom; 1 in the mean where the covariance is right. Every trial counts, whether or not the
tracker says that it has converged; "settled" is the share of those that have.
"""

from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

from benchmarks.command import Record, Short, Workers, command
from benchmarks.edges.observability import (
    RIG,
    START_DEG,
    START_M,
    jittered,
    levels,
    off_px,
    poses_of,
    rounded,
    views_of,
)
from benchmarks.edges.tracking.stripe_tracker import track_stripes
from benchmarks.edges.tracking.tracker import track
from benchmarks.edges.views import NAMES, perturbed, random_suns
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete
from polhode.lie import Array
from polhode.planning.edges.observability_metric import pose_error
from polhode.planning.edges.visible_edges import SPACING_PX, control_points

RECORD = Path("runs/records/thin_parts")
POSES, IMAGES = 6, 3
SHORT = ("block", "satellite")
MODELS = {"all edges": 0, "half of them": 2}
TRACKERS = ("single", "stripes")


def main(short: Short = False, workers: Workers = 1, record: Record = RECORD) -> None:
    """Measure what the record lacks, print the table."""
    poses, each = (2, 1) if short else (POSES, IMAGES)
    names = SHORT if short else NAMES
    common = {"part": "trend", "near_m": 2.0, "far_m": 4.0, "rich": False, "seed": 1}
    cases: list[Case] = [{"body": body, "poses": poses, "each": each, **common} for body in names]
    lines = complete(record, cases, measure, workers)
    columns = (
        "body | model | trials | tracker | off: median [px] | 90 % below | settled | NEES / 6: median | s"
    )
    print_table(columns, _rows(lines), right_from=4)


def measure(case: Case) -> dict[str, Any]:
    """All trials of one body."""
    views, model = views_of(case["body"], case["rich"])
    o_G = model.centre_G
    trials = []
    for number, X_RG in enumerate(poses_of(case, model)):
        rng = np.random.default_rng([case["seed"], 7, number])
        suns = random_suns(case["each"], case["seed"] + 1000 * number)
        truths = np.array([jittered(X_RG, o_G, rng) for _ in suns])
        starts = perturbed(truths, o_G, case["seed"] + 1000 * number, START_DEG, START_M)
        for k, (true, sun, start) in enumerate(zip(truths, suns, starts, strict=True)):
            image = views.image(true, sun, 1000 * number + k)
            p_G = control_points(model, RIG, true, SPACING_PX).p_G
            for name, level in MODELS.items():
                chosen = levels(model)[level]
                begin = process_time()
                single = track(chosen, RIG, image, start)
                between = process_time()
                striped = track_stripes(chosen, RIG, image, start, known=model)
                seconds = between - begin, process_time() - between
                trials.append(
                    {
                        "model": name,
                        "off_px": rounded([off_px(p_G, each.X_RG, true) for each in (single, striped)]),
                        "settled": [bool(single.converged), bool(striped.converged)],
                        "nees": rounded(
                            [_nees(each.X_RG, true, o_G, each.covariance) for each in (single, striped)]
                        ),
                        "seconds": rounded(seconds),
                    }
                )
    return {"trials": trials}


def _nees(X_RG: Array, true: Array, o_G: Array, covariance: Array) -> float:
    """Over six; inf where a direction is not observable, or there is no covariance."""
    if not np.isfinite(covariance).all():
        return np.inf
    error = pose_error(X_RG, true, o_G)
    return float(error @ np.linalg.solve(covariance, error)) / 6.0


def _rows(lines: list[Case]) -> Iterator[list[str]]:
    for line in lines:
        for name in MODELS:
            trials = [each for each in line["trials"] if each["model"] == name]
            for k, tracker in enumerate(TRACKERS):
                off, nees, seconds = (
                    np.array([each[key][k] for each in trials], dtype=np.float64)
                    for key in ("off_px", "nees", "seconds")
                )
                yield [
                    line["case"]["body"],
                    name,
                    str(len(trials)),
                    tracker,
                    f"{np.median(off):.3f}",
                    f"{np.quantile(off, 0.9):.3f}",
                    f"{np.mean([each['settled'][k] for each in trials]):.0%}",
                    f"{np.nanmedian(nees):.2f}" if np.isfinite(nees).any() else "-",
                    f"{seconds.mean():.2f}",
                ]


if __name__ == "__main__":
    command(main)
