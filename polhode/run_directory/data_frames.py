"""What a run holds as tables: named columns of equal length, for pandas and for whatever reads columns.

Units and frames are those of docs/run_directory.md; a quantity that is undetermined has a sigma of ``inf``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polhode.geometry.lie import Ints
from polhode.run_directory.archives import REMEDY, read_measurements, read_residuals
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import TRAJECTORY_COLUMNS, read_trajectory
from polhode.runtime.errors import InputError

TableName = Literal["trajectory", "online", "landmarks", "observations", "checks"]
"""trajectory, online: a row for each pair, the columns of trajectory.csv. landmarks: a row for each landmark,
its position in G [m]. observations: a row for each measurement, with its residual; the column ``landmark``
joins it with the landmarks. checks: a row for each check of the verdict."""
Columns = dict[str, NDArray[Any] | Sequence[Any]]


def columns_of(table: TableName, folder: Path, summary: Summary) -> Columns:
    """The columns of a table of a run.

    Raises:
        InputError: there is no table of this name, or the run has no such file.
    """
    if table in ("trajectory", "online"):
        file = "trajectory.csv" if table == "trajectory" else "trajectory_online.csv"
        found = read_trajectory(folder / file)
        values = np.hstack([array for name, array in vars(found).items() if name != "timestamps_ns"])
        names = TRAJECTORY_COLUMNS[1:]
        return {"timestamp_ns": found.timestamps_ns, **dict(zip(names, values.T, strict=True))}
    if table == "landmarks":
        landmarks = read_landmarks(folder)
        return {
            "landmark": kept_landmarks(folder),
            **dict(zip("xyz", landmarks.p_G.T, strict=True)),
            "sigma_m": landmarks.sigma_m,
            "observations": landmarks.observations,
        }
    if table == "observations":
        tracks, residuals = read_measurements(folder), read_residuals(folder)
        stamps = tracks.timestamps_ns[tracks.frame]
        columns: Columns = {"timestamp_ns": stamps, "frame": tracks.frame, "landmark": tracks.landmark}
        groups = {"": tracks.uvd_px, "sigma_": tracks.sigma_px}
        groups |= {} if residuals is None else {"residual_": residuals.residuals_px}
        for prefix, values in groups.items():
            for name, column in zip(("u_px", "v_px", "disparity_px"), values.T, strict=True):
                columns[f"{prefix}{name}"] = column
        return columns if residuals is None else {**columns, "inlier_weight": residuals.inlier_weight}
    if table == "checks":
        if summary.verdict is None:
            raise InputError(f"{folder}: this run is of a version without a verdict; {REMEDY}")
        checks = summary.verdict.checks
        # None becomes NaN
        numbers = np.array([[check.value, *check.expected] for check in checks], np.float64).reshape(-1, 3)
        return {
            "name": [check.name for check in checks],
            **dict(zip(("value", "lowest", "highest"), numbers.T, strict=True)),
            "holds": [check.holds for check in checks],
        }
    raise InputError(f"there is no table '{table}'; there are {', '.join(get_args(TableName))}")


def kept_landmarks(folder: Path) -> Ints:
    """(L,) the number that each landmark of landmarks.ply has in measurements.npz, ascending.

    A landmark of whose observations all are outliers is not in the map.

    Raises:
        InputError: the run has no estimate, or another map than the one that it wrote.
    """
    tracks, residuals = read_measurements(folder), read_residuals(folder)
    count = len(read_landmarks(folder).p_G)
    if residuals is None:
        raise InputError(f"{folder}: this run failed before it had an estimate")
    kept = np.unique(tracks.landmark[residuals.inlier_weight > 0.0])
    if len(kept) != count:
        raise InputError(
            f"{folder / 'landmarks.ply'} has {count} points, but {len(kept)} landmarks of measurements.npz "
            f"were kept: it is not the map of this run; {REMEDY}"
        )
    return kept
