"""How well checks and verdict tell wrong runs from right ones, by the records of runs with known truth.

    python -m lab.robustness.verdict [--records DIR ...] [-o PNG]

A run is wrong if a claim is beyond five of its sigmas and a floor (``lab/robustness/judge.py``), good
if none is beyond five sigmas; what is between is left out. So is a body of revolution whose rate was not
found and is called undetermined; it is wrong if the rate is beyond five of the sigmas stated besides. For
each check: the area under the curve of the receiver operating characteristic (AUC; 0.5: no power, 1: tells
all apart), its value over its limit being the score, the share of the wrong runs in which it raises a doubt,
and that of the undisturbed good ones. The verdict's score is the largest of its checks; its point on the
curve is the status. A good run with a real fault in its data is rightly doubted: the share that is spoiled is
that of undisturbed runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.stats import mannwhitneyu
from tyro.conf import arg

from lab.command import RECORDS, Png, command
from lab.presentation import print_table, save_figure, subplots
from lab.record import lines_of
from lab.robustness.data_faults import FAULTS as IMAGE_FAULTS
from lab.robustness.judge import SIGMAS, doubted
from polhode.geometry.lie import Array, Bools

OWN = tuple(RECORDS / name for name in ("measurement_faults", "data_faults", "trust"))
UNDISTURBED = ("none", "few")
NAMED = {"focal": IMAGE_FAULTS["focal_wrong"].named}
"""Expressions of warnings that name a fault of the measurements"""
FOUND_DEG_S = 0.1
"""A rate is found within this, as vectors in N, root mean square over the frames"""
MIN_VALUES = 5
"""Good runs, and wrong ones, of which a check has a value"""


@dataclass(frozen=True)
class Judged:
    """Runs, and what is known of them."""

    lines: list[dict[str, Any]]
    wrong: Bools
    """(n,)"""
    good: Bools
    """(n,)"""
    undisturbed: Bools
    """(n,) without a fault"""
    missed: Bools
    """(n,) bodies of revolution whose rate was not found and is called undetermined: not good for it"""
    said: Bools
    """(n,) status or a warning doubts the answer"""


def main(
    records: Annotated[tuple[Path, ...], arg(help="Records with checks; those of the repository.")] = OWN,
    output: Png = None,
) -> None:
    """Print the tables, draw the curves."""
    runs = judged_runs([line for record in records for line in lines_of(record) if line.get("checks")])
    if not runs.wrong.any() or not runs.good.any():
        raise SystemExit("no wrong run, or no good one, has checks: measure with measurement_faults first")
    print_verdict(runs)
    scores = check_scores(runs.lines)
    print_checks(runs, scores)
    if output is not None:
        draw(runs, scores, output)


def judged_runs(lines: list[dict[str, Any]]) -> Judged:
    """Each run against its truth; failed ones say so and are neither."""
    lines = [line for line in lines if line["status"] != "failed"]
    worst = [max((each["worst_sigmas"] for each in line["claims"].values()), default=0.0) for line in lines]
    wrong = np.array([bool(line["wrong"]) for line in lines], dtype=np.bool_)
    good = np.array([sigmas <= SIGMAS for sigmas in worst], dtype=np.bool_)
    missed = np.array([_rate_missed(line) for line in lines], dtype=np.bool_)
    beyond = np.array([line.get("rate_error_deg_s", 0.0) > _bound(line) for line in lines], dtype=np.bool_)
    wrong, good = wrong | (missed & beyond), good & ~missed
    faults = [line["case"].get("fault", "none") for line in lines]
    undisturbed = np.array([fault in UNDISTURBED for fault in faults], dtype=np.bool_)
    said = [
        doubted(line, IMAGE_FAULTS[fault].named if fault in IMAGE_FAULTS else NAMED.get(fault, ()))
        for line, fault in zip(lines, faults, strict=True)
    ]
    return Judged(lines, wrong, good & ~wrong, undisturbed, missed, np.array(said, dtype=np.bool_))


def _rate_missed(line: dict[str, Any]) -> bool:
    """Whether a run of ``lab.missions`` that leaves the rate undetermined is off by more than what counts
    as found there: it claims next to nothing, and is not good for that reason.
    """
    return "rate" not in line["claims"] and line.get("rate_error_deg_s", 0.0) > FOUND_DEG_S


def _bound(line: dict[str, Any]) -> float:
    """Error of the rate [deg/s] beyond which the stated one is wrong; infinite where none was stated."""
    sigma = line.get("rate_sigma_deg_s")
    return float("inf") if sigma is None else SIGMAS * float(sigma)


def check_scores(lines: Sequence[dict[str, Any]]) -> dict[str, Array]:
    """By check (n,): value over limit, inverse where the limit is the least value; above 1 it is doubted.

    NaN where the check was not possible; without checks that have no limit.
    """
    names = dict.fromkeys(name for line in lines for name in line["checks"])
    out = {}
    for name in names:
        found = [line["checks"].get(name, (None, None, False)) for line in lines]
        known = [(value, limit, beyond) for value, limit, beyond in found if None not in (value, limit)]
        if not known:
            continue
        at_least = any(beyond == (value < limit) and value != limit for value, limit, beyond in known)
        out[name] = np.array([_score(value, limit, at_least) for value, limit, _ in found])
    return out


def _score(value: float | None, limit: float | None, at_least: bool) -> float:
    if value is None or limit is None:
        return float("nan")
    a, b = (limit, value) if at_least else (value, limit)
    return float(a / b) if b > 0.0 else (float("inf") if a > 0.0 else 0.0)


def area(wrong: Array, good: Array) -> float:
    """AUC: the probability that a wrong run has the larger score than a good one."""
    return float(mannwhitneyu(wrong, good).statistic) / (len(wrong) * len(good))


def print_verdict(runs: Judged) -> None:
    """Shares of the wrong runs that pass as ok, and of the good ones that are doubted."""
    ok = np.array([line["status"] == "ok" for line in runs.lines], dtype=np.bool_)
    print(f"\n{len(runs.lines)} runs: {runs.wrong.sum()} wrong, {runs.good.sum()} good, of these ", end="")
    clean = runs.good & runs.undisturbed
    print(f"{clean.sum()} undisturbed\n")
    # beyond five sigmas, but by less than what matters in practice
    slight = ~runs.wrong & ~runs.good & ~runs.missed
    rows = [
        ("wrong, status ok", *_share(ok, runs.wrong)),
        ("wrong, status ok and no warning that doubts it", *_share(~runs.said, runs.wrong)),
        ("undisturbed and good, spoiled", *_share(~ok, clean)),
        ("good with a fault in the data, doubted", *_share(~ok, runs.good & ~runs.undisturbed)),
        ("beyond five sigmas by less than the floor, status ok", *_share(ok, slight)),
        (
            "beyond five sigmas by less than the floor, and no warning that doubts it",
            *_share(~runs.said, slight),
        ),
    ]
    print_table(("runs", "number", "of", "share"), rows, right_from=1)
    print()


def _share(which: Bools, among: Bools) -> tuple[int, int, str]:
    n, of = int(np.sum(which & among)), int(among.sum())
    return n, of, f"{100.0 * n / max(of, 1):.1f} %"


def print_checks(runs: Judged, scores: dict[str, Array]) -> None:
    """Power of each check, and of all together."""
    rows = []
    together = np.nanmax(np.vstack(list(scores.values())), axis=0)
    for name, score in [*scores.items(), ("the verdict: largest of all", together)]:
        known = np.isfinite(score) | np.isposinf(score)
        wrong, good = known & runs.wrong, known & runs.good & runs.undisturbed
        if min(wrong.sum(), good.sum()) < MIN_VALUES:
            continue
        rows.append((
            name,
            f"{wrong.sum()}, {good.sum()}",
            f"{area(score[wrong], score[good]):.2f}",
            f"{np.mean(score[wrong] > 1.0):.0%}",
            f"{np.mean(score[good] > 1.0):.1%}",
            f"{np.quantile(score[good], 0.97):.2f}",
        ))  # fmt: skip
    rows.sort(key=lambda row: -float(row[2]))
    print_table(
        (
            *("check", "wrong, good runs with a value", "AUC", "wrong found", "good spoiled"),
            "97 % of the good ones below (limit 1)",
        ),
        rows,
        right_from=1,
    )


def curve(wrong: Array, good: Array) -> tuple[Array, Array]:
    """Shares of good runs doubted and of wrong ones found, as the threshold falls."""
    thresholds = np.concatenate([[np.inf], np.unique(np.concatenate([wrong, good]))[::-1], [-np.inf]])
    return (
        np.array([np.mean(good >= t) for t in thresholds]),
        np.array([np.mean(wrong >= t) for t in thresholds]),
    )


def draw(runs: Judged, scores: dict[str, Array], path: Path) -> None:
    """The curves of the verdict and of the strongest checks, and the verdict's point."""
    together = np.nanmax(np.vstack(list(scores.values())), axis=0)
    clean = runs.good & runs.undisturbed
    known = {name: np.where(np.isnan(score), 0.0, score) for name, score in scores.items()}
    strongest = sorted(known, key=lambda name: -area(known[name][runs.wrong], known[name][clean]))[:5]
    figure, axes = subplots(1, 1, (6.4, 5.2))
    for name in strongest:
        axes.plot(*curve(known[name][runs.wrong], known[name][clean]), lw=1, label=name)
    axes.plot(*curve(together[runs.wrong], together[clean]), "k", lw=2, label="the verdict")
    at = np.mean(together[clean] > 1.0), np.mean(together[runs.wrong] > 1.0)
    axes.plot(*at, "ko", ms=7, label="its limits")
    axes.set(
        xlabel="undisturbed good runs that are doubted",
        ylabel="wrong runs that are found",
        xlim=(-0.01, 1),
        ylim=(0, 1.01),
    )
    axes.legend(fontsize=8, loc="lower right")
    figure.tight_layout()
    save_figure(figure, path, 110)


if __name__ == "__main__":
    command(main)
