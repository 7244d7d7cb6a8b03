"""Training curves in TensorBoard's format, which ``tensorboard --logdir OUTPUT`` shows.

    python -m polhode.train.curves OUTPUT... -o FILE.png

plots them from the event files.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from polhode.drawing_style import default_style
from polhode.errors import InputError
from polhode.lie import Array
from polhode.optional_parts import missing_message

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


@default_style
def draw_curves(outputs: Sequence[Path], path: Path) -> None:
    """One row of plots for each training: the losses, and the scores on held-out bodies."""
    figure = Figure(figsize=(12, 4.0 * len(outputs)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(outputs), 2, squeeze=False)
    for row, output in zip(axes, outputs, strict=True):
        curves = read_curves(output)
        losses = {
            name: curve
            for name, curve in curves.items()
            if name.startswith("train/") and name not in ("train/gradient", "train/learning_rate")
        }
        _draw(row[0], losses, smooth=15)
        _draw(row[1], {name: curve for name, curve in curves.items() if name.startswith("validation/")})
        row[0].set_title(f"{output.name}: training, means over 15 points")
        row[1].set_title("held-out bodies")
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
    options = parser.parse_args(arguments)
    try:
        draw_curves(options.outputs, options.picture)
    except InputError as error:
        parser.error(str(error))
    print(options.picture)


if __name__ == "__main__":
    main()
