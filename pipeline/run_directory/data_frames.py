"""What a run holds as tables: named columns of equal length, for pandas and for whatever reads columns.

Units and frames are those of docs/run_directory.md; a quantity that is undetermined has a sigma of ``inf``.
"""

from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from polhode.errors import InputError
from polhode.pipeline.run_directory.archives import REMEDY, read_measurements, read_residuals
from polhode.pipeline.run_directory.point_cloud_file import read_landmarks
from polhode.pipeline.run_directory.summary_schema import Summary
from polhode.pipeline.run_directory.trajectory_file import TRAJECTORY_COLUMNS, read_trajectory
from polhode.records import Ints

TableName = Literal["trajectory", "online", "landmarks", "observations", "checks"]
"""trajectory, online: a row for each pair, the columns of trajectory.csv. landmarks: a row for each landmark,
its position in G [m]. observations: a row for each measurement, with its residual; the column ``landmark``
joins it with the landmarks. checks: a row for each check of the verdict."""
Columns = dict[str, NDArray[Any] | Sequence[Any]]
UVD = ("u_px", "v_px", "disparity_px")


def columns_of(table: TableName, folder: Path, summary: Summary) -> Columns:
    """The columns of a table of a run.

    Raises:
        InputError: there is no table of this name, or the run has no such file.
    """
    if table == "trajectory":
        return _states(folder / "trajectory.csv")
    if table == "online":
        return _states(folder / "trajectory_online.csv")
    if table == "landmarks":
        return _landmarks(folder)
    if table == "observations":
        return _observations(folder)
    if table == "checks":
        return _checks(folder, summary)
    raise InputError(f"there is no table '{table}'; there are {', '.join(get_args(TableName))}")


def _states(file: Path) -> Columns:
    found = read_trajectory(file)
    arrays = [getattr(found, field.name) for field in fields(found) if field.name != "timestamps_ns"]
    names, values = TRAJECTORY_COLUMNS[1:], np.hstack(arrays)
    return {"timestamp_ns": found.timestamps_ns, **dict(zip(names, values.T, strict=True))}


def _landmarks(folder: Path) -> Columns:
    found, numbers = read_landmarks(folder), kept_landmarks(folder)
    position = dict(zip("xyz", found.p_G.T, strict=True))
    return {"landmark": numbers, **position, "sigma_m": found.sigma_m, "observations": found.observations}


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


def _observations(folder: Path) -> Columns:
    tracks, residuals = read_measurements(folder), read_residuals(folder)
    columns: Columns = {
        "timestamp_ns": tracks.timestamps_ns[tracks.frame],
        "frame": tracks.frame,
        "landmark": tracks.landmark,
    }
    groups = {"": tracks.uvd_px, "sigma_": tracks.sigma_px}
    if residuals is not None:
        groups["residual_"] = residuals.residuals_px
    for prefix, values in groups.items():
        columns |= {f"{prefix}{name}": values[:, i] for i, name in enumerate(UVD)}
    if residuals is not None:
        columns["inlier_weight"] = residuals.inlier_weight
    return columns


def _checks(folder: Path, summary: Summary) -> Columns:
    if summary.verdict is None:
        raise InputError(f"{folder}: this run is of a version without a verdict; {REMEDY}")
    checks = summary.verdict.checks
    return {
        "name": [check.name for check in checks],
        "value": _numbers(check.value for check in checks),
        "lowest": _numbers(check.expected[0] for check in checks),
        "highest": _numbers(check.expected[1] for check in checks),
        "holds": [check.holds for check in checks],
    }


def _numbers(values: Iterable[float | None]) -> NDArray[np.float64]:
    """NaN where there is none."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
