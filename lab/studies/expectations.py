"""Whether `polhode expect` holds for the runs of other studies, none of which its rules were fitted to.

    python -m lab.studies.expectations [STUDY_FOLDER ...] [--rules RULES.yaml]

Without folders, of every study in docs/study_results but that of the fit. Counted are the runs with an
answer whose size in the image, disparity, turn, pairs and Sun are within the ranges of the rules, and that
have nothing of which the rules know nothing: a lamp, another contrast of the texture, stronger noise, a body
of revolution.
Printed is how many of their errors are inside the band of 90 %, with the interval of Clopper and Pearson,
and the median of the error over the one that is expected. Runs of one study share bodies and motions, so
that the interval is rather too narrow.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import ROOT, command
from lab.presentation import Row, print_table
from lab.studies.confidence import median, share_text
from lab.studies.random_scenes import FAMILIES
from lab.studies.study_results import Results, read_results
from polhode.config import Config
from polhode.config.scene_settings import Sensor, TargetBody
from polhode.studies.rules import WORDS, Observation, Rules, expected, outside, read_rules
from polhode.studies.table import TABLE

RESULTS = ROOT / "docs" / "study_results"
USUAL_CONTRAST, USUAL_NOISE_DN = TargetBody().contrast, Sensor().read_noise_dn
SAME_NOISE = 2.0
"""A noise within this factor of the usual one counts as usual"""
FITTED = "random_scenes"
"""The study that the rules are fitted to"""


def main(
    folders: Positional[Annotated[tuple[Path, ...], arg(metavar="STUDY_FOLDER", help="Of studies.")]] = (),
    rules: Annotated[
        Path | None, arg(metavar="FILE", help="Rules; those of this version if left out.")
    ] = None,
) -> None:
    """Print a row for each study and error."""
    known, rows = read_rules(rules), []
    for folder in folders or other_studies():
        rows += compared(known, read_results(folder))
    columns = "study | runs | error | inside the band | error over expected"
    print_table(columns, rows, right_from=3)


def other_studies() -> list[Path]:
    """Folders of docs/study_results but for that of the fit."""
    return sorted(file.parent for file in RESULTS.glob(f"*/{TABLE}") if file.parent.name != FITTED)


def compared(rules: Rules, results: Results) -> list[Row]:
    """A row for each error that some run within the ranges has; none where no run is within them."""
    seen = {
        k: about
        for k, each in enumerate(results.configurations)
        if results.done[k] and (about := observation_of_scene(each)) is not None and not outside(rules, about)
    }
    rows: list[Row] = []
    for number, rule in enumerate(rules.rules):
        errors = rule.factor * results.column(rule.quantity)
        own = [k for k in seen if errors[k] > 0.0]
        if own:
            bands = [expected(rules, seen[k])[number] for k in own]
            inside = [band.low <= errors[k] <= band.high for k, band in zip(own, bands, strict=True)]
            over = np.array([errors[k] / band.value for k, band in zip(own, bands, strict=True)])
            name = WORDS.get(rule.quantity, rule.quantity)
            rows.append(
                [results.title, len(own), name, share_text(sum(inside), len(own)), median(over).text()]
            )
    return rows


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
