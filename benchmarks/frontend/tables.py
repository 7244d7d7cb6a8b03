"""What the measurements of benchmarks/frontend/matching.py say, as tables."""

from collections.abc import Iterable, Mapping, Sequence, Set
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.presentation import save_figure
from benchmarks.record import Case
from polhode.lie import Array

ENOUGH_FEATURES = 30
"""Pairs of frames with so many stereo features each are expected to give a motion."""
ENOUGH_LIGHT_PX = 3000
"""So much of the body must be lit and seen in both frames [px]: with less, motions are luck."""
Lit = Mapping[str, Set[tuple[int, int]]]
"""Per scene, the pairs of frames with enough light in common."""
COLUMNS = (
    "method",
    "stereo features",
    "wrong stereo [%]",
    "matches",
    "correct",
    "precision",
    "correct at equal precision",
    "rotation error [deg]",
    "within 2 deg [%]",
    "within 5 deg [%]",
    "lit pairs within 2 deg [%]",
    "guided within 2 deg: all, lit [%]",
    "ms / stereo pair",
    "ms / match",
    "normalised residuals u, v, d",
)


def lines_of(lines: Iterable[Case], method: str) -> list[Case]:
    """The measurements of one method."""
    return [line for line in lines if line["case"]["method"] == method]


def pairs_of(lines: Iterable[Case], gap: int) -> list[Case]:
    """Pairs of frames so far apart, of all scenes."""
    return [pair for line in lines for pair in line["pairs"] if pair["gap"] == gap]


def precision_of(pairs: Sequence[Case]) -> float:
    """Correct matches over all, at the method's own threshold."""
    return float(sum(pair["correct"] for pair in pairs) / max(1, sum(pair["matches"] for pair in pairs)))


def correct_at(pairs: Sequence[Case], precision: float) -> float:
    """Most correct matches a pair that a threshold on the confidence gives with at least this precision."""
    confidence = np.concatenate([np.asarray(pair["confidence"], float) for pair in pairs])
    right = np.concatenate([np.asarray(pair["right"], float) for pair in pairs])
    if len(right) == 0:
        return 0.0
    order = np.argsort(-confidence, kind="stable")
    correct = np.cumsum(right[order])
    # A threshold takes all matches of one confidence or none.
    last = np.append(np.diff(confidence[order]) != 0, True)
    good = last & (correct >= precision * np.arange(1, len(order) + 1))
    return float(correct[good].max(initial=0.0)) / len(pairs)


def success(
    pairs: Sequence[Case],
    limit_deg: float,
    least_features: int = ENOUGH_FEATURES,
    key: str = "error_deg",
) -> float:
    """Share of the pairs with enough features whose rotation is right."""
    errors = [pair.get(key) for pair in pairs if pair["features"] >= least_features]
    return float(sum(e is not None and e < limit_deg for e in errors) / max(1, len(errors)))


def lit_pairs(light: Iterable[Case]) -> Lit:
    """Pairs with enough light in common, from what was measured of the scenes."""
    return {
        line["case"]["light"]: {(i, j) for i, j, area_px in line["pairs"] if area_px >= ENOUGH_LIGHT_PX}
        for line in light
    }


def lit_of(lines: Iterable[Case], gap: int, lit: Lit) -> list[Case]:
    """Those of ``pairs_of`` with enough light in common; a scene's pairs are in the order of their frames."""
    return [
        pair
        for line in lines
        for i, pair in enumerate(pairs_of([line], gap))
        if (i, i + gap) in lit[line["case"]["scene"]]
    ]


def times_ms(lines: Sequence[Case], gap: int) -> tuple[float, float]:
    """Median time of a stereo pair, and of matching two frames."""
    features = np.concatenate([line["features_s"] for line in lines])
    matching = np.array([pair["match_s"] for pair in pairs_of(lines, gap)])
    return 1e3 * float(np.median(features)), 1e3 * float(np.median(matching))


def residual_variances(pairs: Sequence[Case]) -> Array:
    """Mean normalised squares (3,) of u, v, disparity over the correct matches of the motions found."""
    sums = np.array([pair["squares"] for pair in pairs]).sum(axis=0)
    return np.asarray(sums[:3] / max(1.0, sums[3]))


def print_table(lines: Sequence[Case], methods: Sequence[str], reference: str, gap: int, lit: Lit) -> None:
    """One row a method."""
    target = precision_of(pairs_of(lines_of(lines, reference), gap))
    first = lines_of(lines, reference)
    count, lit_count = len(pairs_of(first, gap)), len(lit_of(first, gap, lit))
    counts = f"{count} pairs, {lit_count} of them lit"
    print(f"\n{30 * gap} degrees between frames: {counts}; equal precision: {target:.3f}\n")
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for method in methods:
        print(_row(method, lines_of(lines, method), target, gap, lit))


def _row(method: str, lines: Sequence[Case], target: float, gap: int, lit: Lit) -> str:
    pairs = pairs_of(lines, gap)
    features = np.concatenate([line["features"] for line in lines])
    wrong = np.concatenate([line["wrong_stereo"] for line in lines])
    errors = [pair["error_deg"] for pair in pairs if pair["error_deg"] is not None]
    stereo_ms, match_ms = times_ms(lines, gap)
    cells = [
        method,
        f"{np.mean(features):.0f}",
        f"{100 * wrong.sum() / max(1, features.sum()):.1f}",
        f"{np.mean([pair['matches'] for pair in pairs]):.0f}",
        f"{np.mean([pair['correct'] for pair in pairs]):.1f}",
        f"{precision_of(pairs):.2f}",
        f"{correct_at(pairs, target):.1f}",
        f"{np.median(errors):.2f}" if errors else "-",
        *(f"{100 * success(pairs, limit):.0f}" for limit in (2.0, 5.0)),
        f"{100 * success(lit_of(lines, gap, lit), 2.0, least_features=0):.0f}",
        ", ".join(
            f"{100 * success(some, 2.0, least, 'guided_deg'):.0f}"
            for some, least in ((pairs, ENOUGH_FEATURES), (lit_of(lines, gap, lit), 0))
        ),
        f"{stereo_ms:.0f}",
        f"{match_ms:.0f}",
        ", ".join(f"{value:.2f}" for value in residual_variances(pairs)),
    ]
    return "| " + " | ".join(cells) + " |"


def print_by_scene(lines: Sequence[Case], methods: Sequence[str], scenes: Sequence[str], gap: int) -> None:
    """Correct matches a pair, and the share of rotations within 2 degrees, scene by scene."""
    print(f"\n{30 * gap} degrees: correct matches, and rotations within 2 degrees [%]\n")
    print(f"| method | {' | '.join(scenes)} |\n|{'---|' * (len(scenes) + 1)}")
    for method in methods:
        cells = []
        for scene in scenes:
            pairs = pairs_of([ln for ln in lines_of(lines, method) if ln["case"]["scene"] == scene], gap)
            correct = np.mean([pair["correct"] for pair in pairs])
            cells.append(f"{correct:.0f}, {100 * success(pairs, 2.0):.0f}")
        print(f"| {method} | {' | '.join(cells)} |")


matplotlib.use("Agg")


ANGLES_DEG = {1: 30, 2: 60}
NAME_WIDTH = 0.6
"""Width of a name on the axis of the times, in natural logarithms."""
OURS, OTHERS = "#b3261e", "#33556e"


def draw_pareto(lines: Sequence[Case], methods: Sequence[str], reference: str, path: Path) -> None:
    """One panel for each turn between the frames; the line joins the methods that no other beats in both."""
    figure, panels = plt.subplots(1, len(ANGLES_DEG), figsize=(11, 4.4), layout="constrained")
    for panel, (gap, degrees) in zip(panels, ANGLES_DEG.items(), strict=True):
        precision = precision_of(pairs_of(lines_of(lines, reference), gap))
        places = [_place(lines_of(lines, method), gap, precision) for method in methods]
        front = sorted(place for place in places if not any(_beats(other, place) for other in places))
        panel.plot(*np.array(front).T, color="0.75", zorder=1)
        step, names = 0.045 * max(correct for _, correct in places), list[tuple[float, float]]()
        for correct, time_s, method in sorted((c, t, m) for m, (t, c) in zip(methods, places, strict=True)):
            colour = OURS if method.startswith("polhode") else OTHERS
            panel.plot(time_s, correct, "o", color=colour, markersize=7)
            # A name rises until it is clear of those beside it.
            beside = [height for other_s, height in names if abs(np.log(other_s / time_s)) < NAME_WIDTH]
            height = max([correct, *(taken + step for taken in beside if taken + step > correct)])
            names.append((time_s, height))
            panel.annotate(method, (1.05 * time_s, height), color=colour, fontsize=8, va="center")
        panel.set_xscale("log")
        # Room for the names to the right of the points.
        panel.set_xlim(panel.get_xlim()[0], 2.2 * panel.get_xlim()[1])
        panel.set_ylim(0, 1.08 * panel.get_ylim()[1])
        panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.xaxis.set_major_formatter("{x:g}")
        panel.xaxis.set_minor_formatter(NullFormatter())
        panel.grid(alpha=0.3)
        panel.set_xlabel("features of a stereo pair and one matching [s of one core]")
        panel.set_ylabel(f"correct matches at precision {precision:.2f}")
        panel.set_title(f"{degrees} degrees of turn between the frames")
    save_figure(figure, path, 110)


def _place(lines: Sequence[Case], gap: int, precision: float) -> tuple[float, float]:
    """Seconds, correct matches a pair at the given precision."""
    return sum(times_ms(lines, gap)) / 1e3, correct_at(pairs_of(lines, gap), precision)


def _beats(other: tuple[float, float], place: tuple[float, float]) -> bool:
    """Faster and at least as good, or as fast and better."""
    return other != place and other[0] <= place[0] and other[1] >= place[1]
