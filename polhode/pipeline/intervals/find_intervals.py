"""The intervals of what a run's motion does not determine (docs/run_directory.md, "Intervals").

A component that the motion determines has a standard deviation and no interval. The others have the interval
that the body's hull leaves: the centre of mass lies inside it, and the inertia is that of a mass inside it.
"""

import logging
from typing import Any

import numpy as np

from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.config.backend_settings import Backend, Bounds
from polhode.pipeline.intervals.hull_and_limits import (
    BodyHull,
    MotionLimits,
    body_hull,
    com_extremes,
    motion_limits,
)
from polhode.pipeline.intervals.inertia_ratios import ratio_intervals
from polhode.records.estimate import Identifiability, MotionEstimate
from polhode.records.surface import SurfaceModel
from polhode.run_directory.summary_schema import Coverage, Intervals

_log = logging.getLogger(__name__)

POINTS = 400
"""That fill the hull. The largest k2, that of a needle of few points, is good to about 5 %."""


def find_intervals(
    estimate: MotionEstimate, surface: SurfaceModel, coverage: Coverage | None, config: Backend
) -> tuple[Intervals | None, list[str]]:
    """The intervals, and warnings; (None, []) where everything is determined or they are switched off."""
    mass, known = estimate.mass, estimate.mass.identifiable
    if not config.bounds.intervals or (known.k1 and known.k2 and known.com):
        return None, []
    hull = body_hull(surface, estimate.landmarks, coverage)
    if hull is None or estimate.covariance_last_body is None:
        return None, ["no intervals: there is no hull of the body, which the surface or the landmarks give"]
    J_G, by_parameters = inertia_by_parameters(mass.J_G, FORMS[config.inertia])
    seen = estimate.covariance_last_body, mass.R_GP @ estimate.w_P[-1], 2.0 * hull.radius_m
    limits = motion_limits(mass.com_G, mass.R_GP, J_G, by_parameters, *seen)
    try:
        return intervals_in(hull, limits, known, config.bounds)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        _log.warning("no intervals: %s", error, exc_info=_log.isEnabledFor(logging.DEBUG))
        return None, [f"no intervals: {error}"]


def intervals_in(
    hull: BodyHull, limits: MotionLimits, known: Identifiability, given: Bounds
) -> tuple[Intervals | None, list[str]]:
    """The intervals of what is not ``known``, and warnings."""
    directions = np.concatenate([np.eye(3), limits.R_GP.T])
    inner, bounds = hull, ["centre of mass inside the convex hull of the surface and the landmarks"]
    if given.com_box_G is not None:
        inner = hull.within(*map(np.array, given.com_box_G))
        bounds.append("centre of mass inside the given box (backend.bounds.com_box_G)")
    extremes = com_extremes(inner, limits, directions)
    if extremes is None:
        return None, [
            "no intervals: the centre of mass lies outside the hull of the body; the motion or the surface "
            "is wrong"
        ]
    found: dict[str, Any] = dict.fromkeys(("com_G", "com_shift_P", "k1", "k2"))
    doubts = []
    if not known.com:
        along = np.einsum("nk,nsk->ns", directions, extremes)
        shift = along[3:] - (limits.R_GP.T @ limits.center_G)[:, None]
        found["com_G"] = along[:3, 0], along[:3, 1]
        found["com_shift_P"] = [None if flag else part for flag, part in zip(known.com_P, shift, strict=True)]
    if not (known.k1 and known.k2):
        # about the middle, and half way to the ends along a free direction: of several the first suffices, as
        # a needle or a disc finds room about any of them
        middle = extremes.reshape(-1, 3).mean(axis=0)
        free = extremes[3:][~known.com_P][:1].reshape(-1, 3)
        centers = np.concatenate([middle[None], middle + 0.5 * (free - middle)])
        ratios = ratio_intervals(hull.points(POINTS), centers, limits, given.max_density_ratio)
        bounds.append(
            "inertia of a mass inside that hull whose density is from 0 to "
            f"{given.max_density_ratio:g} times the mean (backend.bounds.max_density_ratio)"
        )
        if ratios is None:
            doubts.append(
                "no intervals of k1 and k2: no mass inside the hull of the body has an inertia that fits the "
                "motion"
            )
        else:
            if given.equal_moments != "none":
                equal = 0 if given.equal_moments == "largest" else 1
                ratios.low[equal] = ratios.high[equal] = 0.0
                bounds.append(f"the {given.equal_moments} moments are equal (backend.bounds.equal_moments)")
            for n, name in enumerate(("k1", "k2")):
                if not getattr(known, name):
                    found[name] = max(float(ratios.low[n]), 0.0), float(ratios.high[n])
    return Intervals.model_validate({**found, "bounds": bounds}), doubts
