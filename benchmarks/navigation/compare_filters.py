"""Does a filter that weighs tracked poses by the metric follow a tumbling target better than others?

    python -m benchmarks.navigation.compare_filters [--source drawn tracked] [--short] [--plot FILE]
                                                      [--record FILE]

Three filters, which differ in the weights of poses: constant; constant if enough edges were found; by the
calibrated covariance of its view. Poses are `drawn` from the tracker's linear model  or
`tracked` in rendered images , the same for all filters. Factors and thresholds are chosen
on training runs of other seeds. Intervals: 95 %, bootstrap over runs. NEES is over its 12 degrees of freedom.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter
from tyro.conf import arg

from benchmarks.command import Record, Workers, command
from benchmarks.navigation.flights import RIG, SCENARIOS, body_mesh, flight, instants
from benchmarks.navigation.found_poses import drawn_poses, tracked_poses
from benchmarks.navigation.recorded_flights import (
    FILTERS,
    PARTS,
    SETTLED_S,
    UNITS,
    calibrate,
    fly,
    runs_of,
    tune,
)
from benchmarks.presentation import markdown_table, numbers, save_figure, subplots
from benchmarks.record import Case, complete
from polhode.lie import Array
from polhode.planning.edges.edge_model import edge_model

RECORD = Path("runs/records/navigation_filter")
BODY = "satellite"
WRONG = 0.05
"""Share of images on which the fit goes to a wrong pose, or starts far off."""
GATE = 0.999
TRAINING = 1000
"""First seed of the training runs."""
DRAWS = 4000


def main(
    source: Annotated[tuple[Literal["drawn", "tracked"], ...], arg(help="Where the poses come from.")] = (
        "drawn",
        "tracked",
    ),
    scenario: Annotated[tuple[str, ...], arg(help="Of the flight.")] = SCENARIOS,
    body: str = BODY,
    runs: int = 30,
    training: Annotated[int, arg(help="Runs that the filters are tuned on.")] = 6,
    workers: Workers = 1,
    short: Annotated[bool, arg(help="Three runs of the approach, two for training, drawn poses.")] = False,
    plot: Annotated[Path | None, arg(help="PNG of the errors of all runs.")] = None,
    record: Record = RECORD,
) -> None:
    """Measure what the record lacks, print the tables."""
    if short:
        runs, training, source, scenario = 3, 2, ("drawn",), SCENARIOS[:1]
    settings: list[Case] = [
        {"source": one, "scenario": each, "body": body} for one in source for each in scenario
    ]
    poses = [case for setting in settings for case in seeds(setting, runs, training)]
    complete(record, poses, Poses(record.with_suffix(".images")), workers)
    sizes = {"runs": runs, "training": training}
    cases = [
        {**setting, **sizes, "wrong": wrong, "gate": gate}
        for setting in settings
        for wrong, gate in ((0.0, GATE), (WRONG, GATE), (WRONG, 1.0))
    ]
    compared = record.with_name(f"{record.name}_filters")
    lines = complete(compared, cases, FilterComparison(record), workers)
    print(errors_table(lines))
    print(wrong_table(lines))
    print(tuning_table(lines))
    print(calibration_table(lines))
    if plot:
        draw(lines, plot)


def seeds(setting: Case, runs: int, training: int) -> list[Case]:
    """Cases of single runs, for training last."""
    return [{**setting, "seed": seed} for seed in [*range(runs), *range(TRAINING, TRAINING + training)]]


class Poses:
    """The poses of one run: at each instant the usual one and one of a bad start or wrong convergence."""

    def __init__(self, images: Path) -> None:
        self.images = images

    def __call__(self, case: Case) -> dict[str, Any]:
        """Poses by `FoundPose.line`, or None."""

        course = flight(case["scenario"], case["body"], case["seed"])
        model = edge_model(body_mesh(case["body"]))
        if case["source"] == "tracked":
            folder = self.images / case["body"] / case["scenario"] / str(case["seed"])
            usual, bad = tracked_poses(course, case["body"], model, RIG, case["seed"], folder)
        else:
            usual, bad = drawn_poses(course, model, RIG, case["seed"])
        return {
            "poses": [pose and pose.line() for pose in usual],
            "bad": [pose and pose.line() for pose in bad],
        }


class FilterComparison:
    """Tune the filters and fly the test runs: mean squares, NEES and share of poses used, of each run."""

    def __init__(self, record: Path) -> None:
        self.record = record

    def __call__(self, case: Case) -> dict[str, Any]:
        """One setting."""
        setting = {key: case[key] for key in ("source", "scenario", "body")}
        gate = case["gate"] if case["gate"] < 1.0 else None
        cases = seeds(setting, case["runs"], case["training"])
        test, training = cases[: case["runs"]], cases[case["runs"] :]
        calibration, statistics = calibrate(self.record, training)
        tuned = tune(runs_of(self.record, training, case["wrong"], calibration), gate)
        runs = runs_of(self.record, test, case["wrong"], calibration)
        found: dict[str, Any] = {
            "tuning": tuned.numbers,
            "levels": [*calibration.levels.floor_px2, *calibration.levels.slope],
            "doubt": calibration.statistic,
            "told": statistics,
        }
        for name, weighting in tuned.weightings.items():
            flown = [fly(run, weighting, gate) for run in runs]
            found[name] = {
                "squares": [each.squares.tolist() for each in flown],
                "nees": [each.nees for each in flown],
                "taken": [each.taken for each in flown],
            }
            if not name.endswith("residual"):
                late = [np.linalg.norm(each.errors.reshape(-1, 4, 3), axis=2) for each in flown]
                found[name]["rms"] = np.sqrt(np.mean(np.square(late), axis=0)).tolist()
        return found


def ratio(ours: Array, other: Array) -> str:
    """Root mean square of ours over the other's, from mean squares of runs (n,), with its 95 % interval."""
    pick = np.random.default_rng(9).integers(0, len(ours), (DRAWS, len(ours)))
    low, high = np.quantile(np.sqrt(ours[pick].mean(axis=1) / other[pick].mean(axis=1)), [0.025, 0.975])
    return f"{np.sqrt(ours.mean() / other.mean()):.2f} ({low:.2f} to {high:.2f})"


def squares(line: Case, name: str, part: int) -> Array:
    """(n,) mean squares of the runs."""
    return np.array(line[name]["squares"])[:, part]


def errors_table(lines: Iterable[Case]) -> str:
    """Root mean square errors of the three filters, and the calibrated one's over the others'."""
    head = (
        *("poses", "scenario", "bad", "gate", "error"), *FILTERS,
        *("over fixed", "over gated", "better than fixed, gated"),
    )  # fmt: skip
    rows: list[list[object]] = []
    for line in lines:
        name = _name(line["case"])
        for part, (quantity, unit) in enumerate(zip(PARTS, UNITS, strict=True)):
            each = {filter_: squares(line, filter_, part) for filter_ in FILTERS}
            values = numbers((unit * np.sqrt(each[filter_].mean()) for filter_ in FILTERS), ".3g")
            over = [ratio(each["calibrated"], each[other]) for other in FILTERS[:2]]
            won = [int((each["calibrated"] < each[other]).sum()) for other in FILTERS[:2]]
            better = f"{won[0]}, {won[1]} of {len(each['fixed'])}"
            rows.append([*name, quantity, *values, *over, better])
        for what, key, form in (("NEES", "nees", ".2f"), ("poses used", "taken", ".1%")):
            values = numbers((np.mean(line[filter_][key]) for filter_ in FILTERS), form)
            rows.append([*name, what, *values, "", "", ""])
    return markdown_table(head, rows, right_from=5) + "\n"


def wrong_table(lines: list[Case]) -> str:
    """How much larger errors are with wrong poses than without: geometric mean of the four."""
    clean = {_setting(line): line for line in lines if not line["case"]["wrong"]}
    names = [name + suffix for name in FILTERS for suffix in ("", " + residual")]
    rows: list[list[object]] = []
    for line in lines:
        case = line["case"]
        if not case["wrong"]:
            continue
        growth = []
        for name in names:
            plain = name.removesuffix(" + residual")
            parts = [
                squares(line, name, part).mean() / squares(clean[_setting(line)], plain, part).mean()
                for part in range(4)
            ]
            growth.append(np.exp(0.5 * np.mean(np.log(parts))))
        rows.append([case["source"], case["scenario"], _gate(case), *numbers(growth, ".2f")])
    return markdown_table(("poses", "scenario", "gate", *names), rows, right_from=3) + "\n"


def _name(case: Case) -> list[str]:
    return [case["source"], case["scenario"], f"{case['wrong']:.0%}", _gate(case)]


def _gate(case: Case) -> str:
    return "none" if case["gate"] == 1.0 else f"{case['gate']:.1%}"


def _setting(line: Case) -> tuple[str, str]:
    return line["case"]["source"], line["case"]["scenario"]


def tuning_table(lines: list[Case]) -> str:
    """What was chosen on the training runs."""
    rows = [[*_name(line["case"]), *numbers(line["tuning"].values(), ".3g")] for line in lines]
    head = ("poses", "scenario", "wrong", "gate", *lines[0]["tuning"])
    return markdown_table(head, rows, right_from=4) + "\n"


def calibration_table(lines: Iterable[Case]) -> str:
    """Noise levels of the calibrated covariance, and how well statistics detect wrong poses."""
    head = (
        "poses | scenario | floor own, shared, limb [px] | slope | wrong, usual start | wrong, bad start "
        "| area under ROC of statistics"
    )
    rows = []
    for line in lines:
        case, statistics = line["case"], line["told"]
        if case["wrong"]:
            continue
        floor = ", ".join(numbers(np.sqrt(line["levels"][:3]), ".3f"))
        slope = ", ".join(numbers(line["levels"][3:], ".2g"))
        shares = numbers((statistics["usual wrong"], statistics["bad wrong"]), ".1%")
        areas = ", ".join(
            f"{name[6:]} {area:.2f}{' (used)' if name[6:] == line['doubt'] else ''}"
            for name, area in statistics.items()
            if name.startswith("area: ")
        )
        rows.append([case["source"], case["scenario"], floor, slope, *shares, areas])
    return markdown_table(head, rows) + "\n"


COLOURS = {"fixed": "#8a8f94", "gated": "#d58f00", "calibrated": "#33556e"}
WIDTHS = {"fixed": 4.0, "gated": 1.6, "calibrated": 1.6}
SHOWN = (0, 2)
"""Parts of the state: position, attitude."""


def draw(lines: list[Case], path: Path) -> None:
    """A row for each kind of poses and scenario, written to a PNG."""

    gated = [line for line in lines if line["case"]["gate"] < 1.0]
    settings = list(dict.fromkeys(_setting(line) for line in gated))
    size = (11.0, 2.7 * len(settings))
    figure, panels = subplots(len(settings), len(SHOWN), size, layout="constrained", squeeze=False)
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
    save_figure(figure, path, 110)


def _plain(value: float, _: int) -> str:
    """1, 2 and 5 of each power of ten."""
    return f"{value:g}" if f"{value:e}"[0] in "125" else ""


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


if __name__ == "__main__":
    command(main)
