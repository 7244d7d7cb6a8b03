"""Rules of thumb for mission designers: random scenes are simulated and run, and their errors fitted.

    python -m lab.studies.rules_of_thumb STUDY_FOLDER [-o RULES.yaml] [--scenes 96] [--held-back 30]
        [--stored]

The scenes are a study of ``polhode sweep`` in the folder: the same command goes on after whatever ended it,
and ``--stored`` computes nothing. Printed are, for each error, how much of its variance the fit explains, the
factor from the median to the end of the band of 90 %, and how many of the runs are inside the band of a fit
that leaves out their third of the runs. The last ``--held-back`` runs with an answer are in no fit: how many
of them are inside the band is printed with the interval of Clopper and Pearson. The rules are written only if
there are enough runs, and if no coverage contradicts 90 %; ``-o polhode/studies/rules_of_thumb.yaml`` gives
them to ``polhode expect``.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import yaml
from scipy import stats
from tyro.conf import Positional, arg

from lab.command import Workers, command, polhode
from lab.presentation import print_table
from lab.studies.confidence import share_text, significant
from lab.studies.expectations import CONTRADICTS, with_more_pairs
from lab.studies.random_scenes import RandomScene, random_scenes, settings_of
from polhode.files.atomic import write_text
from polhode.geometry.lie import Array
from polhode.studies.rules import (
    CONFIDENCE,
    PREDICTORS,
    RATIOS,
    WORDS,
    Observation,
    Rule,
    Rules,
    checked,
    fit,
)
from polhode.studies.steps import DONE
from polhode.studies.table import read_table

SCENES = 96
MIN_RUNS = 60
"""With answers; a fit of six coefficients to fewer is no rule"""
FACTORS = ("constant", *PREDICTORS[:-1], "Sun, a factor per 90 degrees")
"""Of the formula: a constant, exponents, and what the angle of the Sun does"""
AXIS = "random scene"
ERRORS: tuple[dict[str, Any], ...] = (
    {"quantity": "evaluate.attitude_error_deg.median", "unit": "deg"},
    {"quantity": "evaluate.rmse_angular_velocity_deg_s", "unit": "deg/s", "over": "rate"},
    {"quantity": "evaluate.rmse_position_m", "unit": "m", "over": "size"},
    {"quantity": "evaluate.mesh.accuracy_mm", "unit": "mm", "over": "size"},
)


def main(
    folder: Positional[Annotated[Path, arg(metavar="STUDY_FOLDER", help="Of the study.")]],
    output: Annotated[Path | None, arg(aliases=["-o"], metavar="FILE", help="The rules, YAML.")] = None,
    scenes: Annotated[int, arg(help="Number of random scenes.")] = SCENES,
    held_back: Annotated[int, arg(help="Last runs with an answer that only check the fit.")] = 0,
    stored: Annotated[bool, arg(help="Use the runs that are there; compute none.")] = False,
    workers: Workers = 1,
) -> None:
    """Run what is missing, fit, print, and write the rules if they are worth it."""
    if held_back < 0:
        raise SystemExit(f"--held-back {held_back}: give 0 or more runs")
    chosen = random_scenes(scenes)
    if not stored:
        folder.parent.mkdir(parents=True, exist_ok=True)
        study = folder.parent / f"{folder.name}.yaml"
        study.write_text(yaml.safe_dump(study_of(chosen), sort_keys=False))
        polhode("sweep", study, "-o", folder, "--workers", workers, may_fail=True)
    report(chosen, read_table(folder), output, held_back)


def study_of(scenes: Sequence[RandomScene]) -> dict[str, Any]:
    """The scenes as a study."""
    return {
        "title": "Random scenes for the rules of thumb",
        "axes": {AXIS: {"variants": {each.name: settings_of(each) for each in scenes}}},
        "steps": ["simulate", "run", "evaluate"],
        "keep": "nothing",
        "keep_sequences": False,
    }


def report(scenes: Sequence[RandomScene], table: pa.Table, output: Path | None, held_back: int = 0) -> None:
    """Print the fit, and write it if it is worth it."""
    if not table.num_rows:
        raise SystemExit("no run is stored that this code has computed; repeat the command without --stored")
    with_answer = sum(each == DONE for each in table.column("status").to_pylist())
    print(f"{table.num_rows} scenes, {with_answer} of them with an answer, {held_back} of these held back")
    if with_answer - held_back <= 3 * (1 + len(PREDICTORS)):
        print("too few for any fit: nothing is printed or written")
        return
    found = with_more_pairs(rules_of(scenes, table, held_back))
    columns = "error | runs | variance explained | band: median times or over | inside, left out"
    print_table(f"{columns} | inside, held back", [_row(rule) for rule in found.rules], right_from=1)
    print("\nConstant and exponents:\n")
    print_table(f"error | unit | {' | '.join(FACTORS)}", [_formula(rule) for rule in found.rules])
    print("\nRanges of the runs:\n")
    print_table(
        "quantity | from | to", [[name, *map(significant, ends)] for name, ends in found.ranges.items()]
    )
    print()
    if held_back:
        inside, new = (
            sum(values) for values in zip(*((r.new_inside, r.new) for r in found.rules), strict=True)
        )
        print(f"all errors of the runs that were held back: {share_text(inside, new)}; those of a run depend")
    if refusal := refused(found):
        print(f"no rules are written: {refusal}")
    elif output is not None:
        content = found.model_dump(mode="json")
        write_text(output, "# By python -m lab.studies.rules_of_thumb.\n" + yaml.safe_dump(content))
        print(f"rules: {output}")


def rules_of(scenes: Sequence[RandomScene], table: pa.Table, held_back: int = 0) -> Rules:
    """The fit to all runs that have an answer but the last ``held_back`` of these, which check it."""
    by_name = {each.name: observation_of(each) for each in scenes}
    names, status = (table.column(name).to_pylist() for name in (AXIS, "status"))
    seen = {k: by_name[names[k]] for k, each in enumerate(status) if each == DONE}
    rows = list(seen)
    used, new = rows[: len(rows) - held_back], rows[len(rows) - held_back :]
    described = [seen[k].described for k in used]
    return Rules(
        made_by="python -m lab.studies.rules_of_thumb",
        runs=len(names) - len(new),
        failed=len(names) - len(rows),
        ranges={name: _range([each[name] for each in described]) for name in (*PREDICTORS, *RATIOS)},
        rules=tuple(_rule(seen, table, used, new, about) for about in ERRORS),
    )


def _range(values: Sequence[float]) -> tuple[float, float]:
    return min(values), max(values)


def observation_of(scene: RandomScene) -> Observation:
    """What a designer would know of a scene."""
    return Observation(
        scene.size_m,
        scene.range_m,
        scene.rpm,
        scene.focal_px,
        scene.baseline_m,
        scene.interval_s,
        scene.pairs,
        scene.sun_angle_deg,
    )


def _rule(
    seen: Mapping[int, Observation],
    table: pa.Table,
    used: Sequence[int],
    new: Sequence[int],
    about: dict[str, Any],
) -> Rule:
    """Of one error: the fit to the rows that are used, checked by new ones."""
    column = table.column(about["quantity"]).to_pylist()

    def known(rows: Sequence[int]) -> tuple[list[Observation], Array]:
        own = [k for k in rows if column[k]]
        scale = [seen[k].scale(about.get("over", "nothing")) for k in own]
        return [seen[k] for k in own], np.array([column[k] for k in own]) / np.array(scale)

    return checked(fit(*known(used), **about), *known(new))


def refused(rules: Rules) -> str:
    """Why the rules are not worth writing; empty: they are."""
    for rule in rules.rules:
        if rule.held_out < MIN_RUNS:
            return f"{rule.quantity} has {rule.held_out} runs, and {MIN_RUNS} are needed"
        if stats.binom.cdf(rule.inside, rule.held_out, CONFIDENCE) < CONTRADICTS:
            return f"{rule.inside} of {rule.held_out} runs that were left out are inside for {rule.quantity}"
        if rule.new and stats.binom.cdf(rule.new_inside, rule.new, CONFIDENCE) < CONTRADICTS:
            return f"{rule.new_inside} of {rule.new} runs that were held back are inside for {rule.quantity}"
    return ""


def _row(rule: Rule) -> list[str]:
    half = stats.t.ppf(0.5 * (1.0 + CONFIDENCE), rule.freedom) * rule.sigma
    inside = f"{rule.inside} of {rule.held_out}"
    new = share_text(rule.new_inside, rule.new) if rule.new else "-"
    return [_name(rule), str(rule.held_out), f"{rule.explained:.0%}", f"{np.exp(half):.1f}", inside, new]


def _formula(rule: Rule) -> list[str]:
    """Constant, exponents with their standard deviations, and the factor of the Sun."""
    sigma = rule.sigma * np.sqrt(np.diag(rule.inverse))
    powers = [f"{value:+.2f} ± {each:.2f}" for value, each in zip(rule.coefficients, sigma, strict=True)][
        1:-1
    ]
    ends = np.exp(rule.coefficients[-1] + np.array([0.0, -1.0, 1.0]) * sigma[-1])
    sun = f"{ends[0]:.2f} ({ends[1]:.2f} to {ends[2]:.2f})"
    unit = {"size": f"{rule.unit} per m of size", "rate": "of the rate"}.get(rule.over, rule.unit)
    return [_name(rule), unit, significant(float(np.exp(rule.coefficients[0])), 3), *powers, sun]


def _name(rule: Rule) -> str:
    return WORDS.get(rule.quantity, rule.quantity)


if __name__ == "__main__":
    command(main)
