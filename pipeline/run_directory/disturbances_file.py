"""pushes.csv: what unknown forces and torques did, one row for each step that they may act in."""

from pathlib import Path

import numpy as np

from polhode.atomic import write_text
from polhode.records import UnknownPushes

PUSHES_COLUMNS: tuple[str, ...] = (
    "push",
    "start_ns",
    "end_ns",
    *(f"{prefix}{name}_{axis}" for name in ("accel_N", "angular_accel_P") for prefix in ("", "sigma_")
      for axis in "xyz"),
)  # fmt: skip
"""The header line. Mean accelerations over the step [m/s^2, rad/s^2]; steps of one push share its number."""


def write_pushes(pushes: UnknownPushes, path: Path) -> None:
    """Write the table; a sigma that is undetermined is ``inf``."""
    first = np.array([push.start_ns for push in pushes.pushes])
    number = np.searchsorted(first, pushes.start_ns, side="right")
    values = np.hstack(
        [pushes.accel_N, pushes.sigma_accel_N, pushes.angular_accel_P, pushes.sigma_angular_accel_P]
    )
    lines = [",".join(PUSHES_COLUMNS)]
    for k, row in enumerate(values.tolist()):
        stamps = (int(number[k]), int(pushes.start_ns[k]), int(pushes.end_ns[k]))
        lines.append(",".join([*map(str, stamps), *map(repr, row)]))
    write_text(path, "\n".join(lines) + "\n")
