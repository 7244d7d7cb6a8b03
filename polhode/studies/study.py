"""A study as it is computed: base, factors, points by their numbers, and the address of each.

A point is a mixed-radix number: the first axis of the file changes slowest, the design fastest. So a point is
made when it is needed, and a million of them take no memory.
"""

import hashlib
import json
import math
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import yaml

from polhode.config import Config
from polhode.config.loader import config_with, load_config, plain_settings, read_settings, validated
from polhode.config.study_settings import MAX_POINTS, PlanOptions, Study
from polhode.files.yaml_files import read_yaml
from polhode.runtime.errors import InputError
from polhode.runtime.program_digest import code_digest
from polhode.studies.factors import (
    Changes,
    Factor,
    factor_of_axis,
    factor_of_design,
    factor_of_points,
    flat,
)

RECORD = "polhode-study-point/1"
"""Of the records, and part of every address: another one computes all points again"""
DATA, PLAN = "data", "plan"
"""Settings of a study beside those of the configuration"""
MESH = "scene.body.path"
"""The setting that names the mesh of a body"""


@dataclass(frozen=True)
class Point:
    """One point of a study."""

    number: int
    values: dict[str, Any]
    """Of the table: axis -> value"""
    changes: Changes
    """Dotted setting -> value, laid over the base"""
    address: str
    """SHA-256 of all that decides the result: settings, steps, data, code"""


@dataclass(frozen=True)
class OpenStudy:
    """A study with its base read and its axes drawn."""

    settings: Study
    base: dict[str, Any]
    """Sections with every setting of the base, as in a file"""
    factors: tuple[Factor, ...]
    source: str
    """The file, for messages"""

    @cached_property
    def count(self) -> int:
        """Points."""
        return math.prod(len(factor) for factor in self.factors)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Of the table, by the axes and the design."""
        return tuple(name for factor in self.factors for name in factor.columns)

    @cached_property
    def sequences(self) -> int:
        """Sequences that the points use, each simulated once; 0: none is simulated."""
        if "simulate" not in self.settings.steps:
            return 0
        changing = [f for f in self.factors if {"scene", "seed"} & {_section(s) for s in f.settings}]
        return math.prod(len(factor) for factor in changing)

    def point(self, number: int) -> Point:
        """The point with this number, 0 <= number < count."""
        values: dict[str, Any] = {}
        changes: Changes = {}
        rest = number
        for factor in reversed(self.factors):
            rest, level = divmod(rest, len(factor))
            values = dict(zip(factor.columns, factor.values[level], strict=True)) | values
            changes |= factor.changes[level]
        return Point(number, values, changes, self.address_of(changes))

    def config(self, point: Point) -> Config:
        """The configuration of a point: one process, one thread, nothing kept for a resumption.

        Raises InputError: its settings contradict each other.
        """
        changes = _of_configuration(point.changes)
        return config_with(self.base, f"{self.source}: base", changes, f"{self.source}: axes")

    def plan_options(self, point: Point) -> PlanOptions:
        """Of the step ``plan``. Raises InputError."""
        own = self.settings.plan.model_dump()
        own |= {key.partition(".")[2]: each for key, each in point.changes.items() if _section(key) == PLAN}
        return validated(PlanOptions, own, f"{self.source}: axes")

    def data(self, point: Point) -> Path | None:
        """The sequence that a point reads; None: it simulates its own, or needs none."""
        found = point.changes.get(DATA, self.settings.data)
        return None if found is None else Path(found)

    def address_of(self, changes: Changes) -> str:
        """Of the point with these settings: of them, what all points have in common, the files that the
        changes name, and the sequence."""
        data = changes.get(DATA, self.settings.data)
        inputs = [file_digest(each) for each in texts_in(_of_configuration(changes))]
        inputs.append("" if data is None else sequence_digest(str(data)))
        content = json.dumps([self._common, changes, inputs], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    @cached_property
    def _common(self) -> str:
        """Digest of what all points have in common."""
        base = {key: value for key, value in self.base.items() if key != "runtime"}
        own = self.settings.model_dump(include={"steps", "plan", "keep", "data"})
        files = [file_digest(each) for each in texts_in(base)]
        content = json.dumps([RECORD, base, own, files, code_digest()], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    def inputs(self) -> list[Path]:
        """Files and folders that any point reads, but for those of the installation."""
        named = [self.settings.data, setting_of(self.base, MESH)]
        for factor in self.factors:
            named += [changes[key] for changes in factor.changes for key in (DATA, MESH) if key in changes]
        return sorted({Path(each) for each in named if each is not None})

    def check(self) -> None:
        """Try every value of every axis, each with the first ones of the others. Raises InputError for one
        that is out of range."""
        for factor in self.factors or (Factor((), ((),), ({},)),):
            others: Changes = {}
            for other in self.factors:
                others |= {} if other is factor else other.changes[0]
            for level in factor.extremes():
                point = Point(0, {}, others | factor.changes[level], "")
                self.config(point)
                self.plan_options(point)

    def text(self) -> str:
        """The study with its base and its variants written out: the same points, from any folder."""
        content = json.loads(self.settings.model_dump_json(exclude_none=True))
        content |= {"base": self.base}
        header = "# A study, with its base written out.\n"
        return header + yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=1000)


@cache
def file_digest(path: str) -> str:
    """SHA-256 of the content of the file that a setting names; empty: it names none."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest() if Path(path).is_file() else ""
    except (OSError, ValueError):
        return ""


def texts_in(values: Any) -> list[str]:
    """All texts within sections and lists."""
    if isinstance(values, str):
        return [values]
    if isinstance(values, dict):
        values = list(values.values())
    return [text for each in values for text in texts_in(each)] if isinstance(values, list) else []


@cache
def sequence_digest(folder: str) -> str:
    """SHA-256 of a sequence on disk: its tables and calibrations, and the names and sizes of its images."""
    digest = hashlib.sha256()
    mav0 = Path(folder) / "mav0"
    for file in sorted(path for path in mav0.rglob("*") if path.is_file()):
        digest.update(f"{file.relative_to(mav0)} {file.stat().st_size};".encode())
        if file.suffix in (".csv", ".yaml"):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def setting_of(values: Any, setting: str) -> Any:
    """A setting by its dotted key; None: there is none."""
    for step in setting.split("."):
        values = values.get(step) if isinstance(values, dict) else None
    return values


def open_study(path: Path, check: bool = True) -> OpenStudy:
    """Read a study. Raises InputError, one line, for whatever is wrong with it: an unknown key or setting, an
    empty range, more than ``MAX_POINTS`` points, a value out of range. ``check``: whether
    all values are tried."""
    content = read_yaml(path, f"{path} is missing: give an existing study")
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected keys such as 'base:' and 'axes:' at the top")
    settings = validated(Study, content, str(path))
    _require_few(settings, path)
    settings = _with_paths(settings, path)
    base = plain_settings(_base(settings.base, path))
    if (body := setting_of(base, "scene.body")) and body["path"] is not None:
        body["path"] = str(Path(body["path"]).resolve())
    base["runtime"] |= {"workers": 1, "blas_threads": 1, "stages": "none"}
    if settings.keep != "whole" and "run" in settings.steps:
        # which nobody would see
        base["outputs"] = [each for each in base["outputs"] if each != "pictures"]
    factors = [factor_of_axis(name, axis, str(path)) for name, axis in settings.axes.items()]
    factors += [factor_of_design(settings.design)] if settings.design else []
    factors += [factor_of_points(settings.points, str(path))] if settings.points else []
    study = OpenStudy(settings, base, tuple(factors), str(path))
    _check_names(study)
    _check_steps(study)
    if check:
        study.check()
    return study


def _require_few(settings: Study, path: Path) -> None:
    """Raise InputError for more points than a study may have, before any of them is drawn."""
    counts = {
        name: axis.count or len(axis.values or axis.variants or ()) for name, axis in settings.axes.items()
    }
    if settings.design is not None:
        counts["design"] = settings.design.count
    if settings.points:
        counts["points"] = len(settings.points)
    points = math.prod(counts.values())
    if points > MAX_POINTS:
        factors = " x ".join(f"{name} {count}" for name, count in counts.items())
        raise InputError(
            f"{path}: {points:,} points ({factors}) are more than {MAX_POINTS:,}; give fewer values, or draw "
            "several settings together in a design"
        )


def _with_paths(settings: Study, path: Path) -> Study:
    """Paths relative to the study's file made absolute, variants of files read."""
    beside = path.resolve().parent
    axes = dict(settings.axes)
    for name, axis in settings.axes.items():
        if axis.variants is not None:
            variants = {
                key: each if isinstance(each, dict) else read_settings(beside / each)
                for key, each in axis.variants.items()
            }
            for each in variants.values():
                each |= {DATA: str(beside / str(each[DATA]))} if DATA in each else {}
            axes[name] = axis.model_copy(update={"variants": variants})
        elif name == DATA and axis.values is not None:
            axes[name] = axis.model_copy(update={"values": tuple(str(beside / str(v)) for v in axis.values)})
    data = None if settings.data is None else str(beside / settings.data)
    return settings.model_copy(update={"axes": axes, "data": data})


def _base(base: dict[str, Any] | str, path: Path) -> Config:
    if isinstance(base, str):
        return load_config(path.resolve().parent / base)
    values, where = dict(base), f"{path}: base"
    extended = values.pop("extends", None)
    if extended is None:
        return config_with(values, where, {}, "")
    if not isinstance(extended, str):
        raise InputError(f"{where}.extends: expected the path of one file")
    return config_with(read_settings(path.resolve().parent / extended), extended, flat(values), where)


def _check_names(study: OpenStudy) -> None:
    """Raise InputError for a setting that no study has, or that two axes set."""
    where, sections = f"{study.source}: axes", (*Config.model_fields, DATA, PLAN)
    for name, axis in study.settings.axes.items():
        own_columns = ("point", "status", "reason", "verdict", "doubts")
        if axis.variants is not None and (name in own_columns or "." in name):
            raise InputError(
                f"{where}.{name}: the table has a column of that name, or may have one; choose another name "
                "for these variants, without dots"
            )
    seen: dict[str, Factor] = {}
    for factor in study.factors:
        for setting in sorted(factor.settings):
            if _section(setting) not in sections:
                raise InputError(
                    f"{where}: '{setting}' is no setting; it begins with one of: {', '.join(sections)}. An "
                    "axis with a name of its own has 'variants'"
                )
            if _section(setting) == "runtime":
                raise InputError(
                    f"{where}: '{setting}': how the machine is used does not change a result; remove it"
                )
            for other, of in seen.items():
                is_part = f"{setting}.".startswith(f"{other}.") or f"{other}.".startswith(f"{setting}.")
                if of is not factor and is_part:
                    owners = " and by ".join(", ".join(each.columns) for each in (of, factor))
                    raise InputError(f"{where}: '{setting}' is set by {owners}; vary it in one")
            seen[setting] = factor


def _check_steps(study: OpenStudy) -> None:
    """Raise InputError for steps without a sequence or a scene, and for data that are missing."""
    steps, source = study.settings.steps, study.source
    names = set[str]().union(*(factor.settings for factor in study.factors))
    sections = {_section(name) for name in names}
    has_data = study.settings.data is not None or DATA in names
    for is_wrong, what in (
        (
            "simulate" in steps and DATA in names,
            "axes: the points simulate their own sequences; remove 'data' or the step",
        ),
        (
            "run" in steps and "simulate" not in steps and not has_data,
            "a run needs a sequence: give 'data', or begin with the step 'simulate'",
        ),
        (
            "simulate" in steps and study.base["scene"] is None and "scene" not in sections,
            "base: no 'scene' to simulate; name a file of configs/scenes, or add one",
        ),
    ):
        if is_wrong:
            raise InputError(f"{source}: {what}")
    for path in study.inputs():
        if not path.exists():
            raise InputError(f"{source}: {path} is missing; give an existing file or sequence")
        if path.is_dir() and not (path / "mav0").is_dir():
            raise InputError(f"{source}: data: {path} is no sequence (it has no mav0/); give an existing one")


def _of_configuration(changes: Changes) -> Changes:
    return {key: value for key, value in changes.items() if _section(key) not in (DATA, PLAN)}


def _section(setting: str) -> str:
    return setting.partition(".")[0]
