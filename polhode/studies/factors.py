"""The values of axes and designs: lists, ranges, random draws, Latin hypercubes, Sobol's sequence.

A factor is what the grid combines with every other factor: an axis, or a design of several settings.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from scipy.stats import qmc

from polhode.config import Config
from polhode.config.keys import annotation_at, options_of
from polhode.config.study_settings import Axis, Design, Distribution, PlanOptions
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

Changes = dict[str, Any]
"""Dotted setting -> value"""


@dataclass(frozen=True)
class Factor:
    """What the grid combines with every other factor."""

    columns: tuple[str, ...]
    """Of the table"""
    values: tuple[tuple[Any, ...], ...]
    """Of the columns, for each level"""
    changes: tuple[Changes, ...]
    """Settings of each level"""

    def __len__(self) -> int:
        return len(self.values)

    @property
    def settings(self) -> set[str]:
        """Dotted settings that any level sets."""
        return set().union(*self.changes)

    def extremes(self) -> list[int]:
        """Levels that show whether all of them are valid: every listed one, and those with the least and the
        largest number of each column."""
        columns = list(zip(*self.values, strict=True))
        if any(type(value) not in (int, float) for column in columns for value in column):
            return list(range(len(self)))
        ends = {int(find(column)) for column in columns for find in (np.argmin, np.argmax)}
        return sorted({0, *ends})


def factor_of_axis(name: str, axis: Axis, where: str) -> Factor:
    """The levels of an axis; the variants of one have their settings in them. Raises InputError."""
    if axis.variants is not None:
        values = tuple((variant,) for variant in axis.variants)
        changes = tuple(flat(each) for each in axis.variants.values() if not isinstance(each, str))
        assert len(changes) == len(values)
        return Factor((name,), values, changes)
    levels = [_plain(each) for each in _levels(name, axis)]
    if twice := _repeated(levels):
        raise InputError(f"{where}: axes.{name}: the value {twice[:60]} comes twice; give each once")
    return Factor((name,), tuple((each,) for each in levels), tuple({name: each} for each in levels))


def factor_of_design(design: Design) -> Factor:
    """The draws of a design."""
    names = tuple(design.settings)
    rng, dimension = np.random.default_rng(design.seed), len(names)
    if design.method == "random":
        shares = rng.uniform(size=(design.count, dimension))
    elif design.method == "latin_hypercube":
        shares = np.asarray(qmc.LatinHypercube(dimension, rng=rng).random(design.count))
    else:
        shares = np.asarray(qmc.Sobol(dimension, scramble=True, rng=rng).random(design.count))
    columns = [_scaled(name, each, shares[:, k]) for k, (name, each) in enumerate(design.settings.items())]
    values = tuple(zip(*columns, strict=True))
    return Factor(names, values, tuple(dict(zip(names, row, strict=True)) for row in values))


def factor_of_points(points: Sequence[Mapping[str, Any]], where: str) -> Factor:
    """Points that are listed, as the levels of a factor. Raises InputError."""
    changes = tuple(flat(each) for each in points)
    columns = tuple(dict.fromkeys(name for each in changes for name in each))
    if twice := _repeated(changes):
        raise InputError(f"{where}: points: {twice[:60]} comes twice; give each once")
    return Factor(columns, tuple(tuple(each.get(name) for name in columns) for each in changes), changes)


def flat(settings: Mapping[str, Any], prefix: str = "") -> Changes:
    """Sections within each other as dotted settings."""
    found: Changes = {}
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = _plain(value)
    return found


def _repeated(values: Sequence[Any]) -> str | None:
    """A value that comes more than once."""
    counts = Counter(json.dumps(value, sort_keys=True) for value in values)
    return next((text for text, count in counts.items() if count > 1), None)


def _levels(name: str, axis: Axis) -> Sequence[Any]:
    if axis.values is not None:
        return axis.values
    count = axis.count
    assert count is not None
    if axis.range is not None:
        return _typed(name, np.linspace(*axis.range, count))
    if axis.log_range is not None:
        return _typed(name, np.geomspace(*axis.log_range, count))
    # two axes with one seed are independent: the name is part of it
    shares = np.random.default_rng([axis.seed, *name.encode()]).uniform(size=count)
    drawn = Distribution(uniform=axis.uniform, log_uniform=axis.log_uniform, normal=axis.normal)
    return _scaled(name, drawn, shares)


def _scaled(name: str, wanted: Distribution, shares: Array) -> list[Any]:
    """Draws (n,) of [0, 1) as values of a setting."""
    if wanted.values is not None:
        return [_plain(wanted.values[int(share * len(wanted.values))]) for share in shares]
    if wanted.uniform is not None:
        low, high = wanted.uniform
        return _typed(name, low + (high - low) * shares)
    if wanted.log_uniform is not None:
        low, high = np.log(wanted.log_uniform)
        return _typed(name, np.exp(low + (high - low) * shares))
    assert wanted.normal is not None
    mean, sigma = wanted.normal
    # a draw of exactly 0 would be infinite
    return _typed(name, stats.norm.ppf(np.clip(shares, 1e-15, 1.0 - 1e-15), mean, sigma))


def _typed(name: str, values: Array) -> list[Any]:
    """Whole numbers for settings that take nothing else."""
    path = name.split(".")
    is_plan = path[0] == "plan"
    kinds = options_of(annotation_at(PlanOptions if is_plan else Config, path[1:] if is_plan else path))
    is_whole = int in kinds and float not in kinds
    return [round(each) if is_whole else each for each in values.tolist()]


def _plain(value: Any) -> Any:
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
