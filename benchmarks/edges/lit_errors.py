"""What the Sun's direction and the body's own surface do to the errors of the tracker of stripes.

    python -m benchmarks.edges.lit_errors [--short] [--stored] [--workers 1] [--record DIR] [-o PNG]

Bodies of the simulator, each in one matte grey and with its own surface: paint, solar cells, foil, glints.
Each pose is seen under several Suns, 20 to 100 degrees from the camera, so that edges lie in the light, in
shadow, and beside borders of shadows. Of each pose and Sun some images are tracked; the root mean square of
their errors is compared with three predictions that are made without an image: the metric C^-1, which knows
no light; what is expected of the tracker under any Sun; and what is expected under this Sun.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from benchmarks.command import Png, Record, Short, Workers, command
from benchmarks.edges.expected_errors import CONFIRMED, MIN_TRIALS, draw_errors, log_correlation
from benchmarks.edges.observability import LENS, RIG, START_DEG, START_M, foreseen, jittered, off_px, rounded
from benchmarks.edges.tracking.stripe_tracker import track_stripes
from benchmarks.edges.views import (
    KINDS,
    EdgeViews,
    ViewOptions,
    edge_body,
    perturbed,
    random_poses,
    random_suns,
)
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete, measured
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.expected_tracking import expected_tracking, lit_from
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM, pose_error
from polhode.planning.edges.visible_edges import SPACING_PX, control_points
from polhode.records import Bools

RECORD = Path("runs/records/lit_errors")
POSES, SUNS, IMAGES = 4, 5, 4
RANGE_M = (2.0, 3.5)
SUN_DEG = (20.0, 100.0)
EARTH = 0.2
"""Level of a white surface that faces the Earth, in the shadow of the Sun"""
LIT_DEG = 60.0
"""Suns nearer to the camera light most of what it sees."""
SURFACES = {"matte": False, "own": True}
PREDICTIONS = ("metric", "any Sun", "this Sun")
RIGHT_PX = 1.0
"""A pose whose edges are off by less is right"""


def cases(short: bool) -> list[Case]:
    """A case is a pose of a body, under all Suns and with both surfaces."""
    poses, suns, images = (2, 3, 3) if short else (POSES, SUNS, IMAGES)
    return [
        {"body": body, "pose": pose, "suns": suns, "images": images, "seed": 1}
        for pose in range(poses)
        for body in KINDS
    ]


def main(
    short: Short = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
    output: Png = None,
) -> None:
    """Measure what the record lacks; print the tables; draw the pairs."""
    wanted = cases(short)
    lines = measured(record, wanted) if stored else complete(record, wanted, measure, workers)
    lit = [each for line in lines for each in _lit(line)]
    groups = {
        f"{surface}, {name}": [each for each in lit if each.surface == surface and low <= each.sun_deg < high]
        for surface in SURFACES
        for name, low, high in (
            ("all Suns", 0.0, 180.0),
            (f"below {LIT_DEG:g} deg", 0.0, LIT_DEG),
            (f"above {LIT_DEG:g} deg", LIT_DEG, 180.0),
        )
    }
    print("Correlation of the logarithms of errors and predictions, over poses and Suns\n")
    columns = ["surface and Sun", "pairs", "trials confirmed", "prediction", *DEGREES_OF_FREEDOM]
    print_table(" | ".join(columns), _rows(groups), right_from=1)
    print("\nErrors over what is expected under this Sun; a trial is right below 1 px\n")
    columns = [
        "body",
        "surface",
        "right",
        "confirmed",
        "of those right",
        "error over expected: median",
        "90 %",
    ]
    print_table(" | ".join(columns), _bodies(lit), right_from=2)
    if output:
        draw(lit, output)


def measure(case: Case) -> dict[str, Any]:
    """One pose of one body."""
    number, seed = case["pose"], 1000 * case["seed"] + case["pose"]
    model = edge_model(edge_body(case["body"]).mesh)
    o_G = model.centre_G
    X_RG = random_poses(model.surface, RIG, number + 1, case["seed"], RANGE_M)[number]
    suns_R = random_suns(case["suns"], seed, SUN_DEG)
    # what is predicted knows the shape, not the surface
    any_sun, metric = expected_tracking(model, RIG, X_RG), foreseen(model, RIG, X_RG)[0].sigma
    each_sun = [expected_tracking(model, RIG, X_RG, lit_from(sun_R[None], EARTH)) for sun_R in suns_R]
    out: list[dict[str, Any]] = []
    for surface, rich in SURFACES.items():
        target = edge_body(case["body"], plain=not rich)
        views = EdgeViews(target, RIG, case["seed"], ViewOptions(earth=EARTH, sensor=LENS))
        for k, (sun_R, this_sun) in enumerate(zip(suns_R, each_sun, strict=True)):
            rng = np.random.default_rng([seed, 7, k])
            truths = np.array([jittered(X_RG, o_G, rng) for _ in range(case["images"])])
            starts = perturbed(truths, o_G, 100 * seed + k, START_DEG, START_M)
            out.append(
                {
                    "surface": surface,
                    "sun_deg": float(np.rad2deg(np.arccos(-sun_R[2]))),
                    "metric": rounded(metric),
                    "any Sun": rounded(_sigma(any_sun.covariance)),
                    "this Sun": rounded(_sigma(this_sun.covariance)),
                    "trials": [
                        _trial(views, model, true, start, sun_R, 100 * k + number)
                        for number, (true, start) in enumerate(zip(truths, starts, strict=True))
                    ],
                }
            )
    return {"lit": out}


def _sigma(covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.diagonal(covariance)))


def _trial(
    views: EdgeViews, model: EdgeModel, true: Array, start: Array, sun_R: Array, number: int
) -> dict[str, Any]:
    found = track_stripes(model, RIG, views.image(true, sun_R, number), start)
    p_G = control_points(model, RIG, true, SPACING_PX).p_G
    return {
        "error": rounded(pose_error(found.X_RG, true, model.centre_G)),
        "off_px": rounded(off_px(p_G, found.X_RG, true)),
        "agreement": rounded(found.agreement if found.converged else 0.0),
    }


@dataclass(frozen=True)
class Lit:
    """Trials of one pose under one Sun."""

    body: str
    surface: str
    sun_deg: float
    predicted: dict[str, Array]
    """(6,) [m, rad] of each of ``PREDICTIONS``; NaN where it says that a direction is not seen"""
    error: Array
    """(n, 6)"""
    off_px: Array
    """(n,)"""
    confirmed: Bools
    """(n,) trials that a user would keep, who does not know the truth"""

    @property
    def rms(self) -> Array:
        """(6,) of the confirmed trials."""
        return np.asarray(np.sqrt(np.mean(self.error[self.confirmed] ** 2, axis=0)))


def _lit(line: Case) -> Iterator[Lit]:
    for told in line["lit"]:
        error, off, agreement = (
            np.array([trial[key] for trial in told["trials"]], dtype=np.float64)
            for key in ("error", "off_px", "agreement")
        )
        predicted = {name: np.array(told[name], dtype=np.float64) for name in PREDICTIONS}
        yield Lit(
            line["case"]["body"],
            told["surface"],
            told["sun_deg"],
            predicted,
            error,
            off,
            agreement >= CONFIRMED,
        )


def _compared(group: Sequence[Lit]) -> list[Lit]:
    """Those of which all is known, with enough confirmed trials."""
    limit = np.array([START_M] * 3 + [np.deg2rad(START_DEG)] * 3)
    return [
        each
        for each in group
        if each.confirmed.sum() >= MIN_TRIALS
        and all(np.isfinite(value).all() for value in each.predicted.values())
        # where more is expected than the error of the start, the start would be measured
        and (each.predicted["any Sun"] < limit).all()
    ]


def _rows(groups: dict[str, list[Lit]]) -> Iterator[list[str]]:
    for name, group in groups.items():
        used = _compared(group)
        if len(used) < MIN_TRIALS:
            continue
        rms = np.array([each.rms for each in used])
        share = np.mean(np.concatenate([each.confirmed for each in group]))
        for prediction in PREDICTIONS:
            told = np.array([each.predicted[prediction] for each in used])
            r = log_correlation(rms, told)
            yield [name, str(len(used)), f"{share:.0%}", prediction, *(f"{each:.2f}" for each in r)]


def _bodies(lit: Sequence[Lit]) -> Iterator[list[str]]:
    for body in dict.fromkeys(each.body for each in lit):
        for surface in SURFACES:
            own = [each for each in lit if each.body == body and each.surface == surface]
            right = np.concatenate([each.off_px < RIGHT_PX for each in own])
            confirmed = np.concatenate([each.confirmed for each in own])
            used = _compared(own)
            ratio = np.array([each.rms / each.predicted["this Sun"] for each in used]).reshape(-1)
            yield [
                body,
                surface,
                f"{right.mean():.0%}",
                f"{confirmed.mean():.0%}",
                f"{right[confirmed].mean():.0%}" if confirmed.any() else "-",
                *(f"{q:.2f}" for q in (np.quantile(ratio, [0.5, 0.9]) if len(ratio) else [np.nan] * 2)),
            ]


def draw(lit: Sequence[Lit], output: Path) -> None:
    """Errors over what is expected under the Sun of their images."""
    groups = {}
    for surface in SURFACES:
        used = _compared([each for each in lit if each.surface == surface])
        told = [[each.predicted["this Sun"], each.rms] for each in used]
        expected, rms = np.reshape(told, (-1, 2, 6)).swapaxes(0, 1)
        groups[f"{surface} surface"] = expected, rms
    draw_errors(groups, output)


if __name__ == "__main__":
    command(main)
