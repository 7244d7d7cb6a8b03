"""The columns of a study's table as numbers: what was varied, and which results the page draws."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import PurePath

import numpy as np
import pyarrow as pa

from polhode.config.study_settings import Study
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
SIGNED = ("evaluate.error_k1", "evaluate.error_k2")
"""Errors with a sign: the page shows how large they are"""
MORE_IS_BETTER = ("*completeness*", "*coverage*", "*.within_*", "*frames_used", "*landmarks", "*observations")
MAX_LABEL = 26


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
        return any(fnmatchcase(self.column, pattern) for pattern in MORE_IS_BETTER)


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


def axes_of(study: OpenStudy, table: pa.Table) -> list[Axis]:
    """What was varied, in the order of the study. Seeds are repetitions, and no axes."""
    by_ratio = _drawn_by_ratio(study.settings)
    found = [_axis(table, name, name in by_ratio) for name in study.columns if not is_seed(name)]
    return [axis for axis in found if axis is not None]


def _drawn_by_ratio(settings: Study) -> set[str]:
    """Names of axes whose values were chosen by their ratios."""
    names = {name for name, axis in settings.axes.items() if axis.log_range or axis.log_uniform}
    if settings.design is not None:
        names |= {name for name, each in settings.design.settings.items() if each.log_uniform}
    return names


def is_seed(name: str) -> bool:
    """Whether a setting only repeats the points with other random numbers."""
    return name.rpartition(".")[2] == "seed"


def _axis(table: pa.Table, name: str, by_ratio: bool) -> Axis | None:
    """An axis; None: it has one value only, or is not in the table."""
    if name not in table.column_names:
        return None
    kind = table.schema.field(name).type
    if pa.types.is_floating(kind) or pa.types.is_integer(kind):
        values = numbers(table, name)
        is_logarithmic = by_ratio or spans_decades(values)
        return Axis(name, values, is_logarithmic=is_logarithmic) if np.ptp(values) > 0.0 else None
    said = [_label(name, each) for each in table.column(name).to_pylist()]
    labels = list(dict.fromkeys(said))
    if len(labels) < 2:
        return None
    position = {label: k for k, label in enumerate(labels)}
    return Axis(name, np.array([position[each] for each in said], dtype=np.float64), tuple(labels))


def _label(name: str, value: object) -> str:
    text = PurePath(str(value)).name if name == DATA else str(value)
    text = text.lower() if isinstance(value, bool) else text
    return text if len(text) <= MAX_LABEL else f"{text[: MAX_LABEL - 1]}…"


def metrics_of(table: pa.Table) -> list[Metric]:
    """All results that are numbers and differ between points."""
    found = []
    for column in table.schema:
        is_number = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
        if not is_number or not column.name.startswith((*RESULTS, TIME)):
            continue
        metric = metric_of(table, column.name)
        if len(metric.known) and np.ptp(metric.known) > 0.0:
            found.append(metric)
    return found


def metric_of(table: pa.Table, column: str) -> Metric:
    """A result by the name of its column."""
    values = numbers(table, column)
    if column in SIGNED:
        return Metric(column, np.abs(values), absolute=True)
    return Metric(column, values)


def choose_metrics(metrics: Sequence[Metric], wanted: Sequence[str], most: int) -> list[Metric]:
    """Those that are drawn, at most so many: those that the study names, else the main ones, else any."""
    patterns = wanted or MAIN
    found = [each for pattern in patterns for each in metrics if fnmatchcase(each.column, pattern)]
    return list({each.column: each for each in found or metrics}.values())[:most]


def without_numbers(text: str) -> str:
    """A reason without its numbers, by which reasons are grouped."""
    return re.sub(r"\d+(?:[.,]\d+)*", "#", text)
