"""What the project's studies say, in tables with intervals of 95 %, from the tables in docs/study_results.

    python -m lab.studies.findings [NAME ...]

Without a name, of every study that is there. A finding may need two studies. The page lab/studies/README.md
quotes what is printed.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from lab.command import ROOT, command
from lab.studies.confidence import (
    exponents,
    geometric_mean,
    median,
    quantile,
    share_text,
    significant,
)
from lab.studies.study_results import (
    ATTITUDE,
    AXES,
    COM,
    COMPLETION,
    K1,
    K2,
    POSITION,
    RATE,
    SURFACE,
    Error,
    Part,
    Results,
    prediction,
    read_results,
)
from polhode.geometry.lie import Array, Bools
from polhode.records.metrics import COMPONENTS, NEES, expected_range
from polhode.studies.page.write_page import QUANTITIES
from polhode.studies.table import TABLE

RESULTS = ROOT / "docs" / "study_results"
TURNS_DEG = (0.0, 9.0, 18.0, 36.0, 72.0, 180.0, 360.0)
"""Ends of the groups of turns between two pairs"""
CLEAR_DEG = 100.0
"""Below it every point of the study of frame rates has an answer"""
PIXELS = (0.0, 40.0, 80.0, 120.0, 200.0, 400.0)
"""Ends of the groups of pixels across the target"""
WRONG_RATE, WRONG_DEG = 0.1, 5.0
"""Error of the rate over the rate, and median error of the attitude, above which an answer is wrong"""
PREDICTION = prediction(10)
OF_IMAGES = (ATTITUDE, RATE, POSITION, SURFACE, COMPLETION)


def main(
    names: Positional[Annotated[tuple[str, ...], arg(metavar="NAME", help="Of findings.")]] = (),
) -> None:
    """Print the tables."""
    if unknown := [name for name in names if name not in FINDINGS]:
        raise SystemExit(f"{unknown[0]}: no such finding; there are: {', '.join(FINDINGS)}")
    for name in names or FINDINGS:
        find, studies = FINDINGS[name]
        there = [RESULTS / each for each in studies if (RESULTS / each / TABLE).is_file()]
        if len(there) < len(studies) and (name in names or find is not every_run):
            raise SystemExit(f"{name}: a table of {', '.join(studies)} is missing in {RESULTS}")
        print(f"## {name}\n")
        for part in find(*map(read_results, there)):
            print(f"### {part.title}\n\n{part.table}\n")


def frame_rate_against_spin(results: Results) -> list[Part]:
    """Up to what turn between two pairs do runs hold, and what does it give?"""
    turn = turn_deg(results)
    groups = {f"{low:g} to {high:g}": (turn > low) & (turn <= high) for low, high in pairwise(TURNS_DEG)}
    return [by_group(results, "turn between pairs [deg]", groups, (PREDICTION, RATE, ATTITUDE))]


def revolutions_and_inertia(results: Results) -> list[Part]:
    """How long must one look until motion and inertia are known?"""
    looked, pairs = revolutions(results), results.of_scenes(lambda scene: scene.frames)
    groups = {f"{looked[pairs == count].mean():.1f}": pairs == count for count in np.unique(pairs)}
    return [by_group(results, "revolutions seen", groups, (PREDICTION, RATE, K1, K2, AXES, COM))]


def revolutions_or_pairs(frame_rate: Results, inertia: Results) -> list[Part]:
    """Does it matter how many pairs there are, or how far the target turns meanwhile?"""
    both = frame_rate, inertia
    used = [each.ok & (turn_deg(each) < CLEAR_DEG) for each in both]

    def joined(values: Callable[[Results], Array]) -> Array:
        return np.concatenate([values(each)[at] for each, at in zip(both, used, strict=True)])

    by = {
        "revolutions": joined(revolutions),
        "pairs": joined(lambda each: each.of_scenes(lambda scene: scene.frames)),
        "rate": joined(lambda each: each.rate_deg_s),
    }
    # each body of each study has a factor of its own
    groups = [(k, seed) for k, each in enumerate(both) for seed in each.settings["seed"][used[k]]]
    rows = []
    for error in (PREDICTION, RATE, K1, K2, AXES, COM, COMPLETION):
        found = exponents(joined(lambda each, error=error: each.errors(error)), by, groups)
        if found is not None:
            rows.append([error.title, found[0].count, *(each.fixed() for each in found)])
    return [
        Part(
            "Exponents of both studies together, of runs that are ok",
            f"error | runs | {' | '.join(by)}",
            rows,
        )
    ]


def rig_for_target(results: Results) -> list[Part]:
    """Which rig for which target?"""
    pixels = results.of_scenes(lambda s: s.rig.focal_px * s.body.size_m / s.motion.position_m[2])
    groups = {f"{low:g} to {high:g}": (pixels > low) & (pixels <= high) for low, high in pairwise(PIXELS)}
    return [
        by_group(results, "pixels across", groups, (ATTITUDE, RATE, POSITION)),
        crossed(results, "pixels across", groups, "scene.rig.baseline_m", "m"),
    ]


def crossing(by: str, across: str, unit: str = "") -> Callable[[Results], list[Part]]:
    """Of a study of two settings."""
    return lambda results: [crossed(results, by, results.by_level(by), across, unit)]


def front_ends(results: Results) -> list[Part]:
    """Errors over those of the default, scene by scene."""
    name = "features"
    levels = results.by_level(name)
    first = next(iter(levels))
    others = results.settings.drop(columns=name).astype(str).agg(tuple, axis=1).tolist()
    base = {others[k]: k for k in np.flatnonzero(levels[first])}
    rows = []
    for level, at in levels.items():
        own = np.array([(k, base[others[k]]) for k in np.flatnonzero(at) if others[k] in base]).T
        if level != first and len(own):
            with np.errstate(divide="ignore", invalid="ignore"):
                ratios = [
                    results.errors(error)[own[0]] / results.errors(error)[own[1]] for error in OF_IMAGES
                ]
            rows.append([level, len(own[0]), *(geometric_mean(each).text() for each in ratios)])
    titles = " | ".join(error.title for error in OF_IMAGES)
    return [
        Part(
            f"Errors over those at {name} {first}, all else being equal",
            f"{name} | runs compared | {titles}",
            rows,
        )
    ]


def one_mission(results: Results) -> list[Part]:
    """How are errors, predictions and keep-out volumes distributed?"""
    errors = [prediction(10), prediction(30), ATTITUDE, RATE, SURFACE]
    errors.append(Error("prediction of position, 30 s [mm]", "evaluate.prediction_error_m.30", 1e3))
    rows = [
        [error.title, median(results.errors(error)).text(), quantile(results.errors(error), 0.9).text()]
        for error in errors
    ]
    broken = []
    for volume in ("swept", "instant"):
        left, far = (results.column(f"plan.truth.{volume}_body_{name}") for name in ("left", "farthest_m"))
        known = np.isfinite(left)
        out = 1e3 * far[left == 1.0]
        share = share_text(int(left[known].sum()), int(known.sum()))
        broken.append([volume, share, f"{out.max():.0f}" if len(out) else "-"])
    return [
        Part("Distribution", "result | median | nine of ten are below", rows),
        Part("Keep-out volumes that the true body left", "volume | missions | farthest [mm]", broken),
    ]


def every_run(*studies: Results) -> list[Part]:
    """Are runs that are ok right, do intervals hold the truth, are standard deviations those of errors?"""
    verdict = np.concatenate([each.verdict[each.done] for each in studies])
    wrong = np.concatenate([_is_wrong(each)[each.done] for each in studies])
    said = [
        [word, share_text(int(wrong[verdict == word].sum()), int((verdict == word).sum()))]
        for word in ("ok", "degraded", "failed")
    ]
    truths = []
    for name in ("k1", "k2"):
        held = _joined(studies, f"evaluate.truth_in_interval.{name}")
        truths.append([name, share_text(int(held.sum()), len(held))])
    bands = []
    for name in COMPONENTS:
        values, band = _joined(studies, f"evaluate.{NEES}.{name}"), expected_range(NEES, name)
        if band is not None and len(values):
            above, below = int((values > band[1]).sum()), int((values < band[0]).sum())
            inside = share_text(len(values) - above - below, len(values))
            bands.append([QUANTITIES.get(name, name), inside, above, below])
    title = f"Wrong answers: the rate by {WRONG_RATE:.0%}, or the attitude by {WRONG_DEG:g} deg in the median"
    columns = "standard deviation of | runs inside | above: too small | below: too large"
    return [
        Part(title, "run | wrong", said),
        Part("Intervals of what is not determined", "quantity | truth inside", truths),
        Part("Runs in their own band of 95 %", columns, bands),
    ]


def by_group(results: Results, name: str, groups: Mapping[str, Bools], errors: Sequence[Error]) -> Part:
    """Runs that are ok, and medians of all that have an answer."""
    rows = []
    for group, at in groups.items():
        cells = [median(results.errors(error)[at & results.done]).text() for error in errors]
        rows.append([group, share_text(int((at & results.ok).sum()), int(at.sum())), *cells])
    return Part(f"By {name}", f"{name} | ok | {' | '.join(error.title for error in errors)}", rows)


def crossed(results: Results, name: str, groups: Mapping[str, Bools], across: str, unit: str = "") -> Part:
    """Runs that are ok and their attitude, by two settings."""
    levels, rows = results.by_level(across), []
    for group, at in groups.items():
        cells = []
        for own in levels.values():
            error = significant(median(results.errors(ATTITUDE)[at & own & results.done]).value)
            cells.append(f"{int((at & own & results.ok).sum())} of {int((at & own).sum())}; {error}")
        rows.append([group, *cells])
    columns = " | ".join(f"{level} {unit}".strip() for level in levels)
    title = f"Runs that are ok, and the median attitude error [deg], by {name} and {across}"
    return Part(title, f"{name} | {columns}", rows)


def turn_deg(results: Results) -> Array:
    """(n,) of the target between two pairs."""
    return results.rate_deg_s * results.of_scenes(lambda scene: scene.interval_s)


def revolutions(results: Results) -> Array:
    """(n,) that the target turned from the first pair to the last."""
    return turn_deg(results) * (results.of_scenes(lambda scene: scene.frames) - 1.0) / 360.0


def _is_wrong(results: Results) -> Bools:
    wrong_rate = results.errors(RATE) > WRONG_RATE * results.rate_deg_s
    return np.asarray(wrong_rate | (results.errors(ATTITUDE) > WRONG_DEG))


def _joined(studies: Sequence[Results], column: str) -> Array:
    """The numbers of a column in all studies."""
    values = np.concatenate([each.column(column) for each in studies])
    return np.asarray(values[np.isfinite(values)])


_RATE, _INERTIA = "frame_rate_against_spin", "revolutions_and_inertia"
FINDINGS: dict[str, tuple[Callable[..., list[Part]], tuple[str, ...]]] = {
    _RATE: (frame_rate_against_spin, (_RATE,)),
    _INERTIA: (revolutions_and_inertia, (_INERTIA,)),
    "revolutions_or_pairs": (revolutions_or_pairs, (_RATE, _INERTIA)),
    "rig_for_target": (rig_for_target, ("rig_for_target",)),
    "light": (crossing("Sun to camera [deg]", "scene.light.lamp"), ("light",)),
    "share_of_texture": (crossing("scene.body.family", "scene.body.contrast"), ("share_of_texture",)),
    "noise_and_resolution": (
        crossing("resolution", "scene.sensor.read_noise_dn", "DN"),
        ("noise_and_resolution",),
    ),
    "front_ends_of_scenes": (front_ends, ("front_ends_of_scenes",)),
    "one_mission": (one_mission, ("one_mission",)),
    "every_run": (
        every_run,
        (
            *(_RATE, _INERTIA, "rig_for_target", "noise_and_resolution", "share_of_texture", "light"),
            *("front_ends_of_scenes", "one_mission"),
        ),
    ),
}
"""By name: what is found, and the folders of the studies that it is made from"""


if __name__ == "__main__":
    command(main)
