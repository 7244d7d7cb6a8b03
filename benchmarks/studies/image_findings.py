"""Findings on images: pixels on the target and baseline, light, texture, noise and resolution, front end."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from benchmarks.studies.confidence import median, share_text, significant
from benchmarks.studies.effects import (
    determined,
    doubts,
    exponents,
    levels,
    numeric_axes,
    outcomes,
    ratios,
    sigmas,
    variances,
)
from benchmarks.studies.study_results import (
    ATTITUDE,
    COMPLETION,
    POSITION,
    RATE,
    SURFACE,
    Part,
    Results,
    by_level,
)
from polhode.lie import Array
from polhode.records import Bools

ERRORS = (ATTITUDE, RATE, POSITION, SURFACE, COMPLETION)
PIXELS = (0.0, 40.0, 80.0, 120.0, 200.0, 400.0)
"""Ends of the groups of pixels across the target"""
BASELINE, SUN, LAMP = "scene.rig.baseline_m", "Sun to camera [deg]", "scene.light.lamp"
FAMILY, CONTRAST = "scene.body.family", "scene.body.contrast"
RESOLUTION, NOISE = "resolution", "scene.sensor.read_noise_dn"


def pixels_across(results: Results) -> Array:
    """(n,) the size of the target in the image, by the pinhole camera."""
    scenes = [each.scene for each in results.configurations]
    return np.array(
        [s.rig.focal_px * s.body.size_m / s.motion.position_m[2] if s else np.nan for s in scenes]
    )


def rig_for_target(results: Results) -> list[Part]:
    """Which rig for which target?"""
    pixels = pixels_across(results)
    groups = {f"{low:g} to {high:g}": (pixels > low) & (pixels <= high) for low, high in pairwise(PIXELS)}
    return [
        _by_group(results, "pixels across", groups),
        _crossed(results, "pixels across", groups, BASELINE, "m"),
        *of_images(results),
    ]


def light(results: Results) -> list[Part]:
    """Where may the Sun stand, and what does a lamp give?"""
    return [_crossed(results, SUN, by_level(results, SUN), LAMP), *of_images(results)]


def share_of_texture(results: Results) -> list[Part]:
    """How much texture does which body need?"""
    return [_crossed(results, FAMILY, by_level(results, FAMILY), CONTRAST), *of_images(results)]


def noise_and_resolution(results: Results) -> list[Part]:
    """What do pixels give, and what does noise take?"""
    return [_crossed(results, RESOLUTION, by_level(results, RESOLUTION), NOISE, "DN"), *of_images(results)]


def of_images(results: Results) -> list[Part]:
    """What each setting does to the errors, by itself."""
    by = numeric_axes(results)
    labels = results.settings.drop(columns=list(by)).astype(str).agg(tuple, axis=1)
    parts = [
        outcomes(results),
        *levels(results, ERRORS),
        *ratios(results, ERRORS),
        variances(results, results.axes, ERRORS),
    ]
    if by:
        errors = [(error, np.where(results.ok, results.errors(error), np.nan)) for error in ERRORS]
        parts.append(exponents("Exponents, of runs that are ok", errors, by, labels.tolist()))
    return [*parts, determined(results), sigmas(results), doubts(results)]


def _by_group(results: Results, name: str, groups: Mapping[str, Bools]) -> Part:
    """Runs that are ok, and medians of all that have an answer."""
    rows = []
    for group, at in groups.items():
        cells = [share_text(int((at & results.ok).sum()), int(at.sum()))]
        answered = f"{int((at & results.done).sum())} of {int(at.sum())}"
        errors = (ATTITUDE, RATE, POSITION)
        cells += [answered, *(median(results.errors(e)[at & results.done]).text() for e in errors)]
        rows.append([group, *cells])
    columns = f"{name} | ok | with an answer | {ATTITUDE.title} | {RATE.title} | {POSITION.title}"
    return Part(f"By {name}", columns, rows)


def _crossed(results: Results, name: str, groups: Mapping[str, Bools], across: str, unit: str = "") -> Part:
    """Runs that are ok of each group at each level of a setting, and the median attitude error."""
    levels = by_level(results, across)
    rows = []
    for group, at in groups.items():
        cells = []
        for own in levels.values():
            both = at & own
            error = significant(median(results.errors(ATTITUDE)[both & results.done]).value)
            cells.append(f"{int((both & results.ok).sum())} of {int(both.sum())}; {error}")
        rows.append([group, *cells])
    columns = " | ".join(f"{level} {unit}".strip() for level in levels)
    title = f"Runs that are ok, and the median attitude error [deg], by {name} and {across}"
    return Part(title, f"{name} | {columns}", rows)
