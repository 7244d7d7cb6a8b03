"""Tables of benchmarks.edges.observability: trends, consistency of covariances, wrong poses."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import NullFormatter
from scipy.optimize import minimize
from scipy.stats import chi2, mannwhitneyu, spearmanr

from benchmarks.edges.tracking.calibrated_covariance import EdgeNoise, NoiseParts, fitted, nees
from benchmarks.edges.tracking.residual import FEATURES, TRUSTED, probability
from benchmarks.presentation import markdown_table, numbers, save_figure, subplots
from benchmarks.record import Case
from polhode.lie import Array
from polhode.planning.edges.observability_metric import DEGREES_OF_FREEDOM
from polhode.records import Bools

TRIANGLE = np.triu_indices(6)
UNITS = np.array([1e3] * 3 + [np.rad2deg(1.0)] * 3)
"""m to mm, rad to degrees"""
RIGHT_PX, WRONG_PX = 1.5, 3.0
"""A pose counts as right, or as wrong, by the distance of its edges from their true positions."""
NEAR_RIGHT_PX, NEAR_WRONG_PX = 0.3, (0.6, 6.0)
MIN_TRIALS = 3
STRICT = 0.95
"""Probability from which a trial counts in the trends: near misses of a pixel spoil a root mean square."""


@dataclass(frozen=True)
class Spot:
    """One model at one pose."""

    body: str
    level: int
    sigma: Array
    """(6,) predicted, for one pixel"""
    errors: Array
    """(n, 6) of the trials that converged"""
    off_px: Array
    """(n,)"""
    support: Array
    """(n, k) FEATURES"""
    sigma_px: Array
    """(n,)"""
    C: Array
    """(n, 6, 6) of the fits"""
    parts: Array
    """(n, 3, 6, 6) of the fits"""
    trials: int
    """converged or not"""


def spots_of(lines: Sequence[Case]) -> list[Spot]:
    """Those whose edges determine all six degrees of freedom."""
    out = []
    for line in lines:
        for row in line["rows"]:
            good = [trial for trial in row["trials"] if trial["ok"]]
            C = _full(np.array(row["C"]))
            if not row["seen"]:
                continue
            out.append(
                Spot(
                    line["case"]["body"],
                    row["level"],
                    np.sqrt(np.diagonal(np.linalg.inv(C))),
                    np.array([t["error"] for t in good]).reshape(-1, 6),
                    np.array([t["off_px"] for t in good]),
                    np.array([t["support"] for t in good]).reshape(-1, len(FEATURES)),
                    np.array([t["sigma_px"] for t in good]),
                    _full(np.array([t["C"] for t in good]).reshape(-1, 21)),
                    _full(np.array([t["parts"] for t in good]).reshape(-1, 3, 21)),
                    len(row["trials"]),
                )
            )
    return out


def _full(upper: Array) -> Array:
    """Upper triangles (..., 21) -> symmetric (..., 6, 6)."""
    out = np.zeros((*upper.shape[:-1], 6, 6))
    out[..., TRIANGLE[0], TRIANGLE[1]] = upper
    out[..., TRIANGLE[1], TRIANGLE[0]] = upper
    return out


def trusted(spot: Spot) -> Bools:
    """(n,) trials that the residual statistic lets pass."""
    return np.asarray(probability(spot.support) >= STRICT)


def everything(spot: Spot) -> Bools:
    """(n,) all that converged."""
    return np.ones(len(spot.errors), dtype=bool)


def root_mean_squares(spots: Sequence[Spot], keep: Any) -> tuple[Array, Array]:
    """Measured and predicted errors, (n, 6) each, of spots with enough trials."""
    rms, sigma = [], []
    for spot in spots:
        chosen = keep(spot)
        if chosen.sum() >= MIN_TRIALS:
            rms.append(np.sqrt((spot.errors[chosen] ** 2).mean(axis=0)))
            sigma.append(spot.sigma)
    return np.array(rms).reshape(-1, 6), np.array(sigma).reshape(-1, 6)


def by_model(spots: Sequence[Spot], keep: Any) -> tuple[Array, Array]:
    """The same over models: all poses of each together."""
    rms, sigma = [], []
    for name in dict.fromkeys((spot.body, spot.level) for spot in spots):
        own = [s for s in spots if (s.body, s.level) == name and keep(s).sum() >= MIN_TRIALS]
        if own:
            rms.append(np.sqrt(np.mean(np.concatenate([s.errors[keep(s)] for s in own]) ** 2, axis=0)))
            sigma.append(np.sqrt(np.mean([s.sigma**2 for s in own], axis=0)))
    return np.array(rms).reshape(-1, 6), np.array(sigma).reshape(-1, 6)


def trend_table(groups: Mapping[str, Sequence[Spot]]) -> str:
    """Correlation of measured error with the metric, per degree of freedom."""
    rows = []
    for group, spots in groups.items():
        for how, keep in (("converged", everything), ("residual", trusted)):
            rms, sigma = root_mean_squares(spots, keep)
            if len(rms) < 4:
                continue
            model_rms, model_sigma = by_model(spots, keep)
            kept = sum(int(keep(spot).sum()) for spot in spots)
            lost = 1.0 - kept / max(sum(spot.trials for spot in spots), 1)
            ratio = rms / sigma
            measures: dict[str, Array] = {
                "r, error : root of C^-1": _each(np.corrcoef, rms, sigma),
                "r, error : C^-1": _each(np.corrcoef, rms, sigma**2),
                "r, logarithms": _each(np.corrcoef, np.log(rms), np.log(sigma)),
                "r, ranks": np.array([spearmanr(rms[:, k], sigma[:, k]).statistic for k in range(6)]),
                "slope [px]": (rms * sigma).sum(axis=0) / (sigma**2).sum(axis=0),
                "band, 5 %": np.quantile(ratio, 0.05, axis=0),
                "band, 95 %": np.quantile(ratio, 0.95, axis=0),
            }
            if len(model_rms) >= 10:
                together = _each(np.corrcoef, model_rms, model_sigma)
                measures = {f"r, {len(model_rms)} models, their poses together": together} | measures
            for number, (name, values) in enumerate(measures.items()):
                first = [group, f"{how}, {lost:.1%} lost", str(len(rms))] if number == 0 else [""] * 3
                rows.append([*first, name, *numbers(values, ".3f")])
    head = ("group", "poses kept by", "models x poses", "", *DEGREES_OF_FREEDOM)
    return markdown_table(head, rows, right_from=4)


def _each(correlation: Any, a: Array, b: Array) -> Array:
    return np.array([correlation(a[:, k], b[:, k])[0, 1] for k in range(6)])


def good_and_bad_table(spots: Sequence[Spot]) -> str:
    """The errors at values of the metric."""
    rows = []
    kinds = (
        ("across, mm/px", (0, 1), (0.5, 1.0, 1.5, 2.0, 3.0, 6.0)),
        ("along the line of sight, mm/px", (2,), (2.0, 5.0, 10.0, 15.0, 25.0, 50.0)),
        ("turns, degrees/px", (3, 4, 5), (0.05, 0.15, 0.25, 0.4, 0.7, 1.5)),
    )
    for name, axes, bounds in kinds:
        unit = "mm" if axes[0] < 3 else "degrees"
        for low, high in pairwise(bounds):
            found: list[float] = []
            count = 0
            for spot in spots:
                for k in axes:
                    if low <= spot.sigma[k] * UNITS[k] < high:
                        found += list(np.abs(spot.errors[trusted(spot), k]) * UNITS[k])
                        count += 1
            if count >= 5:
                median, most = np.quantile(found, [0.5, 0.9])
                errors = [f"{value:.3f} {unit}" for value in (median, most)]
                rows.append([f"{name}, {low:g} to {high:g}", count, *errors])
    return markdown_table("metric | models x poses | median error | 90 % of errors below", rows, right_from=1)


def joined(spots: Sequence[Spot], keep: Any) -> tuple[NoiseParts, Array, Array]:
    """Noise parts, errors (n, 6) and C (n, 6, 6) of all trials that are kept."""
    chosen = [keep(spot) for spot in spots]

    def take(name: str) -> Array:
        return np.concatenate([getattr(s, name)[c] for s, c in zip(spots, chosen, strict=True)])

    return NoiseParts(take("parts"), take("sigma_px")), take("errors"), take("C")


def nees_table(spots: Sequence[Spot], first_only: bool) -> tuple[str, EdgeNoise, EdgeNoise]:
    """Consistency of covariances on each body, calibrated on the others; the levels of all, with and without
    the image's residual."""
    errors: list[Array] = []
    covariances: dict[str, list[Array]] = {}
    for body in dict.fromkeys(spot.body for spot in spots):
        others, taught, _ = joined([spot for spot in spots if spot.body != body], trusted)
        own = [spot for spot in spots if spot.body == body]
        noise, found, C = joined([_first(spot) for spot in own] if first_only else own, trusted)
        errors.append(found)
        for name, covariance in {
            "C^-1 times mean squared residual": np.linalg.inv(C) * noise.residual_px[:, None, None] ** 2,
            "calibrated, without the image's residual": fitted(others, taught, False).covariance(noise),
            "calibrated": fitted(others, taught).covariance(noise),
        }.items():
            covariances.setdefault(name, []).append(covariance)
    e = np.concatenate(errors)
    n = len(e)
    low, high = chi2.ppf([0.025, 0.975], 6 * n) / (6 * n)
    rows = []
    for name, each_body in covariances.items():
        P = np.concatenate(each_body)
        whole = nees(e, P)
        each = (e**2 / np.diagonal(P, axis1=1, axis2=2)).mean(axis=0)
        inside = float(np.mean(whole < chi2.ppf(0.95, 6)))
        band = f"{low:.2f} to {high:.2f}"
        rows.append([name, n, f"{whole.mean() / 6:.2f}", band, f"{inside:.1%}", *numbers(each, ".2f")])
    noise, found, _ = joined(spots, trusted)
    head = (
        *("covariance", "trials", "mean NEES / 6", "95 % band", "share within its 95 %"), *DEGREES_OF_FREEDOM,
    )  # fmt: skip
    return markdown_table(head, rows, right_from=1), fitted(noise, found), fitted(noise, found, False)


def _first(spot: Spot) -> Spot:
    """One trial of a spot: errors common to a pose make its trials dependent."""
    names = ("errors", "off_px", "support", "sigma_px", "C", "parts")
    return replace(spot, trials=1, **{name: getattr(spot, name)[:1] for name in names})


def wrong_table(lines: Sequence[Case]) -> str:
    """How well statistics separate right from wrong poses: areas under the ROC curve, on bodies held out."""
    features, off, names, kinds, C, metric = [], [], [], [], [], []
    for line in lines:
        for row in line["rows"]:
            trial = row["trial"]
            if trial["ok"]:
                features.append([*trial["support"], trial["sigma_px"]])
                off.append(trial["off_px"])
                names.append(line["case"]["body"])
                kinds.append(row["kind"])
                values = np.linalg.eigvalsh(_full(np.array(trial["C"])))
                C.append(-np.log(np.maximum(values, 1e-9)).sum())
                metric.append(trial["metric"])
    x, d, body = np.array(features), np.array(off), np.array(names)
    clear = (d < RIGHT_PX) | (d > WRONG_PX)
    order = list(dict.fromkeys(names))
    test = clear & np.isin(body, order[1::2])
    right = d < RIGHT_PX
    statistics = {name: x[:, k] for k, name in enumerate(FEATURES)}
    statistics["residual's sigma (small is right)"] = -x[:, -1]
    statistics["C^-1 of the fit, with robust weights (log determinant)"] = -np.array(C)
    statistics["C^-1 of the pose, as the metric has it (log determinant)"] = -np.array(metric)
    statistics["probability (all together)"] = probability(x[:, : len(FEATURES)])
    parts = [
        f"{(right & test).sum()} right and {(~right & test).sum()} wrong poses of {len(order[1::2])} bodies.",
        _area_table(statistics, test, right),
    ]
    near = (d < NEAR_RIGHT_PX) | (d > NEAR_WRONG_PX[0]) & (d < NEAR_WRONG_PX[1])
    near &= np.isin(body, order[1::2])
    close = d < NEAR_RIGHT_PX
    parts.append(
        f"Near misses: {(near & close).sum()} poses within {NEAR_RIGHT_PX} px, "
        f"{(near & ~close).sum()} off by {NEAR_WRONG_PX[0]} to {NEAR_WRONG_PX[1]} px."
    )
    parts.append(_area_table(statistics if (near & ~close).any() else {}, near, close))
    kept = probability(x[:, : len(FEATURES)]) >= TRUSTED
    rows = []
    for kind in dict.fromkeys(kinds):
        own = test & (np.array(kinds) == kind)
        groups = (own, own & right, own & ~right & kept, own & ~right & ~kept, own & right & ~kept)
        rows.append([kind, *(group.sum() for group in groups)])
    head = "start | converged | right | wrong, kept | wrong, refused | right, refused"
    parts.append(markdown_table(head, rows, right_from=1))
    learn = clear & np.isin(body, order[::2])
    weights = learned(x[learn][:, : len(FEATURES)], right[learn])
    return "\n\n".join([*parts, f"Logistic regression on the other bodies: {weights}"])


def _area_table(statistics: Mapping[str, Array], which: Bools, right: Bools) -> str:
    rows = [[name, f"{roc_area(v[which], right[which]):.3f}"] for name, v in statistics.items()]
    return markdown_table("statistic | area under the ROC curve", rows, right_from=1)


def learned(x: Array, right: Bools) -> list[float]:
    """Constant and weights of a logistic regression, with a small ridge."""
    y = np.where(right, 1.0, -1.0)
    each = np.where(right, 0.5 / max(right.sum(), 1), 0.5 / max((~right).sum(), 1))

    def loss(w: Array) -> float:
        return float((each * np.logaddexp(0.0, -y * (w[0] + x @ w[1:]))).sum() + 1e-4 * w[1:] @ w[1:])

    return [round(float(v), 2) for v in minimize(loss, np.zeros(x.shape[1] + 1)).x]


def roc_area(statistic: Array, positive: Bools) -> float:
    """Probability that a positive one of (n,) has the larger statistic: area under the ROC curve."""
    ours, others = statistic[positive], statistic[~positive]
    if not len(ours) or not len(others):
        return 0.0
    return float(mannwhitneyu(ours, others).statistic / (len(ours) * len(others)))


def plot(groups: Mapping[str, Sequence[Spot]], path: Path) -> None:
    """Measured error against the metric, one panel per degree of freedom and group."""
    figure, axes = subplots(len(groups), 6, (18, 3.1 * len(groups)), squeeze=False)
    for row, (group, spots) in zip(axes, groups.items(), strict=True):
        rms, sigma = root_mean_squares(spots, trusted)
        kept = [spot for spot in spots if trusted(spot).sum() >= MIN_TRIALS]
        names = list(dict.fromkeys(spot.body for spot in kept))
        colour = [names.index(spot.body) for spot in kept]
        for k, axis in enumerate(row):
            axis.scatter(sigma[:, k] * UNITS[k], rms[:, k] * UNITS[k], c=colour, cmap="tab20", s=7)
            slope = (rms[:, k] @ sigma[:, k]) / (sigma[:, k] @ sigma[:, k])
            ends = np.array([sigma[:, k].min(), sigma[:, k].max()]) * UNITS[k]
            ratio = np.quantile(rms[:, k] / sigma[:, k], [0.05, 0.95])
            axis.plot(ends, slope * ends, "k-", lw=1)
            axis.fill_between(ends, ratio[0] * ends, ratio[1] * ends, color="k", alpha=0.1, lw=0)
            axis.set(xscale="log", yscale="log")
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.yaxis.set_minor_formatter(NullFormatter())
            unit = "mm" if k < 3 else "deg"
            r = np.corrcoef(rms[:, k], sigma[:, k])[0, 1]
            axis.set_title(f"{DEGREES_OF_FREEDOM[k]}: r = {r:.2f}", fontsize=9)
            axis.set_xlabel(f"root of C^-1 [{unit}/px]", fontsize=8)
            if k == 0:
                axis.set_ylabel(f"{group}\nRMS error [mm, deg]", fontsize=8)
            axis.tick_params(labelsize=7)
    figure.tight_layout()
    save_figure(figure, path, 70)
