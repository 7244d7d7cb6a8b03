"""Whether `polhode expect` holds for the runs of other studies, none of which its rules were fitted to.

    python -m lab.studies.expectations [STUDY_FOLDER ...] [--rules RULES.yaml]

Without folders, of every study in docs/study_results but that of the fit. Counted are the runs with an
answer whose size in the image, disparity, turn, pairs and Sun are within the ranges of the rules, and that
have nothing of which the rules know nothing: a lamp, another contrast of the texture, stronger noise, a body
of revolution.
Printed is for each error how many are inside the band of 90 %, and the median of the error over the one that
is expected. Runs of one study share bodies and motions, so that its interval is rather too narrow.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from scipy import stats
from tyro.conf import Positional, arg

from lab.command import ROOT, command
from lab.presentation import print_table
from lab.studies.confidence import median
from lab.studies.random_scenes import FAMILIES
from lab.studies.study_results import Results, read_results
from polhode.config import Config
from polhode.config.scene_settings import Sensor, TargetBody
from polhode.studies.rules import CONFIDENCE, WORDS, Observation, Rules, expected, outside, read_rules
from polhode.studies.table import TABLE

RESULTS = ROOT / "docs" / "study_results"
USUAL_CONTRAST, USUAL_NOISE_DN = TargetBody().contrast, Sensor().read_noise_dn
SAME_NOISE = 2.0
"""A noise within this factor of the usual one counts as usual"""
CONTRADICTS = 0.025
"""Probability of a coverage as low as the one found, below which it contradicts that of the band"""
FITTED = "random_scenes"
"""The study that the rules are fitted to"""


def main(
    folders: Positional[Annotated[tuple[Path, ...], arg(metavar="STUDY_FOLDER", help="Of studies.")]] = (),
    rules: Annotated[
        Path | None, arg(metavar="FILE", help="Rules; those of this version if left out.")
    ] = None,
) -> None:
    """Print a row for each study."""
    known = read_rules(rules)
    rows = [compared(known, read_results(folder)) for folder in folders or other_studies()]
    print_table(
        ["study", *(WORDS.get(each.quantity, each.quantity) for each in known.rules)], filter(None, rows)
    )


def other_studies() -> list[Path]:
    """Folders of docs/study_results but for that of the fit."""
    return sorted(file.parent for file in RESULTS.glob(f"*/{TABLE}") if file.parent.name != FITTED)


def with_more_pairs(rules: Rules) -> Rules:
    """The rules with how many runs of other studies, which have more pairs than those of the fit, are inside.

    The rules as they are where there are none, or where they contradict a band.
    """
    fitted, studies = rules.ranges["pairs"][1], [read_results(folder) for folder in other_studies()]
    seen = [{k: each for k, each in within(rules, of).items() if each.pairs > fitted} for of in studies]
    found = []
    for number, rule in enumerate(rules.rules):
        inside = []
        for results, own in zip(studies, seen, strict=True):
            errors = rule.factor * results.column(rule.quantity)
            bands = {k: expected(open_ended(rules), own[k])[number] for k in own if errors[k] > 0.0}
            inside += [band.low <= errors[k] <= band.high for k, band in bands.items()]
        if not inside or stats.binom.cdf(sum(inside), len(inside), CONFIDENCE) < CONTRADICTS:
            return rules
        found.append(rule.model_copy(update={"more": len(inside), "more_inside": int(sum(inside))}))
    most = max(each.pairs for own in seen for each in own.values())
    return rules.model_copy(update={"rules": tuple(found), "checked_pairs": most})


def open_ended(rules: Rules) -> Rules:
    """The rules, extrapolated to any number of pairs."""
    return rules.model_copy(update={"checked_pairs": 10**6})


def within(rules: Rules, results: Results) -> dict[int, Observation]:
    """Of the runs with an answer, those within the ranges but for their pairs, if these are more."""
    return {
        k: about
        for k, each in enumerate(results.configurations)
        if results.done[k] and (about := observation_of_scene(each)) is not None and not outside(rules, about)
    }


def compared(rules: Rules, results: Results) -> list[str]:
    """A row with a cell for each error; none where no run is within the ranges."""
    seen = {k: each for k, each in within(rules, results).items() if each.pairs <= rules.most_pairs}
    row = []
    for number, rule in enumerate(rules.rules):
        errors = rule.factor * results.column(rule.quantity)
        own = [k for k in seen if errors[k] > 0.0]
        bands = [expected(rules, seen[k])[number] for k in own]
        inside = sum(band.low <= errors[k] <= band.high for k, band in zip(own, bands, strict=True))
        over = np.array([errors[k] / band.value for k, band in zip(own, bands, strict=True)])
        row.append(f"{inside} of {len(own)}, {median(over).text()}" if own else "-")
    return [results.title, *row] if seen else []


def observation_of_scene(config: Config) -> Observation | None:
    """What a designer would know of a scene; None: there is none, or it has what the rules do not know."""
    scene = config.scene
    if scene is None or scene.light.lamp > 0.0 or scene.body.path is not None:
        return None
    if scene.body.family not in FAMILIES or scene.body.contrast != USUAL_CONTRAST:
        return None
    if not 1.0 / SAME_NOISE <= scene.sensor.read_noise_dn / USUAL_NOISE_DN <= SAME_NOISE:
        return None
    away = np.array(scene.motion.position_m) - [0.5 * scene.rig.baseline_m, 0.0, 0.0]
    sun = np.array(scene.light.sun_direction_N)
    cosine = float(sun @ -away / (np.linalg.norm(sun) * np.linalg.norm(away)))
    return Observation(
        scene.body.size_m,
        float(np.linalg.norm(away)),
        float(np.linalg.norm(scene.motion.spin_rpm)),
        scene.rig.focal_px,
        scene.rig.baseline_m,
        scene.interval_s,
        scene.frames,
        float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))),
    )


if __name__ == "__main__":
    command(main)
