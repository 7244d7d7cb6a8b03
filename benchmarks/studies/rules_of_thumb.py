"""Rules of thumb for mission designers: random scenes are simulated and run, and their errors fitted.

    python -m benchmarks.studies.rules_of_thumb STUDY_FOLDER [-o RULES.yaml] [--scenes 128] [--short]

The scenes are a study of ``polhode sweep`` in the folder: the same command goes on after whatever ended it.
Printed are, for each error, how much of its variance the fit explains, the factor from the median to the end
of the band of 90 %, and how many of the runs are inside the band of a fit that leaves out their third of the
runs. The rules are written only if there are enough runs, and if that coverage does not contradict 90 %.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import yaml
from scipy import stats
from tyro.conf import Positional, arg

from benchmarks.command import Short, Workers, command, polhode
from benchmarks.presentation import print_table
from benchmarks.studies.random_scenes import RandomScene, random_scenes, settings_of
from polhode.atomic import write_text
from polhode.studies.rules import CONFIDENCE, PREDICTORS, Observation, Rule, Rules, fit
from polhode.studies.steps import DONE
from polhode.studies.table import read_table

SCENES, SHORT_SCENES = 128, 8
MIN_RUNS = 60
"""With answers; a fit of six coefficients to fewer is no rule"""
CONTRADICTS = 0.025
"""Probability of a coverage as low as the one found, below which it contradicts that of the band"""
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
    short: Short = False,
    workers: Workers = 1,
) -> None:
    """Run what is missing, fit, print, and write the rules if they are worth it."""
    chosen = random_scenes(SHORT_SCENES if short else scenes)
    folder.parent.mkdir(parents=True, exist_ok=True)
    study = folder.parent / f"{folder.name}.yaml"
    study.write_text(yaml.safe_dump(study_of(chosen), sort_keys=False))
    polhode("sweep", study, "-o", folder, "--workers", workers, may_fail=True)
    report(chosen, read_table(folder), output)


def study_of(scenes: Sequence[RandomScene]) -> dict[str, Any]:
    """The scenes as a study."""
    return {
        "title": "Random scenes for the rules of thumb",
        "axes": {AXIS: {"variants": {each.name: settings_of(each) for each in scenes}}},
        "steps": ["simulate", "run", "evaluate"],
        "keep": "nothing",
        "keep_sequences": False,
    }


def report(scenes: Sequence[RandomScene], table: pa.Table, output: Path | None) -> None:
    """Print the fit, and write it if it is worth it."""
    with_answer = sum(each == DONE for each in table.column("status").to_pylist())
    print(f"{table.num_rows} scenes, {with_answer} of them with an answer")
    if with_answer <= 3 * (1 + len(PREDICTORS)):
        print("too few for any fit: nothing is printed or written")
        return
    found = rules_of(scenes, table)
    columns = "error | runs | variance explained | band: median times or over | inside, left out"
    print_table(columns, [_row(rule) for rule in found.rules], right_from=1)
    if refusal := refused(found):
        print(f"no rules are written: {refusal}")
    elif output is not None:
        content = found.model_dump(mode="json")
        write_text(output, "# By python -m benchmarks.studies.rules_of_thumb.\n" + yaml.safe_dump(content))
        print(f"rules: {output}")


def rules_of(scenes: Sequence[RandomScene], table: pa.Table) -> Rules:
    """The fit to all runs that have an answer."""
    by_name = {each.name: observation_of(each) for each in scenes}
    names, status = (table.column(name).to_pylist() for name in (AXIS, "status"))
    used = [k for k, each in enumerate(status) if each == DONE]
    observations = [by_name[names[k]] for k in used]
    predictors = [each.predictors for each in observations]
    return Rules(
        made_by="python -m benchmarks.studies.rules_of_thumb",
        runs=len(names),
        failed=len(names) - len(used),
        ranges={name: _range([each[name] for each in predictors]) for name in PREDICTORS},
        rules=tuple(_rule(observations, table, used, about) for about in ERRORS),
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
    observations: Sequence[Observation], table: pa.Table, used: Sequence[int], about: dict[str, Any]
) -> Rule:
    column = table.column(about["quantity"]).to_pylist()
    known = [(each, column[k]) for each, k in zip(observations, used, strict=True) if column[k]]
    own = [each for each, _ in known]
    scale = np.array([each.scale(about.get("over", "nothing")) for each in own])
    return fit(own, np.array([value for _, value in known]) / scale, **about)


def refused(rules: Rules) -> str:
    """Why the rules are not worth writing; empty: they are."""
    for rule in rules.rules:
        if rule.held_out < MIN_RUNS:
            return f"{rule.quantity} has {rule.held_out} runs, and {MIN_RUNS} are needed"
        if stats.binom.cdf(rule.inside, rule.held_out, CONFIDENCE) < CONTRADICTS:
            return f"{rule.inside} of {rule.held_out} runs that were left out are inside for {rule.quantity}"
    return ""


def _row(rule: Rule) -> list[str]:
    half = stats.t.ppf(0.5 * (1.0 + CONFIDENCE), rule.freedom) * rule.sigma
    inside = f"{rule.inside} of {rule.held_out}"
    return [rule.quantity, str(rule.held_out), f"{rule.explained:.0%}", f"{np.exp(half):.1f}", inside]


if __name__ == "__main__":
    command(main)
