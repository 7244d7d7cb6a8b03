"""Reading the curves of a training."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from polhode.train.training_loop import CURVES


def read_curves(output: Path) -> dict[str, NDArray[np.float64]]:
    """Name -> (n, 2) steps and values."""
    events = EventAccumulator(str(output / CURVES), size_guidance={"scalars": 0})
    events.Reload()
    names = events.Tags()["scalars"]
    return {name: np.array([(point.step, point.value) for point in events.Scalars(name)]) for name in names}
