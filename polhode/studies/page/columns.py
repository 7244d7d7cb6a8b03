"""The columns of a study's table as numbers: what was varied, and which results the page draws."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import PurePath

import numpy as np
import pyarrow as pa

from polhode.geometry.lie import Array
from polhode.studies.study import DATA, OpenStudy
from polhode.studies.table import RESULTS, TIME

MAIN = (
    "evaluate.attitude_error_deg.median",
    "evaluate.rmse_position_m",
    "evaluate.rmse_angular_velocity_deg_s",
    "evaluate.error_com_mm",
    "evaluate.error_k1",
    "evaluate.error_k2",
    "evaluate.prediction_error_deg.*",
    "evaluate.mesh.accuracy_mm",
    "evaluate.mesh.completeness_3mm",
    "plan.keepout.volume_m3",
    "plan.*",
    "compare.*.errors.*",
    "compare.*.cost",
    "time.compare.*",
    "time.run.total_s",
)
"""Columns that are drawn, in this order, where the study names none itself"""


@dataclass(frozen=True)
class Axis:
    """What was varied, as numbers or as positions of labels."""

    name: str
    values: Array
    """(n,) of each row; of labels, their positions from 0"""
    labels: tuple[str, ...] = ()
    """Of the positions; empty: the values are numbers"""
    is_logarithmic: bool = False
    """Whether its numbers are drawn on a logarithmic scale"""


@dataclass(frozen=True)
class Metric:
    """A result of the points."""

    column: str
    values: Array
    """(n,); NaN where a point has none"""
    absolute: bool = False
    """Whether the sign was taken away"""

    @property
    def title(self) -> str:
        """Its name on the page: that of the column, without a sign if it was taken away."""
        return f"|{self.column}|" if self.absolute else self.column

    @property
    def known(self) -> Array:
        """The finite values."""
        return np.asarray(self.values[np.isfinite(self.values)])

    @property
    def is_logarithmic(self) -> bool:
        """Whether it is drawn on a logarithmic scale."""
        return spans_decades(self.known)

    @property
    def more_is_better(self) -> bool:
        """Whether a large value is a good one."""
        large = ("*completeness*", "*coverage*", "*.within_*", "*frames_used", "*landmarks", "*observations")
        return any(fnmatchcase(self.column, pattern) for pattern in large)


def spans_decades(values: Array) -> bool:
    """Whether values (n,) are all positive and of very different sizes."""
    # a factor of 30 is drawn better on a logarithmic scale
    return len(values) > 0 and bool(values.min() > 0.0 and values.max() > 30.0 * values.min())


def numbers(table: pa.Table, name: str) -> Array:
    """A column of numbers or truths (n,); NaN where it is empty, or not there."""
    if name not in table.column_names:
        return np.full(table.num_rows, math.nan)
    column = table.column(name).cast(pa.float64())
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def texts(table: pa.Table, name: str) -> list[str | None]:
    """A column of texts; None where it is empty."""
    return list(table.column(name).to_pylist()) if name in table.column_names else [None] * table.num_rows


def is_seed(name: str) -> bool:
    """Whether a setting only repeats the points with other random numbers."""
    return name.rpartition(".")[2] == "seed"


def axes_of(study: OpenStudy, table: pa.Table) -> list[Axis]:
    """What was varied and has several values, in the order of the study. Seeds are no axes."""
    settings = study.settings
    by_ratio = {name for name, axis in settings.axes.items() if axis.log_range or axis.log_uniform}
    if settings.design is not None:
        by_ratio |= {name for name, each in settings.design.settings.items() if each.log_uniform}
    found = []
    for name in study.columns:
        if is_seed(name) or name not in table.column_names:
            continue
        if _is_number(table.schema.field(name).type):
            values = numbers(table, name)
            if np.ptp(values) > 0.0:
                found.append(Axis(name, values, (), name in by_ratio or spans_decades(values)))
            continue
        said = [_label(name, each) for each in table.column(name).to_pylist()]
        labels = list(dict.fromkeys(said))
        if len(labels) > 1:
            positions = np.array([labels.index(each) for each in said], dtype=np.float64)
            found.append(Axis(name, positions, tuple(labels)))
    return found


def _label(name: str, value: object) -> str:
    text = PurePath(str(value)).name if name == DATA else str(value)
    text = text.lower() if isinstance(value, bool) else text
    return text if len(text) <= 26 else f"{text[:25]}…"


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind))


def metrics_of(table: pa.Table) -> list[Metric]:
    """All results that are numbers and differ between points."""
    names = [column.name for column in table.schema if _is_number(column.type)]
    found = [metric_of(table, name) for name in names if name.startswith((*RESULTS, TIME))]
    return [each for each in found if len(each.known) and np.ptp(each.known) > 0.0]


def metric_of(table: pa.Table, column: str) -> Metric:
    """A result by the name of its column; of errors with a sign, their size."""
    values, is_signed = numbers(table, column), column in ("evaluate.error_k1", "evaluate.error_k2")
    return Metric(column, np.abs(values) if is_signed else values, absolute=is_signed)


def choose_metrics(metrics: Sequence[Metric], wanted: Sequence[str], most: int) -> list[Metric]:
    """Those that are drawn, at most so many: those that the study names, else the main ones, else any."""
    patterns = wanted or MAIN
    found = [each for pattern in patterns for each in metrics if fnmatchcase(each.column, pattern)]
    return list({each.column: each for each in found or metrics}.values())[:most]


def without_numbers(text: str) -> str:
    """A reason without its numbers, by which reasons are grouped."""
    return re.sub(r"\d+(?:[.,]\d+)*", "#", text)
