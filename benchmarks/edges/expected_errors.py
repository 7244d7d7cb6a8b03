"""Errors of the tracker of stripes against those that were expected before there was an image.

    python -m benchmarks.edges.expected_errors [--short] [--stored] [--workers 1] [--record DIR] [-o PNG]

Bodies, models, poses, lights and starts are those of ``benchmarks.edges.observability``: all bodies, all
edges or the longest that make up three quarters and half of their length, 20 poses from 4 m to 2 m and 10 at
3 m, 30 images of each pose. What is expected (``planning/edges/expected_tracking.py``) knows model and pose,
neither the Sun nor the image. Of each pair of a model and a pose the root mean square of the errors of its
trials is compared with the expected standard deviation, for each degree of freedom. Pairs of which more than
the error of the start is expected, or nothing, are left out; "all pairs" has them with the start's, as a
tracker should not end farther off. "Lost": trials that have not settled, or of which the image confirms less
than ``CONFIRMED``. "NEES, stated": squared error of the confirmed trials over the covariance that the tracker
states, per degree of freedom; "and expected": with that of the expected displacement besides; "held out":
with the covariance of ``tracking/stripe_covariance.py`` fitted to all other bodies, its median over that of
chi-squared, and the share of trials within its ellipsoid of 95 %.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import NullFormatter
from scipy.stats import chi2
from tyro.conf import arg

from benchmarks.command import Png, Record, Short, Workers, command
from benchmarks.edges.observability import (
    CLUTTERED,
    FIXED_M,
    PLAIN,
    RIG,
    START_DEG,
    START_M,
    foreseen,
    jittered,
    levels,
    off_px,
    poses_of,
    rounded,
    views_of,
)
from benchmarks.edges.tracking.calibrated_covariance import nees
from benchmarks.edges.tracking.stripe_covariance import StripeErrors, fitted_covariance, joined
from benchmarks.edges.tracking.stripe_tracker import StripeTracking, track_stripes
from benchmarks.edges.views import NAMES, EdgeViews, perturbed, random_suns
from benchmarks.presentation import print_table
from benchmarks.record import Case, complete, measured
from polhode.images import Grey
from polhode.lie import Array
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.expected_tracking import expected_tracking
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM, pose_error
from polhode.planning.edges.visible_edges import SPACING_PX, control_points
from polhode.records import Bools

RECORD = Path("runs/records/expected_errors")
IMAGES, POSES, POSES_AT_FIXED_RANGE = 30, 20, 10
SHORT_IMAGES, SHORT_POSES = 4, 3
MODELS = ("all edges", "three quarters", "half")
MIN_TRIALS, MIN_PAIRS = 3, 3
"""Of a root mean square, and of a row of the table"""
CONFIRMED = 0.8
"""Least agreement of a trial that a user would keep"""


def cases(short: bool) -> list[Case]:
    """A case is a pose of a body; bodies and ranges come by turns, so that a part of them represents all."""
    images, poses = (SHORT_IMAGES, SHORT_POSES) if short else (IMAGES, POSES)
    at = {
        "2 to 4 m": {"near_m": 2.0, "far_m": 4.0, "seed": 1, "poses": poses},
        f"{FIXED_M:g} m": {
            "near_m": FIXED_M,
            "far_m": FIXED_M,
            "seed": 2,
            "poses": min(poses, POSES_AT_FIXED_RANGE),
        },
    }
    found = [
        {
            "part": "pairs",
            "range": name,
            "body": body,
            "pose": pose,
            "images": images,
            "rich": False,
            **common,
        }
        for name, common in at.items()
        for pose in range(common["poses"])
        for body in NAMES
    ]
    return sorted(found, key=lambda case: (case["pose"] + 1) / case["poses"])


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
    every = [pair for line in lines for pair in _pairs(line)]
    pairs = [pair for pair in every if pair.determined]
    groups = {
        f"{title}, {name}": [pair for pair in every if pair.body in bodies and pair.range == name]
        for name in dict.fromkeys(pair.range for pair in every)
        for title, bodies in (("plain", PLAIN), ("crowded", CLUTTERED), ("all", NAMES))
    }
    columns = ["pairs and trials", "kept", "value", *DEGREES_OF_FREEDOM]
    print_table(" | ".join(columns), _rows(groups), right_from=3)
    print()
    columns = [
        "error over expected, median (5 % to 95 %)",
        "NEES, stated",
        "and expected",
        "held out",
        "median",
        "within 95 %",
        "settled",
        "confirmed",
    ]
    print_table(" | ".join(["body", "pairs", *columns]), _bodies(every))
    if output:
        draw(pairs, output)


@dataclass(frozen=True)
class Trials:
    """Images of a body near one pose, and the starts of the tracker."""

    views: EdgeViews
    whole: EdgeModel
    X_RG: Array
    """(4, 4) that something is expected of"""
    true_X_RG: Array
    """(n, 4, 4) of the images"""
    sun_R: Array
    """(n, 3) unit, towards the Sun"""
    start_X_RG: Array
    """(n, 4, 4)"""
    first: int
    """Number of the first image"""

    def image(self, k: int) -> Grey:
        """The k-th."""
        return self.views.image(self.true_X_RG[k], self.sun_R[k], self.first + k)

    def tracked(self, image: Grey, model: EdgeModel, k: int) -> StripeTracking:
        """From the k-th start, by the edges of ``model``; all the others are known."""
        known = None if model.size == self.whole.size else self.whole
        return track_stripes(model, RIG, image, self.start_X_RG[k], known=known)


def trials_of(case: Case) -> Trials:
    """Of one pose of one body."""
    views, whole = views_of(case["body"], case["rich"])
    number, o_G = case["pose"], whole.centre_G
    X_RG = poses_of(case, whole)[number]
    rng = np.random.default_rng([case["seed"], 7, number])
    seed = case["seed"] + 1000 * number
    sun_R = random_suns(case["images"], seed)
    true_X_RG = np.array([jittered(X_RG, o_G, rng) for _ in sun_R])
    start_X_RG = perturbed(true_X_RG, o_G, seed, START_DEG, START_M)
    return Trials(views, whole, X_RG, true_X_RG, sun_R, start_X_RG, 1000 * number)


def measure(case: Case) -> dict[str, Any]:
    """All trials of one pose of one body."""
    trials = trials_of(case)
    whole, X_RG = trials.whole, trials.X_RG
    chosen = levels(whole)
    models = [
        {
            "expected": rounded(expected.covariance),
            "displacement": rounded(
                expected.displacement.T @ expected.displacement / len(expected.displacement)
            ),
            "plain": rounded(foreseen(each, RIG, X_RG)[0].sigma),
            "trials": [],
        }
        for each, expected in ((each, expected_tracking(each, RIG, X_RG, known=whole)) for each in chosen)
    ]
    for k, true in enumerate(trials.true_X_RG):
        image = trials.image(k)
        p_G = control_points(whole, RIG, true, SPACING_PX).p_G
        for model, told in zip(chosen, models, strict=True):
            found = trials.tracked(image, model, k)
            error = pose_error(found.X_RG, true, whole.centre_G)
            told["trials"].append(
                {
                    "error": rounded(error),
                    "off_px": rounded(off_px(p_G, found.X_RG, true)),
                    "settled": bool(found.converged),
                    "agreement": rounded(found.agreement),
                    "covariance": rounded(found.covariance[np.triu_indices(6)]),
                }
            )
    return {"models": models}


@dataclass(frozen=True)
class Pair:
    """Trials of one model at one pose."""

    body: str
    model: str
    range: str
    determined: bool
    """Whether less than the error of the start is expected, for each degree of freedom"""
    expected: Array
    """(6,) [m, rad], at most the error of the start"""
    displacement: Array
    """(6, 6) the part of the expected covariance that comes from what the model lacks"""
    plain: Array
    """(6,) of the metric, for one pixel"""
    errors: Array
    """(n, 6) [m, rad]"""
    covariance: Array
    """(n, 6, 6) that the tracker states; NaN where it states none"""
    settled: Bools
    agreement: Array

    @property
    def confirmed(self) -> Bools:
        """(n,) trials that a user would keep, who does not know the truth."""
        return self.settled & (self.agreement >= CONFIRMED)

    @property
    def confirmed_errors(self) -> StripeErrors:
        """Of the confirmed trials whose covariance the tracker states."""
        which = self.confirmed & np.isfinite(self.covariance).all(axis=(1, 2))
        displacement = np.broadcast_to(self.displacement, (int(which.sum()), 6, 6))
        return StripeErrors(self.errors[which], self.covariance[which], displacement, self.agreement[which])


def _pairs(line: Case) -> Iterator[Pair]:
    """All models of a pose of a body."""
    case = line["case"]
    limit = np.array([START_M] * 3 + [np.deg2rad(START_DEG)] * 3)
    for name, told in zip(MODELS, line["models"], strict=True):
        expected, displacement, plain = (
            np.array(told[key], dtype=np.float64) for key in ("expected", "displacement", "plain")
        )
        sigma = np.sqrt(np.diagonal(expected.reshape(6, 6)))
        determined = bool(np.isfinite(sigma).all() and (sigma < limit).all())
        errors, settled, agreement, upper = (
            np.array([trial[key] for trial in told["trials"]], dtype=kind)
            for key, kind in (
                ("error", float),
                ("settled", bool),
                ("agreement", float),
                ("covariance", float),
            )
        )
        covariance = np.empty((len(errors), 6, 6))
        rows, columns = np.triu_indices(6)
        covariance[:, rows, columns] = covariance[:, columns, rows] = upper
        yield Pair(
            case["body"],
            name,
            case["range"],
            determined,
            np.minimum(np.where(np.isnan(sigma), np.inf, sigma), limit),
            displacement.reshape(6, 6),
            plain,
            errors,
            covariance,
            settled,
            agreement,
        )


def _rms(pairs: Sequence[Pair], all_trials: bool) -> tuple[Array, Array, Array]:
    """Root mean squares (p, 6), expected (p, 6) and plain (p, 6), of pairs with three trials at least."""
    rms, expected, plain = [], [], []
    for pair in pairs:
        errors = pair.errors if all_trials else pair.errors[pair.confirmed]
        if len(errors) >= MIN_TRIALS:
            rms.append(np.sqrt(np.mean(errors**2, axis=0)))
            expected.append(pair.expected)
            plain.append(pair.plain)
    shape = (len(rms), 6)
    return np.reshape(rms, shape), np.reshape(expected, shape), np.reshape(plain, shape)


def _rows(groups: dict[str, list[Pair]]) -> Iterator[list[str]]:
    for name, every in groups.items():
        pairs = [pair for pair in every if pair.determined]
        if not pairs:
            continue
        lost = 1.0 - np.mean(np.concatenate([pair.confirmed for pair in pairs]))
        for kept, group, all_trials in (
            (f"confirmed, {lost:.1%} lost", pairs, False),
            ("every trial", pairs, True),
            ("every trial of all pairs", every, True),
        ):
            rms, expected, plain = _rms(group, all_trials)
            if len(rms) < MIN_PAIRS:
                continue
            ratio = rms / expected
            values = {
                "r": [np.corrcoef(rms[:, k], expected[:, k])[0, 1] for k in range(6)],
                "r of logarithms": log_correlation(rms, expected),
                "the same, plain metric": log_correlation(rms, plain),
                "error over expected": np.exp(np.mean(np.log(ratio), axis=0)),
            }
            for value, numbers in values.items():
                yield [f"{name}, {len(rms)}", kept, value, *(f"{each:.2f}" for each in numbers)]
            low, high = np.quantile(ratio, [0.05, 0.95], axis=0)
            band = (f"{a:.2f} to {b:.2f}" for a, b in zip(low, high, strict=True))
            yield [f"{name}, {len(rms)}", kept, "5 % to 95 %", *band]


def log_correlation(a: Array, b: Array) -> list[float]:
    """Of the pairs of which both are known."""
    known = np.isfinite(b).all(axis=1)
    return [float(np.corrcoef(np.log(a[known, k]), np.log(b[known, k]))[0, 1]) for k in range(6)]


def _bodies(every: Sequence[Pair]) -> Iterator[list[str]]:
    """A row for each body, and for the groups of them."""
    pairs = [pair for pair in every if pair.determined]
    names = list(dict.fromkeys(pair.body for pair in pairs))
    held_out = dict(zip(names, _held_out(names, pairs), strict=True))
    groups = {"plain": PLAIN, "crowded": CLUTTERED, "all": NAMES}
    for title, bodies in {**{name: (name,) for name in names}, **groups}.items():
        own = [pair for pair in pairs if pair.body in bodies]
        if not own:
            continue
        ratio = np.concatenate([(np.sqrt(np.mean(p.errors**2, axis=0)) / p.expected) for p in own])
        low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
        trials = joined([pair.confirmed_errors for pair in own])
        calibrated = np.concatenate([held_out[name] for name in names if name in bodies])
        shares = [np.mean(np.concatenate([getattr(p, key) for p in own])) for key in ("settled", "confirmed")]
        yield [
            title,
            f"{len(own)} of {sum(pair.body in bodies for pair in every)}",
            f"{middle:.2f} ({low:.2f} to {high:.2f})",
            *(
                f"{np.mean(each) / 6.0:.2f}" if len(each) else "-"
                for each in (
                    nees(trials.error, trials.stated),
                    nees(trials.error, trials.stated + trials.displacement),
                    calibrated,
                )
            ),
            f"{np.median(calibrated) / chi2.median(6):.2f}" if len(calibrated) else "-",
            f"{np.mean(calibrated < chi2.ppf(0.95, 6)):.1%}" if len(calibrated) else "-",
            *(f"{share:.0%}" for share in shares),
        ]


def _held_out(names: Sequence[str], pairs: Sequence[Pair]) -> Iterator[Array]:
    """Squared errors (n,) of each body over the covariance that is fitted to all others; none without any."""
    known = {name: joined([pair.confirmed_errors for pair in pairs if pair.body == name]) for name in names}
    for name in names:
        others = [known[other] for other in names if other != name and len(known[other])]
        yield nees(known[name].error, fitted_covariance(others).of(known[name])) if others else np.zeros(0)


def draw(pairs: Sequence[Pair], output: Path) -> None:
    """The confirmed trials of plain and of crowded bodies."""
    groups = {}
    for title, bodies in (("plain", PLAIN), ("crowded", CLUTTERED)):
        rms, expected, _ = _rms([pair for pair in pairs if pair.body in bodies], all_trials=False)
        groups[title] = expected, rms
    draw_errors(groups, output)


def draw_errors(groups: dict[str, tuple[Array, Array]], output: Path) -> None:
    """Root mean squares (n, 6) over what was expected (n, 6) [m, rad], for each degree of freedom."""
    figure, axes = plt.subplots(2, 3, figsize=(11.0, 7.0), constrained_layout=True)
    unit = np.array([1e3] * 3 + [180.0 / np.pi] * 3)
    for k, (axis, name) in enumerate(zip(axes.ravel(), DEGREES_OF_FREEDOM, strict=True)):
        for title, (expected, rms) in groups.items():
            axis.loglog(unit[k] * expected[:, k], unit[k] * rms[:, k], ".", ms=4, label=title)
        ends = np.array(axis.get_xlim())
        axis.loglog(ends, ends, "k-", lw=0.8)
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set(xlabel=f"expected, {name} [{'mm' if k < 3 else 'deg'}]", ylabel="error, root mean square")
    axes[0, 0].legend(frameon=False)
    figure.savefig(output, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    command(main)
