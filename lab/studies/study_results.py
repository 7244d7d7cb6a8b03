"""The results of a study as the tables of findings read them: points, settings, errors."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from lab.presentation import Row, markdown_table
from polhode.config import Config
from polhode.geometry.lie import Array, Bools
from polhode.studies.page.columns import numbers, texts
from polhode.studies.steps import DONE
from polhode.studies.study import OpenStudy, open_study
from polhode.studies.table import STUDY, read_table


@dataclass(frozen=True)
class Part:
    """A table of findings."""

    title: str
    columns: str
    """Names, with bars between them"""
    rows: Sequence[Row] = ()
    right_from: int = 1
    """From which column on numbers are aligned to the right"""

    @property
    def table(self) -> str:
        """As Markdown."""
        return markdown_table(self.columns, self.rows or ["none"], self.right_from)


@dataclass(frozen=True)
class Error:
    """A result that is better when it is small."""

    title: str
    column: str
    factor: float = 1.0


ATTITUDE = Error("attitude [deg]", "evaluate.attitude_error_deg.median")
RATE = Error("rate [deg/s]", "evaluate.rmse_angular_velocity_deg_s")
POSITION = Error("position [mm]", "evaluate.rmse_position_m", 1e3)
SURFACE = Error("surface [mm]", "evaluate.mesh.accuracy_mm")
COMPLETION = Error("truth to surface [mm]", "evaluate.mesh.completion_mm")
K1, K2 = Error("k1", "evaluate.error_k1"), Error("k2", "evaluate.error_k2")
AXES = Error("principal axes [deg]", "evaluate.principal_axes_error_deg")
COM = Error("centre of mass [mm]", "evaluate.error_com_mm")


def prediction(seconds: int) -> Error:
    """Attitude so many seconds after the last pair."""
    return Error(f"prediction, {seconds} s [deg]", f"evaluate.prediction_error_deg.{seconds}")


@dataclass(frozen=True)
class Results:
    """A study with the table of its points."""

    study: OpenStudy
    table: pa.Table

    @property
    def title(self) -> str:
        """Of the study."""
        return self.study.settings.title

    @cached_property
    def settings(self) -> pd.DataFrame:
        """The columns of all that was varied, seeds among them."""
        return self.table.select(list(self.study.columns)).to_pandas()

    @cached_property
    def configurations(self) -> list[Config]:
        """Of every point."""
        return [self.study.config(self.study.point(k)) for k in self.table.column("point").to_pylist()]

    @cached_property
    def done(self) -> Bools:
        """(n,) whether a point has an answer."""
        return np.array([each == DONE for each in texts(self.table, "status")], bool)

    @cached_property
    def ok(self) -> Bools:
        """(n,) whether the run of a point is ok."""
        return np.asarray(self.verdict == "ok")

    @cached_property
    def verdict(self) -> "np.ndarray[Any, np.dtype[Any]]":
        """(n,) of the run, or "none"."""
        return np.array([each or "none" for each in texts(self.table, "verdict")])

    def column(self, name: str) -> Array:
        """A column of numbers or truths (n,); NaN where it is empty or not there."""
        return numbers(self.table, name)

    def errors(self, error: Error) -> Array:
        """(n,) without signs; NaN where a point has none."""
        return np.asarray(error.factor * np.abs(self.column(error.column)))

    def by_level(self, name: str) -> Mapping[str, Bools]:
        """The points of each level of a setting, in their order."""
        names = [f"{each:.4g}" if isinstance(each, float) else str(each) for each in self.settings[name]]
        return {level: np.array([each == level for each in names]) for level in dict.fromkeys(names)}

    def of_scenes(self, value: Any) -> Array:
        """(n,) a number of every scene, by a function of it."""
        scenes = [each.scene for each in self.configurations]
        return np.array([float(value(scene)) if scene else np.nan for scene in scenes])

    @cached_property
    def rate_deg_s(self) -> Array:
        """(n,) at the beginning."""
        return self.of_scenes(lambda scene: 6.0 * np.linalg.norm(scene.motion.spin_rpm))


def read_results(folder: Path) -> Results:
    """The results in the folder of a study. Raises InputError."""
    return Results(open_study(folder / STUDY, check=False), read_table(folder))
