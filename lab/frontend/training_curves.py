"""Losses, and scores on held-out bodies, over the steps of trainings that continue one another.

    python -m lab.frontend.training_curves OUTPUT ... -o PNG

OUTPUT: folders of ``polhode train`` in their order.
"""

import numpy as np
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from lab.command import Png, Runs, command
from lab.presentation import save_figure, subplots
from polhode.train.training_loop import CURVES

LEFT_OUT = ("train/gradient", "train/learning_rate")


def main(outputs: Runs, picture: Png = None) -> None:
    """Draw the figure, or print the last value of each curve."""
    curves: dict[str, list[tuple[float, float]]] = {}
    ends = [0.0]
    for output in outputs:
        events = EventAccumulator(str(output / CURVES), size_guidance={"scalars": 0})
        events.Reload()
        for name in events.Tags()["scalars"]:
            points = [(ends[-1] + point.step, point.value) for point in events.Scalars(name)]
            curves.setdefault(name, []).extend(points)
        ends.append(max(points[-1][0] for points in curves.values()))
    if picture is None:
        for name, points in sorted(curves.items()):
            print(f"{name:32} {points[-1][1]:.4g}")
        return
    figure, axes = subplots(1, 2, (12, 4), layout="constrained")
    for own, group, width in zip(axes, ("train", "validation"), (15, 1), strict=True):
        named = {name: points for name, points in sorted(curves.items()) if name.startswith(group)}
        for name, points in named.items():
            step, value = np.array(points).T
            number = min(width, len(value))
            smooth = np.convolve(value, np.ones(number) / number, mode="valid")
            if name not in LEFT_OUT:
                own.plot(step[number - 1 :], smooth, label=name.partition("/")[2])
        for end in ends[1:-1]:
            own.axvline(end, color="grey", linewidth=0.8, linestyle=":")
        own.set(title=f"{group}, means over {width} points", xlabel="step")
        own.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, picture, 110)


if __name__ == "__main__":
    command(main)
