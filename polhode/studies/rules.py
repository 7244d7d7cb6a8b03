"""Rules of thumb: what accuracy to expect of a target and a rig, fitted to the runs of a study.

The logarithm of an error is linear in the logarithms of what decides it: how many pixels the target has, its
disparity, how far it turns from pair to pair, how many pairs there are; and in the angle of the Sun. Errors
are over the size of the target, or over its rate, so that the rule holds at every scale. A band is that in
which one more run lies with 90 %: Student's t, with what the coefficients are uncertain by.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy import stats

from polhode.config.loader import validated
from polhode.config.section import Section
from polhode.files.yaml_files import read_yaml
from polhode.geometry.lie import Array
from polhode.runtime.errors import InputError

CONFIDENCE = 0.9
FOLDS = 3
"""Each third of the runs is left out once, and predicted by the others"""
PREDICTORS = ("size_px", "disparity_px", "turn_deg", "pairs", "sun_angle_deg")
RATIOS = ("range_over_size", "baseline_over_range")
"""Not in the formula; beyond those of the runs, it is no estimate either"""
SHIPPED = Path(__file__).with_name("rules_of_thumb.yaml")
"""Those of this version, if it has any"""
WORDS = {
    "evaluate.attitude_error_deg.median": "attitude, median",
    "evaluate.rmse_angular_velocity_deg_s": "angular velocity, RMS",
    "evaluate.rmse_position_m": "position, RMS",
    "evaluate.mesh.accuracy_mm": "surface, mean distance",
}
"""Names of quantities for people"""
UNIFORM = frozenset({"sun_angle_deg"})
"""Predictors that are taken as they are, over 90 degrees; of the others, the logarithm"""


@dataclass(frozen=True)
class Observation:
    """What a mission designer knows of a target, a rig, and how they meet."""

    size_m: float
    range_m: float
    rpm: float
    focal_px: float
    baseline_m: float
    interval_s: float
    """Time between two pairs"""
    pairs: int
    sun_angle_deg: float
    """Between the directions to the Sun and to the camera, seen from the target"""

    @property
    def predictors(self) -> dict[str, float]:
        """What the accuracy depends on."""
        return {
            "size_px": self.focal_px * self.size_m / self.range_m,
            "disparity_px": self.focal_px * self.baseline_m / self.range_m,
            "turn_deg": 6.0 * self.rpm * self.interval_s,
            "pairs": float(self.pairs),
            "sun_angle_deg": self.sun_angle_deg,
        }

    @property
    def described(self) -> dict[str, float]:
        """The predictors, and the ratios that are not in the formula."""
        ratios = (self.range_m / self.size_m, self.baseline_m / self.range_m)
        return self.predictors | dict(zip(RATIOS, ratios, strict=True))

    @property
    def row(self) -> Array:
        """(6,) of the linear fit: one, and a value for each predictor."""
        values = self.predictors
        return np.array(
            [1.0, *(values[n] / 90.0 if n in UNIFORM else math.log(values[n]) for n in PREDICTORS)]
        )

    def scale(self, over: str) -> float:
        """What an error is divided by."""
        return {"size": self.size_m, "rate": 6.0 * self.rpm}.get(over, 1.0)


class Rule(Section):
    """Of one error: its fit, and how well it predicted the runs that were left out."""

    quantity: str
    """Column of the table of a study"""
    unit: str
    factor: float = 1.0
    """From the unit of the column to ``unit``"""
    over: Literal["size", "rate", "nothing"] = "nothing"
    """What it is divided by: the size of the target [m], its rate [deg/s], or nothing"""
    coefficients: tuple[float, ...]
    """(6,) as ``Observation.row``"""
    sigma: float
    """Standard deviation of the logarithm about the fit"""
    freedom: int
    """Runs less coefficients"""
    inverse: tuple[tuple[float, ...], ...]
    """(6, 6) covariance of the coefficients over the square of ``sigma``"""
    explained: float
    """Share of the variance of the logarithm"""
    held_out: int
    """Runs that were predicted by a fit without them"""
    inside: int
    """Those of them inside their band"""
    new: int = 0
    """Runs that were held back: this fit, and every choice about it, was made without them"""
    new_inside: int = 0
    """Those of them inside their band"""
    more: int = 0
    """Runs of other studies with more pairs than any run of the fit, but no more than ``checked_pairs``"""
    more_inside: int = 0
    """Those of them inside their band"""


class Rules(Section):
    """The rules of thumb of a version, and what they rest on."""

    made_by: str
    """The command"""
    runs: int
    """All that were tried"""
    failed: int
    """Those without an answer"""
    ranges: dict[str, tuple[float, float]]
    """Of the predictors and ratios of the runs: beyond, a rule is no estimate"""
    rules: tuple[Rule, ...]
    checked_pairs: int = 0
    """Most pairs of runs of other studies whose errors do not contradict the bands; 0: not checked"""

    @property
    def most_pairs(self) -> int:
        """Pairs up to which runs support the rules."""
        return max(int(self.ranges["pairs"][1]), self.checked_pairs)


@dataclass(frozen=True)
class Expected:
    """An error that is to be expected."""

    quantity: str
    unit: str
    value: float
    """Median"""
    low: float
    """Ends of the band of 90 %"""
    high: float


def fit(observations: Sequence[Observation], errors: Array, **about: object) -> Rule:
    """A rule for errors (n,) above 0, already over their scale. ``about``: quantity, unit, over, factor."""
    A, y = np.array([each.row for each in observations]), np.log(errors)
    rule = Rule.model_validate(about | _least_squares(A, y) | {"held_out": len(y), "inside": 0})
    fold = np.arange(len(y)) % FOLDS
    inside = 0
    for k in range(FOLDS):
        part = rule.model_copy(update=_least_squares(A[fold != k], y[fold != k]))
        inside += sum(
            _is_inside(part, row, each) for row, each in zip(A[fold == k], y[fold == k], strict=True)
        )
    return rule.model_copy(update={"inside": inside})


def _least_squares(A: Array, y: Array) -> dict[str, object]:
    """Of a fit: what a rule has of it."""
    coefficients = np.linalg.lstsq(A, y, rcond=None)[0]
    residual, freedom = y - A @ coefficients, len(y) - A.shape[1]
    return {
        "coefficients": tuple(coefficients.tolist()),
        "sigma": math.sqrt(float(residual @ residual) / freedom),
        "freedom": freedom,
        "inverse": tuple(map(tuple, np.linalg.inv(A.T @ A).tolist())),
        "explained": float(1.0 - np.var(residual) / np.var(y)),
    }


def _predicted(rule: Rule, row: Array) -> tuple[float, float]:
    """Logarithm of the median, and half the band of one more run about it."""
    wide = float(stats.t.ppf(0.5 * (1.0 + CONFIDENCE), rule.freedom))
    half = wide * rule.sigma * math.sqrt(1.0 + float(row @ np.array(rule.inverse) @ row))
    return float(row @ np.array(rule.coefficients)), half


def _is_inside(rule: Rule, row: Array, logarithm: float) -> bool:
    middle, half = _predicted(rule, row)
    return bool(abs(logarithm - middle) <= half)


def expected(rules: Rules, observation: Observation) -> list[Expected]:
    """The errors that are to be expected, with their bands.

    Pairs beyond those that runs support make no error larger: median and upper end stay, the lower end is
    the rule's.
    """
    found, held = [], replace(observation, pairs=min(observation.pairs, rules.most_pairs))
    for rule in rules.rules:
        middle, half = _predicted(rule, held.row)
        lowest = min(middle - half, np.subtract(*_predicted(rule, observation.row)))
        unit = observation.scale(rule.over) * rule.factor
        low, value, high = (unit * math.exp(each) for each in (lowest, middle, middle + half))
        found.append(Expected(rule.quantity, rule.unit, value, low, high))
    return found


def checked(rule: Rule, observations: Sequence[Observation], errors: Array) -> Rule:
    """The same rule with how many new runs are inside its band; errors (n,) above 0, over their scale."""
    pairs = zip(observations, errors.tolist(), strict=True)
    inside = sum(_is_inside(rule, each.row, math.log(error)) for each, error in pairs)
    return rule.model_copy(update={"new": len(errors), "new_inside": inside})


def outside(rules: Rules, observation: Observation) -> list[str]:
    """Predictors and ratios that are beyond those of the runs, each in words; more pairs are not."""
    found = []
    for name, value in observation.described.items():
        low, high = rules.ranges.get(name, (-math.inf, math.inf))
        high = math.inf if name == "pairs" else high
        if not low <= value <= high:
            found.append(f"{name} {value:.3g} is outside of {low:.3g} to {high:.3g}")
    return found


def about_more_pairs(rules: Rules, observation: Observation) -> str:
    """What supports an answer for more pairs than any run of the fit has, a sentence; empty: the fit does."""
    fitted, most = int(rules.ranges["pairs"][1]), rules.most_pairs
    if observation.pairs <= fitted:
        return ""
    if observation.pairs > most:
        return (
            f"No run had more than {most} pairs: median and upper end are those of {most}, which more do not "
            "make worse; the lower end is extrapolated."
        )
    inside = ", ".join(f"{rule.more_inside} of {rule.more}" for rule in rules.rules)
    return (
        f"The fit had at most {fitted} pairs. Inside its bands were, of runs of other studies with up to "
        f"{most}: {inside}."
    )


def read_rules(path: Path | None = None) -> Rules:
    """Rules that a fit has written; None: those that come with this version. Raises InputError."""
    if path is None:
        path = SHIPPED
        if not path.is_file():
            raise InputError(
                "no rules of thumb come with this version: give with --rules the file of python -m "
                "lab.studies.rules_of_thumb (docs/expect.md)"
            )
    content = read_yaml(path, f"{path} is missing: give the file of python -m lab.studies.rules_of_thumb")
    if not isinstance(content, dict) or "made_by" not in content:
        raise InputError(f"{path}: no rules of thumb; give the file that the fit wrote")
    rules = validated(Rules, content, str(path))
    size = 1 + len(PREDICTORS)
    for rule in rules.rules:
        if len(rule.coefficients) != size or np.shape(rule.inverse) != (size, size) or rule.freedom < 1:
            raise InputError(f"{path}: the rule of {rule.quantity} is incomplete; write the file again")
    if missing := [name for name in PREDICTORS if name not in rules.ranges]:
        raise InputError(f"{path}: ranges: {missing[0]} is missing; write the file again")
    return rules
