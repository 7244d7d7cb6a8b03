"""Training curves in TensorBoard's format, which ``tensorboard --logdir OUTPUT`` shows.

    python -m polhode.train.curves OUTPUT... -o FILE.png [--parts] [--only NAME ...]

plots them from the event files; with ``--parts`` the trainings continue one another, and their steps are
counted on.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from polhode.geometry.lie import Array
from polhode.runtime.drawing_style import default_style
from polhode.runtime.errors import InputError
from polhode.runtime.optional_parts import missing_message

FOLDER = "curves"


class Curves:
    """Writes scalars; points after ``first_step`` from an interrupted training are dropped."""

    def __init__(self, output: Path, first_step: int) -> None:
        try:
            from torch.utils.tensorboard.writer import SummaryWriter
        except ImportError:
            raise InputError(f"{missing_message('tensorboard')}, which reads and writes the curves") from None
        _wait_for_a_later_second(output / FOLDER)
        self._writer = SummaryWriter(str(output / FOLDER), purge_step=first_step + 1, flush_secs=20)

    def add(self, step: int, groups: Mapping[str, Mapping[str, float]]) -> None:
        """Points of the curves ``group/name`` at a step."""
        for group, values in groups.items():
            for name, value in values.items():
                self._writer.add_scalar(f"{group}/{name}", value, step)

    def close(self) -> None:
        """Write all remaining points."""
        self._writer.close()


def _wait_for_a_later_second(folder: Path) -> None:
    """Names of event files begin with the second and are read in their order: two of one second may change
    places."""
    seconds = [int(file.name.split(".")[3]) for file in folder.glob("events.out.tfevents.*")]
    while seconds and time.time() < max(seconds) + 1 <= time.time() + 1.0:
        time.sleep(0.05)


def read_curves(output: Path) -> dict[str, Array]:
    """Curves of a training: name -> (n, 2) steps and values. Raises InputError: there are none."""
    try:
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    except ImportError:
        raise InputError(f"{missing_message('tensorboard')}, which reads and writes the curves") from None
    events = EventAccumulator(str(output / FOLDER), size_guidance={"scalars": 0})
    events.Reload()
    names = events.Tags().get("scalars", [])
    if not names:
        raise InputError(f"{output} contains no curves: give the folder of a training")
    return {name: np.array([(point.step, point.value) for point in events.Scalars(name)]) for name in names}


@dataclass(frozen=True)
class Row:
    """Curves of one training, or of several that continue one another."""

    title: str
    curves: Mapping[str, Array]
    """Name -> (n, 2) steps and values"""
    joints: tuple[float, ...] = ()
    """Steps at which a training ended and the next one began"""


def joined(outputs: Sequence[Path]) -> Row:
    """The curves of trainings that continue one another, with their steps counted on.

    Raises InputError: a training has no curves.
    """
    parts: dict[str, list[Array]] = {}
    ends = [0.0]
    for output in outputs:
        curves = read_curves(output)
        for name, curve in curves.items():
            parts.setdefault(name, []).append(curve + np.array([ends[-1], 0.0]))
        ends.append(ends[-1] + max(curve[-1, 0] for curve in curves.values()))
    curves = {name: np.concatenate(those) for name, those in parts.items()}
    title = f"{outputs[0].name} to {outputs[-1].name}" if len(outputs) > 1 else outputs[0].name
    return Row(title, curves, tuple(ends[1:-1]))


@default_style
def draw_curves(rows: Sequence[Row], path: Path, only: Sequence[str] = ()) -> None:
    """One row of plots for each training: the losses, and the scores on held-out bodies.

    only: names that are drawn, all if there are none.
    """
    figure = Figure(figsize=(12, 4.0 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), 2, squeeze=False)
    for own, row in zip(axes, rows, strict=True):
        curves = {
            name: curve for name, curve in row.curves.items() if not only or name.partition("/")[2] in only
        }
        losses = {
            name: curve
            for name, curve in curves.items()
            if name.startswith("train/") and name not in ("train/gradient", "train/learning_rate")
        }
        _draw(own[0], losses, smooth=15)
        _draw(own[1], {name: curve for name, curve in curves.items() if name.startswith("validation/")})
        own[0].set_title(f"{row.title}: training, means over 15 points")
        own[1].set_title("held-out bodies")
        for each in own:
            for step in row.joints:
                each.axvline(step, color="grey", linewidth=0.8, linestyle=":")
    figure.savefig(path, dpi=110)


def _draw(axes: Axes, curves: Mapping[str, Array], smooth: int = 1) -> None:
    for number, (name, curve) in enumerate(sorted(curves.items())):
        width = min(smooth, len(curve))
        value = np.convolve(curve[:, 1], np.ones(width) / width, mode="valid")
        style = ("-", "--", ":")[number // 10 % 3]
        axes.plot(curve[width - 1 :, 0], value, style, label=name.partition("/")[2])
    axes.set_xlabel("step")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))


def main(arguments: Sequence[str] | None = None) -> None:
    """Plot training curves."""
    parser = argparse.ArgumentParser(prog="python -m polhode.train.curves", description=main.__doc__)
    parser.add_argument("outputs", type=Path, nargs="+", metavar="OUTPUT")
    parser.add_argument("-o", "--picture", type=Path, required=True)
    parser.add_argument(
        "--parts", action="store_true", help="one row: each training continues the one before"
    )
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="losses and scores to draw")
    options = parser.parse_args(arguments)
    try:
        outputs = [options.outputs] if options.parts else [[each] for each in options.outputs]
        rows = [joined(each) for each in outputs]
        if unknown := set(options.only) - {name.partition("/")[2] for row in rows for name in row.curves}:
            raise InputError(f"--only: no curve is called {', '.join(sorted(unknown))}")
        draw_curves(rows, options.picture, options.only)
    except InputError as error:
        parser.error(str(error))
    print(options.picture)


if __name__ == "__main__":
    main()
