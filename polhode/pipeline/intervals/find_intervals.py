"""The intervals of what a run's motion does not determine (docs/run_directory.md, "Intervals").

A component that the motion determines has a standard deviation and no interval. The others have the interval
that the body's hull leaves: the centre of mass lies inside it, and the inertia is that of a mass inside it.
"""

import logging

import numpy as np

from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.config.backend_settings import Backend, Bounds
from polhode.geometry.lie import Array, Bools
from polhode.pipeline.intervals.body_hull import BodyHull, body_hull
from polhode.pipeline.intervals.inertia_ratios import RatioIntervals, ratio_intervals
from polhode.pipeline.intervals.motion_limits import MotionLimits, com_extremes, motion_limits
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
    known = estimate.mass.identifiable
    if not config.bounds.intervals or (known.k1 and known.k2 and known.com):
        return None, []
    hull = body_hull(surface, estimate.landmarks, coverage)
    if hull is None or estimate.covariance_last_body is None:
        return None, ["no intervals: there is no hull of the body, which the surface or the landmarks give"]
    J_G, by_parameters = inertia_by_parameters(estimate.mass.J_G, FORMS[config.inertia])
    limits = motion_limits(
        estimate.mass.com_G,
        estimate.mass.R_GP,
        J_G,
        by_parameters,
        estimate.covariance_last_body,
        estimate.mass.R_GP @ estimate.w_P[-1],
        2.0 * hull.radius_m,
    )
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
    along = np.einsum("nk,nsk->ns", directions, extremes)
    shift = along[3:] - (limits.R_GP.T @ limits.center_G)[:, None]
    ratios = None
    if not (known.k1 and known.k2):
        centers = _centers(extremes, limits, known)
        ratios = ratio_intervals(hull.points(POINTS), centers, limits, given.max_density_ratio)
        bounds.append(
            "inertia of a mass inside that hull whose density is from 0 to "
            f"{given.max_density_ratio:g} times the mean (backend.bounds.max_density_ratio)"
        )
    if ratios is not None and given.equal_moments != "none":
        ratios.high[0 if given.equal_moments == "largest" else 1] = 0.0
        ratios.low[0 if given.equal_moments == "largest" else 1] = 0.0
        bounds.append(f"the {given.equal_moments} moments are equal (backend.bounds.equal_moments)")
    found = {
        "com_G": None if known.com else (along[:3, 0], along[:3, 1]),
        "com_shift_P": None if known.com else _where_unknown(known.com_P, shift),
        "k1": _ratio_interval(ratios, 0, known.k1),
        "k2": _ratio_interval(ratios, 1, known.k2),
        "bounds": bounds,
    }
    doubts = []
    if ratios is None and not (known.k1 and known.k2):
        doubts.append(
            "no intervals of k1 and k2: no mass inside the hull of the body has an inertia that fits the "
            "motion"
        )
    return Intervals.model_validate(found), doubts


def _where_unknown(known: Bools, parts: Array) -> list[Array | None]:
    return [None if flag else part for flag, part in zip(known, parts, strict=True)]


def _centers(extremes: Array, limits: MotionLimits, known: Identifiability) -> Array:
    """Centres of mass (n, 3) about which the ratios are sought: the middle, and some around it."""
    middle = extremes.reshape(-1, 3).mean(axis=0)
    # of several free directions the first suffices: a needle or a disc finds room about any of them
    free = extremes[3:][~known.com_P][:1].reshape(-1, 3)
    return np.concatenate([middle[None], middle + 0.5 * (free - middle)])


def _ratio_interval(
    ratios: RatioIntervals | None, which: int, determined: bool
) -> tuple[float, float] | None:
    if ratios is None or determined:
        return None
    return max(float(ratios.low[which]), 0.0), float(ratios.high[which])
