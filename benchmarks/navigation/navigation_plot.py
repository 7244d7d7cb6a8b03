"""Errors of the three filters over time, root mean square over all runs; dashed: with wrong poses."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter

from benchmarks.navigation.navigation_runs import FILTERS, PARTS, SETTLED_S, UNITS
from benchmarks.navigation.navigation_scene import instants
from benchmarks.record import Case

COLOURS = {"fixed": "#8a8f94", "gated": "#d58f00", "calibrated": "#33556e"}
WIDTHS = {"fixed": 4.0, "gated": 1.6, "calibrated": 1.6}
SHOWN = (0, 2)
"""Parts of the state: position, attitude."""


def plot(lines: list[Case], path: Path) -> None:
    """A row for each kind of poses and scenario, written to a PNG."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    gated = [line for line in lines if line["case"]["gate"] < 1.0]
    settings = list(dict.fromkeys(_setting(line) for line in gated))
    figure, panels = plt.subplots(
        len(settings), len(SHOWN), figsize=(11.0, 2.7 * len(settings)), layout="constrained", squeeze=False
    )
    for row, setting in zip(panels, settings, strict=True):
        for axes, part in zip(row, SHOWN, strict=True):
            for line in gated:
                if _setting(line) == setting:
                    _draw(axes, line, part)
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(FuncFormatter(_plain))
            axes.yaxis.set_minor_formatter(FuncFormatter(_plain))
            axes.tick_params(axis="y", which="minor", labelsize=7)
            axes.axvspan(0.0, SETTLED_S, color="#f2f4f6", zorder=0)
            axes.grid(color="#e8ecf0", which="both")
            axes.set_xlim(0.0, instants()[-1])
            axes.set_ylabel(f"rms {PARTS[part]}")
            axes.set_title(f"{setting[0]} poses, {setting[1]}", fontsize=10)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]; errors count after the shaded part")
    panels[0, 0].legend(frameon=False, fontsize=8, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _plain(value: float, _: int) -> str:
    """1, 2 and 5 of each power of ten."""
    return f"{value:g}" if f"{value:e}"[0] in "125" else ""


def _setting(line: Case) -> tuple[str, str]:
    return line["case"]["source"], line["case"]["scenario"]


def _draw(axes: Axes, line: Case, part: int) -> None:
    wrong = line["case"]["wrong"]
    for name in FILTERS:
        axes.plot(
            instants(),
            UNITS[part] * np.array(line[name]["rms"])[:, part],
            color=COLOURS[name],
            linestyle="--" if wrong else "-",
            # where no threshold is the best one, gated lies on fixed
            linewidth=(0.5 if wrong else 1.0) * WIDTHS[name],
            label=f"{name}, {wrong:.0%} bad" if wrong else name,
        )
