"""Errors of the tracker of edges against those that were expected before there was an image.

    python -m lab.edges.expected_errors [--short] [--rich] [--stored] [--workers 1] [--record DIR]

Fourteen bodies, all edges or the longest that make up three quarters and half of their length, 20 poses from
4 m to 2 m and 10 at 3 m, 30 images of each pose under other Suns. What is expected
(``polhode/planning/edges/expected_tracking.py``) knows model and pose, neither the Sun nor the image. Of
each pair of a model and a pose the root mean square of the errors of its trials is compared with the
expected standard deviation, for each degree of freedom. Pairs of which more than the error of the start is
expected, or nothing, are left out; "all pairs" has them with the start's, as a tracker should not end
farther off. "Off": median displacement of the edges in the image. "Confirmed": trials that have settled, and
of which the image confirms ``CONFIRMED``. "NEES, stated": squared error of the confirmed trials over the
covariance that the tracker states, per degree of freedom; "and expected": with that of the expected
displacement besides; "held out": with ``polhode/planning/edges/expected_tracking.py`` fitted to all other
bodies, its median over that of chi-squared, and the share of trials within its ellipsoid of 95 %.
``--rich``: bodies with their own paint and cells, which the model of edges does not have.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2
from tyro.conf import arg

from lab.command import Record, Short, Workers, command
from lab.edges.trials import (
    CROWDED,
    PLAIN,
    RIG,
    SHARES,
    START_DEG,
    START_M,
    models_of,
    off_px,
    rounded,
    trials_of,
)
from lab.edges.views import KINDS, NAMES
from lab.presentation import print_table
from lab.record import Case, complete, measured
from polhode.geometry.lie import Array, Bools
from polhode.planning.edges.expected_tracking import TrackedCovariance, expected_tracking
from polhode.planning.edges.observability_metric import (
    DEGREES_OF_FREEDOM,
    edge_motion,
    observability,
    pose_error,
)
from polhode.planning.edges.tracking import track_edges
from polhode.planning.edges.visible_edges import SPACING_PX, control_points

RECORD = Path("runs/records/expected_errors")
MIN_TRIALS, MIN_PAIRS = 3, 3
"""Of a root mean square, and of a row of the table"""
CONFIRMED = 0.8
"""Least agreement of a trial that a user would keep"""
DEGREES_OF_STUDENT = 8.0
"""Of freedom of Student's distribution: between the normal one and tails without a variance"""
LIMIT = np.array([START_M] * 3 + [np.deg2rad(START_DEG)] * 3)
SHORT_BODIES = ("block", "satellite")


def main(
    short: Short = False,
    rich: Annotated[bool, arg(help="Bodies of the simulator with their own surface.")] = False,
    workers: Workers = 1,
    record: Record = RECORD,
    stored: Annotated[bool, arg(help="Only print what was measured before.")] = False,
) -> None:
    """Measure what the record lacks; print the tables."""
    wanted = cases(short, rich)
    lines = measured(record, wanted) if stored else complete(record, wanted, measure, workers)
    every = [pair for line in lines for pair in _pairs(line)]
    columns = ["pairs and trials", "kept", "value", *DEGREES_OF_FREEDOM]
    print_table(" | ".join(columns), _rows(every), right_from=3)
    print()
    print_table(
        "body | pairs | error over expected, median (5 % to 95 %) | off [px] | NEES, stated | and expected"
        " | held out | median | within 95 % | settled | confirmed",
        _bodies(every),
    )
    known = [errors for _, errors in _known(every) if len(errors.error)]
    if known:
        print(f"\nfitted to all: {fitted_covariance(known)}")


def cases(short: bool, rich: bool) -> list[Case]:
    """A case is a pose of a body; bodies and ranges come by turns, so that a part of them represents all."""
    images, poses = (3, 1) if short else (30, 20)
    ranges = {"2 to 4 m": (2.0, 4.0, 1, poses), "3 m": (3.0, 3.0, 2, min(poses, 10))}
    found: list[Case] = [
        {"part": "pairs", "range": name, "body": body, "pose": pose, "images": images, "rich": rich,
         "near_m": near, "far_m": far, "seed": seed, "poses": count}
        for name, (near, far, seed, count) in ranges.items()
        for pose in range(count)
        for body in (SHORT_BODIES if short else KINDS if rich else NAMES)
    ]  # fmt: skip
    return sorted(found, key=lambda case: (case["pose"] + 1) / case["poses"])


def measure(case: Case) -> dict[str, Any]:
    """All trials of one pose of one body."""
    trials = trials_of(case)
    whole, X_RG = trials.whole, trials.X_RG
    models, results = models_of(whole), []
    for model in models:
        expected = expected_tracking(model, RIG, X_RG, known=whole)
        displacement = expected.displacement.T @ expected.displacement / len(expected.displacement)
        points = control_points(model, RIG, X_RG, SPACING_PX)
        f = edge_motion(points, RIG, X_RG, model.centre_G)
        results.append(
            {
                "expected": rounded(expected.covariance),
                "displacement": rounded(displacement),
                "plain": rounded(observability(f, points.weight, model.radius_m).sigma),
                "trials": [],
            }
        )
    for image, true, start in trials:
        p_G = control_points(whole, RIG, true, SPACING_PX).p_G
        for model, result in zip(models, results, strict=True):
            found = track_edges(model, RIG, image, start, known=None if model is models[0] else whole)
            result["trials"].append(
                {
                    "error": rounded(pose_error(found.X_RG, true, whole.centre_G)),
                    "off_px": rounded(off_px(p_G, found.X_RG, true)),
                    "settled": bool(found.converged),
                    "agreement": rounded(found.agreement),
                    "covariance": rounded(found.covariance[np.triu_indices(6)]),
                }
            )
    return {"models": results}


@dataclass(frozen=True)
class KnownErrors:
    """Errors of n poses of one body."""

    error: Array
    """(n, 6) [m, rad]"""
    stated: Array
    """(n, 6, 6) P that the tracker states"""
    displacement: Array
    """(n, 6, 6) D, mean square of what is expected"""
    agreement: Array
    """(n,) share that the image confirms"""


@dataclass(frozen=True)
class Pair:
    """Trials of one model at one pose."""

    body: str
    range: str
    determined: bool
    """Whether less than the error of the start is expected, for each degree of freedom"""
    expected: Array
    """(6,) [m, rad], at most the error of the start"""
    plain: Array
    """(6,) of the metric, for one pixel"""
    errors: KnownErrors
    off_px: Array
    """(n,)"""
    settled: Bools
    """(n,)"""

    @property
    def confirmed(self) -> Bools:
        """(n,) trials that a user would keep, who does not know the truth."""
        return self.settled & (self.errors.agreement >= CONFIRMED)

    def rms(self, which: Bools | None = None) -> Array:
        """(6,) of all trials, or of some."""
        error = self.errors.error if which is None else self.errors.error[which]
        return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def _pairs(line: Case) -> Iterator[Pair]:
    """All models of a pose of a body."""
    rows, columns = np.triu_indices(6)
    for _, result in zip(SHARES, line["models"], strict=True):
        expected, displacement, plain = (
            np.array(result[key], dtype=np.float64) for key in ("expected", "displacement", "plain")
        )
        sigma = np.sqrt(np.diagonal(expected.reshape(6, 6)))
        error, agreement, off, upper = (
            np.array([trial[key] for trial in result["trials"]], dtype=np.float64)
            for key in ("error", "agreement", "off_px", "covariance")
        )
        covariance = np.empty((len(error), 6, 6))
        covariance[:, rows, columns] = covariance[:, columns, rows] = upper
        yield Pair(
            line["case"]["body"],
            line["case"]["range"],
            bool(np.isfinite(sigma).all() and (sigma < LIMIT).all()),
            np.minimum(np.where(np.isnan(sigma), np.inf, sigma), LIMIT),
            plain,
            KnownErrors(
                error, covariance, np.tile(displacement.reshape(6, 6), (len(error), 1, 1)), agreement
            ),
            off,
            np.array([trial["settled"] for trial in result["trials"]], dtype=bool),
        )


def _rows(every: Sequence[Pair]) -> Iterator[list[str]]:
    groups = {
        f"{title}, {name}": [pair for pair in every if pair.body in bodies and pair.range == name]
        for name in dict.fromkeys(pair.range for pair in every)
        for title, bodies in (("plain", PLAIN), ("crowded", CROWDED), ("all", NAMES))
    }
    for name, group in groups.items():
        pairs = [pair for pair in group if pair.determined]
        if not pairs:
            continue
        lost = 1.0 - np.mean(np.concatenate([pair.confirmed for pair in pairs]))
        confirmed = [pair for pair in pairs if pair.confirmed.sum() >= MIN_TRIALS]
        for kept, used, rms in (
            (f"confirmed, {lost:.1%} lost", confirmed, [pair.rms(pair.confirmed) for pair in confirmed]),
            ("every trial", pairs, [pair.rms() for pair in pairs]),
            ("every trial of all pairs", group, [pair.rms() for pair in group]),
        ):
            if len(used) < MIN_PAIRS:
                continue
            measured_rms, expected = np.array(rms), np.array([pair.expected for pair in used])
            ratio = measured_rms / expected
            values = {
                "r": [np.corrcoef(measured_rms[:, k], expected[:, k])[0, 1] for k in range(6)],
                "r of logarithms": log_correlation(measured_rms, expected),
                "the same, plain metric": log_correlation(
                    measured_rms, np.array([pair.plain for pair in used])
                ),
                "error over expected": np.exp(np.mean(np.log(ratio), axis=0)),
            }
            for value, numbers in values.items():
                yield [f"{name}, {len(used)}", kept, value, *(f"{each:.2f}" for each in numbers)]


def log_correlation(a: Array, b: Array) -> list[float]:
    """Of the pairs of which both are known."""
    known = np.isfinite(b).all(axis=1)
    return [float(np.corrcoef(np.log(a[known, k]), np.log(b[known, k]))[0, 1]) for k in range(6)]


def _known(every: Sequence[Pair]) -> Iterator[tuple[str, KnownErrors]]:
    """By body: errors of the confirmed trials whose covariance the tracker states, of determined pairs."""
    for body in dict.fromkeys(pair.body for pair in every if pair.determined):
        own = [pair for pair in every if pair.body == body and pair.determined]
        which = np.concatenate(
            [pair.confirmed & np.isfinite(pair.errors.stated).all(axis=(1, 2)) for pair in own]
        )
        parts = (
            np.concatenate([getattr(pair.errors, each.name) for pair in own]) for each in fields(KnownErrors)
        )
        yield body, KnownErrors(*(part[which] for part in parts))


def _bodies(every: Sequence[Pair]) -> Iterator[list[str]]:
    """A row for each body, and for the groups of them."""
    known = dict(_known(every))
    held_out = {}
    for body, errors in known.items():
        others = [each for name, each in known.items() if name != body and len(each.error)]
        covariance = fitted_covariance(others) if others and len(errors.error) else None
        held_out[body] = np.zeros(0) if covariance is None else _nees(errors, covariance)
    groups = {**{name: (name,) for name in known}, "plain": PLAIN, "crowded": CROWDED, "all": NAMES}
    for title, bodies in groups.items():
        own = [pair for pair in every if pair.body in bodies and pair.determined]
        if not own:
            continue
        low, middle, high = np.quantile([pair.rms() / pair.expected for pair in own], [0.05, 0.5, 0.95])
        off, settled, confirmed = (
            np.concatenate([getattr(pair, key) for pair in own]) for key in ("off_px", "settled", "confirmed")
        )
        nees = [
            np.concatenate([_nees(known[name], each) for name in known if name in bodies])
            for each in (TrackedCovariance(1.0, 0.0, 0.0), TrackedCovariance(1.0, 1.0, 0.0))
        ]
        calibrated = np.concatenate([held_out[name] for name in known if name in bodies])
        yield [
            title,
            f"{len(own)} of {sum(pair.body in bodies for pair in every)}",
            f"{middle:.2f} ({low:.2f} to {high:.2f})",
            f"{np.median(off):.3f}",
            *(f"{np.mean(each) / 6.0:.2f}" if len(each) else "-" for each in (*nees, calibrated)),
            f"{np.median(calibrated) / chi2.median(6):.2f}" if len(calibrated) else "-",
            f"{np.mean(calibrated < chi2.ppf(0.95, 6)):.1%}" if len(calibrated) else "-",
            f"{settled.mean():.0%}",
            f"{confirmed.mean():.0%}",
        ]


def _nees(known: KnownErrors, covariance: TrackedCovariance) -> Array:
    """Normalised squared errors (n,): 6 in the mean where the covariance is right."""
    C = covariance.of(known.stated, known.displacement, known.agreement)
    return np.asarray(np.einsum("ni,ni->n", known.error, np.linalg.solve(C, known.error[..., None])[..., 0]))


def fitted_covariance(bodies: Sequence[KnownErrors]) -> TrackedCovariance:
    """The likeliest for the errors of all bodies, each of which has poses and counts alike.

    Under Student's distribution, so that a pose that is wrong altogether counts little.
    """
    scaled = []
    for known in bodies:
        # metres and radians are alike in units of the stated sigmas
        sigma = np.sqrt(np.diagonal(known.stated, axis1=1, axis2=2))
        product = sigma[:, :, None] * sigma[:, None, :]
        parts = (known.error / sigma, known.stated / product, known.displacement / product, known.agreement)
        scaled.append(KnownErrors(*parts))

    def loss(log_size: Array) -> float:
        covariance = TrackedCovariance(*(float(value) for value in np.exp(log_size)))
        total = 0.0
        for known in scaled:
            C = covariance.of(known.stated, known.displacement, known.agreement)
            tail = np.log1p(_nees(known, covariance) / DEGREES_OF_STUDENT)
            total += np.mean(0.5 * np.linalg.slogdet(C)[1] + 0.5 * (DEGREES_OF_STUDENT + 6.0) * tail)
        return float(total / len(scaled))

    simplex = np.vstack([np.zeros(3), 0.7 * np.eye(3)])
    options = {"initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-5}
    found = minimize(loss, np.zeros(3), method="Nelder-Mead", options=options)
    return TrackedCovariance(*(float(value) for value in np.exp(found.x)))


if __name__ == "__main__":
    command(main)
