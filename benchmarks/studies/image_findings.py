"""Findings on images: light, texture, noise and resolution, rig, front end."""

import numpy as np

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
from benchmarks.studies.study_results import ATTITUDE, COMPLETION, POSITION, RATE, SURFACE, Part, Results

ERRORS = (ATTITUDE, RATE, POSITION, SURFACE, COMPLETION)


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
