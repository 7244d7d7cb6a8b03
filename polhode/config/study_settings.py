"""Settings of a study (``polhode sweep``): what is varied, what is done for each point, what is kept."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from polhode.config.section import Section, Seed

MAX_POINTS = 1_000_000
"""Of a study."""
Step = Literal["simulate", "run", "evaluate", "plan", "compare"]
STEPS: tuple[Step, ...] = ("simulate", "run", "evaluate", "plan", "compare")
"""In the order in which they follow each other"""
Keep = Literal["whole", "summary", "nothing"]
Number = Annotated[float, Field(ge=-1e15, le=1e15)]
Pair = tuple[Number, Number]


def _as_values(section: Any) -> Any:
    """A list in the place of an axis or a distribution is its values."""
    return {"values": section} if isinstance(section, list) else section


class Distribution(Section):
    """How a setting is drawn: one of these."""

    uniform: Pair | None = None
    """Least and largest value."""
    log_uniform: Pair | None = None
    """Least and largest value, both above 0: the logarithm is uniform."""
    normal: Pair | None = None
    """Mean and standard deviation."""
    values: tuple[Any, ...] | None = None
    """Values of equal probability."""

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Self:
        _one_of(self, ("uniform", "log_uniform", "normal", "values"))
        _check_ranges(self)
        return self


class Axis(Section):
    """The values of one setting, of which every one is combined with every one of the other axes.

    Either they are listed (``values``, ``variants``), or ``count`` of them lie in a range or are drawn.
    """

    values: tuple[Any, ...] | None = None
    """The values themselves; a list in the place of the axis is the same."""
    variants: dict[str, dict[str, Any] | str] | None = None
    """Named sets of settings: sections or dotted keys with their values, or a configuration file, which is
    laid over the base. The name of the axis is then free."""
    range: Pair | None = None
    """First and last value; the others lie between them in equal steps."""
    log_range: Pair | None = None
    """First and last value, both above 0; the others lie between them in equal ratios."""
    uniform: Pair | None = None
    """Random draws between these."""
    log_uniform: Pair | None = None
    """Random draws between these, both above 0, whose logarithm is uniform."""
    normal: Pair | None = None
    """Random draws with this mean and this standard deviation."""
    count: int | None = Field(None, ge=1)
    """Number of values of a range, or of draws."""
    seed: Seed = 0
    """Of the draws."""

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        _one_of(self, (*_LISTED, *_RANGES, *_DRAWN))
        _check_ranges(self)
        listed = any(getattr(self, name) is not None for name in _LISTED)
        if listed and self.count is not None:
            raise ValueError("count: values and variants are as many as they are; remove it")
        if not listed and self.count is None:
            raise ValueError("count is missing: how many values are wanted?")
        if self.variants is not None and not self.variants:
            raise ValueError("variants: there are none; name at least one")
        return self


_LISTED, _RANGES = ("values", "variants"), ("range", "log_range")
_DRAWN = ("uniform", "log_uniform", "normal")


class Design(Section):
    """Several settings drawn together: each draw is one point, combined with every value of the axes."""

    method: Literal["random", "latin_hypercube", "sobol"] = "latin_hypercube"
    """Independent draws, a Latin hypercube, or Sobol's sequence (scrambled), by scipy.stats.qmc."""
    count: int = Field(ge=1)
    """Number of draws; for Sobol's sequence, a power of two."""
    seed: Seed = 0
    """Of the draws."""
    settings: dict[str, Annotated[Distribution, BeforeValidator(_as_values)]]
    """Settings and how each is distributed."""

    @model_validator(mode="after")
    def _fits_the_method(self) -> Self:
        if not self.settings:
            raise ValueError("settings: there are none; name at least one")
        if self.method == "sobol" and self.count & (self.count - 1):
            below = 1 << (self.count.bit_length() - 1)
            raise ValueError(
                f"count: {self.count} draws, but Sobol's sequence is balanced for powers of two only; "
                f"give {below} or {2 * below}"
            )
        return self


class PlanOptions(Section):
    """Of the step ``plan``, as for ``polhode plan``."""

    horizon_s: float = Field(60.0, gt=0, le=1e6)
    """Time to predict beyond the last stereo pair [s]."""
    confidence: float = Field(0.99, ge=0.5, le=0.9999)
    """Probability that the whole surface stays inside the keep-out volume."""
    members: int | None = Field(None, ge=60, le=100_000)
    """Motions drawn from the covariance."""
    cover: Literal["auto", "possible", "outlines", "surface", "hull"] = "auto"
    """The body that is kept out of."""


class Study(Section):
    """What ``polhode sweep`` computes: a row for each point of a grid or a design."""

    title: str = Field("", max_length=200)
    """What the study asks, in a line."""
    base: dict[str, Any] | str = Field(default_factory=dict)
    """Settings of all points: a configuration file (relative to the study's), or sections as in one."""
    data: str | None = None
    """Folder of the stereo sequence of all points, where none is simulated (relative to the study's file)."""
    axes: dict[str, Annotated[Axis, BeforeValidator(_as_values)]] = Field(default_factory=dict)
    """Settings, as dotted keys of the configuration, and their values. Also "data", and "plan.horizon_s" and
    the like; an element of a list by its position: "scene.motion.spin_rpm.1"."""
    design: Design | None = None
    """Settings that are drawn together."""
    points: tuple[dict[str, Any], ...] = ()
    """Listed points: the settings of each, as dotted keys. Like a draw of a design, each of them is combined
    with every value of the axes."""
    steps: tuple[Step, ...] = ("simulate", "run", "evaluate")
    """What is done for each point, in this order: simulate, run, evaluate, plan, compare.
    None: the table has the settings alone."""
    plan: PlanOptions = PlanOptions()
    keep: Keep = "summary"
    """What stays of each run's folder: all of it, its summary and numbers, or nothing."""
    keep_sequences: bool = True
    """False: a simulated sequence is removed when no point needs it any more."""
    metrics: tuple[str, ...] = ()
    """Columns that study.html draws, the most important ones first; "*" stands for any letters. If there are
    none, the errors of motion, inertia and surface."""

    @model_validator(mode="after")
    def _steps_follow_each_other(self) -> Self:
        if list(self.steps) != [step for step in STEPS if step in self.steps]:
            raise ValueError(f"steps: give each at most once, in this order: {', '.join(STEPS)}")
        for step in ("evaluate", "plan"):
            if step in self.steps and "run" not in self.steps:
                raise ValueError(f"steps: '{step}' needs a run; add 'run' before it")
        if "simulate" in self.steps and self.data is not None:
            raise ValueError("data: the points simulate their own sequences; remove it, or the step simulate")
        if self.points and self.design is not None:
            raise ValueError("points, design: both name settings of points; give one of them")
        return self


def _one_of(section: Section, names: tuple[str, ...]) -> None:
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) != 1:
        what = " and ".join(given) if given else "none of them"
        raise ValueError(f"give exactly one of {', '.join(names)}; got {what}")


def _check_ranges(section: Section) -> None:
    for name in (*_RANGES, *_DRAWN):
        pair: Pair | None = getattr(section, name, None)
        if pair is None:
            continue
        if name.startswith("log") and min(pair) <= 0.0:
            raise ValueError(f"{name}: both ends must be above 0")
        if name == "normal":
            if pair[1] <= 0.0:
                raise ValueError(f"normal: the standard deviation must be above 0, got {pair[1]:g}")
        elif pair[0] == pair[1] or (name in _DRAWN and pair[0] > pair[1]):
            raise ValueError(f"{name}: the range from {pair[0]:g} to {pair[1]:g} is empty")
    values = getattr(section, "values", None)
    if values is not None:
        if not values:
            raise ValueError("values: the list is empty; give at least one")
        if any(isinstance(each, float) and not math.isfinite(each) for each in values):
            raise ValueError("values: give finite numbers")
