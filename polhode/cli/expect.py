"""``polhode expect``: what accuracy to expect of a target and a rig, by a rule of thumb."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from polhode.cli.answer import Answer
from polhode.cli.options import Command, Named, Positive
from polhode.runtime.errors import InputError

NEEDED_DEG = 60.0
"""Turn between two pairs up to which successive images match and the direction of rotation is plain."""


class ExpectCommand(Command):
    """Estimate the accuracy for a target and a rig from a fit to simulated runs, with a band of 90 %.

    A rule of thumb for the design of a mission, and no result: simulate and run the scene to know more. The
    rules are fitted to runs by python -m lab.studies.rules_of_thumb (docs/expect.md).
    """

    size_m: Annotated[float, Named("M", "--size"), Positive]
    """Size of the body without its panels, as scene.body.size_m of the configuration [m]."""
    range_m: Annotated[float, Named("M", "--range"), Positive]
    """Distance of the target from the camera [m]."""
    rpm: Annotated[float, Named("RPM"), Positive]
    """Its rate [RPM]."""
    focal_px: Annotated[float, Named("PX"), Positive]
    """Focal length of the cameras [px]."""
    baseline_m: Annotated[float, Named("M", "--baseline"), Positive]
    """Distance between the cameras [m]."""
    interval_s: Annotated[float, Named("S", "--interval"), Positive] = 0.5
    """Time between two stereo pairs [s]."""
    pairs: Annotated[int, Named("N"), Field(ge=3, le=100_000)] = 20
    """Number of stereo pairs."""
    sun_angle_deg: Annotated[float, Named("DEG", "--sun-angle"), Field(ge=0, le=180)] = 45.0
    """Angle between the directions to the Sun and to the camera, seen from the target [deg]."""
    rules: Annotated[Path | None, Named("FILE")] = None
    """The rules, YAML, as a fit has written them. Without it, those that come with polhode."""

    def execute(self) -> Answer:
        """Print the errors with their bands."""
        from polhode.studies.rules import (
            WORDS,
            Observation,
            about_more_pairs,
            expected,
            outside,
            read_rules,
        )

        rules = read_rules(self.rules)
        observation = Observation(
            *(self.size_m, self.range_m, self.rpm, self.focal_px, self.baseline_m),
            *(self.interval_s, self.pairs, self.sun_angle_deg),
        )
        if self.range_m <= 0.5 * self.size_m:
            raise InputError(f"--range {self.range_m:g}: the camera would be inside the target; give more")
        if (turn_deg := observation.predictors["turn_deg"]) >= 180.0:
            raise InputError(
                f"--interval {self.interval_s:g}: the target would turn by {turn_deg:.3g} deg between two "
                "pairs, which images do not tell from a turn the other way; give "
                f"{self.interval_s * NEEDED_DEG / turn_deg:.2g} or less"
            )
        found = expected(rules, observation)
        beyond, more_pairs = outside(rules, observation), about_more_pairs(rules, observation)
        lines = [f"Beyond the runs of the fit, where this is no estimate: {each}." for each in beyond]
        lines += [
            f"{'error':24s} {'median':>10s} {'90 % band':>24s} {'':5s} {'left out':>10s} {'held back':>10s}"
        ]
        for each, rule in zip(found, rules.rules, strict=True):
            name = WORDS.get(each.quantity, each.quantity)
            checks = f"{rule.inside} of {rule.held_out}", f"{rule.new_inside} of {rule.new}"
            lines += [
                f"{name:24s} {each.value:10.3g} {each.low:11.3g} to {each.high:9.3g} {each.unit:5s} "
                f"{checks[0]:>10s} {checks[1]:>10s}"
            ]
        lines += [
            f"An estimate from {rules.runs} simulated runs, {rules.failed} of which had no answer. "
            "Inside their band were so many of the runs left out of a fit, and of those that no fit has seen."
        ]
        lines += [more_pairs] if more_pairs else []
        return Answer(
            "\n".join(lines),
            status="degraded" if beyond or self.pairs > rules.most_pairs else "ok",
            figures={
                "expected": [vars(each) for each in found],
                "predictors": observation.predictors,
                "outside": beyond,
                "runs": rules.runs,
                "most_pairs": rules.most_pairs,
                "failed": rules.failed,
                "held_out": {rule.quantity: [rule.inside, rule.held_out] for rule in rules.rules},
                "new": {rule.quantity: [rule.new_inside, rule.new] for rule in rules.rules},
                "more_pairs": {rule.quantity: [rule.more_inside, rule.more] for rule in rules.rules},
            },
            warnings=(
                *(f"beyond the runs of the fit: {each}" for each in beyond),
                *([more_pairs] if more_pairs else []),
            ),
        )
