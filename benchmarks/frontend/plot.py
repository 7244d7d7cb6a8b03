"""Correct matches against time: which methods of the front end are worth their time."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.frontend.tables import correct_at, lines_of, pairs_of, precision_of, times_ms
from benchmarks.record import Case

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
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _place(lines: Sequence[Case], gap: int, precision: float) -> tuple[float, float]:
    """Seconds, correct matches a pair at the given precision."""
    return sum(times_ms(lines, gap)) / 1e3, correct_at(pairs_of(lines, gap), precision)


def _beats(other: tuple[float, float], place: tuple[float, float]) -> bool:
    """Faster and at least as good, or as fast and better."""
    return other != place and other[0] <= place[0] and other[1] >= place[1]
