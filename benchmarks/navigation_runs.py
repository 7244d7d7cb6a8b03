"""Filters of benchmarks/navigation_filter.py on recorded poses: their tuning on other runs, their errors.

The constant covariance is that of the training runs' errors, without the worst twentieth; every filter's
covariance is then multiplied by the factor that gives the least errors there. So are the least share of found
edges and the largest residual chosen: each filter gets what is best for it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.found_pose import from_line
from benchmarks.navigation_scene import STEP_S, Flight, flight
from benchmarks.record import Case, measured
from planning.observability.edge_motion import pose_error
from planning.observability.navigation_filter import predict, update
from planning.observability.pose_weights import (
    Calibrated,
    Fixed,
    Gated,
    ResidualChecked,
    TrackedPose,
    Weighting,
)
from polhode.lie import Array

FILTERS = ("fixed", "gated", "calibrated")
SETTLED_S = 10.0
"""Errors count from here on."""
REFUSALS = 3
"""After so many in a row the next pose passes any gate: a filter that is lost must find back."""
FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
QUANTILES = (0.03, 0.06, 0.12, 0.25, 0.5)
"""Of the training poses that a threshold would leave out."""
SIGMAS_PX = (0.02, 0.05, 0.1, 0.2, 0.4)
TAUS_PX = (0.0, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0)
PARTS = ("position [mm]", "velocity [mm/s]", "attitude [deg]", "rate [deg/s]")
UNITS = np.array([1e3, 1e3, 180.0 / np.pi, 180.0 / np.pi])


@dataclass(frozen=True)
class Run:
    """A flight with what was tracked at each instant; None where nothing was."""

    flight: Flight
    poses: list[TrackedPose | None]


@dataclass(frozen=True)
class Flown:
    """A filter's run."""

    squares: Array
    """(4,) mean squared errors of position, velocity, attitude, rate [SI]"""
    nees: float
    """mean over 12"""
    taken: float
    """share of the tracked poses that were used"""
    errors: Array
    """(T, 12)"""
    sigma: Array
    """(T, 12) of its covariance"""


def runs_of(record: Path, cases: Sequence[Case], wrong: float, errors: tuple[float, float]) -> list[Run]:
    """The recorded runs of these cases.

    wrong: share of images, drawn by the run's seed, whose pose is the one that a bad start gave. errors: the
    least sigma and the tau of edges [px].
    """
    runs = []
    for line in measured(record, cases):
        course = _flight(line["case"])
        rng = np.random.default_rng([line["case"]["seed"], 0x3A0])
        poses: list[TrackedPose | None] = []
        for usual, bad in zip(line["poses"], line["bad"], strict=True):
            chosen = bad if rng.random() < wrong else usual
            found = None if chosen is None else from_line(chosen)
            poses.append(
                found and found.tracked(max(errors[0], found.sigma_px), errors[1], course.target.radius_m)
            )
        runs.append(Run(course, poses))
    return runs


def calibrated_errors(record: Path, cases: Sequence[Case]) -> tuple[float, float]:
    """Least sigma and tau [px] under which the poses of training runs are most likely.

    Of the nine tenths that they explain best, so that wrong poses do not count.
    """

    def surprise(errors: tuple[float, float]) -> float:
        each = []
        for run in runs_of(record, cases, 0.0, errors):
            for k, pose in enumerate(run.poses):
                if pose is not None:
                    off = pose_error(pose.X_RG, run.flight.X_RG(k), run.flight.target.o_G)
                    sign, size = np.linalg.slogdet(pose.information)
                    each.append(off @ pose.information @ off - size if sign > 0.0 else np.inf)
        return float(np.sort(each)[: int(0.9 * len(each))].mean())

    return min(product(SIGMAS_PX, TAUS_PX), key=surprise)


def _flight(case: Case) -> Flight:
    return _cached_flight(case["scenario"], case["body"], case["seed"])


@cache
def _cached_flight(scenario: str, body: str, seed: int) -> Flight:
    return flight(scenario, body, seed)


def fly(run: Run, weighting: Weighting, gate: float | None) -> Flown:
    """Follow a run from its first state with the covariance that it was drawn from."""
    course, state = run.flight, run.flight.start
    errors, sigma, nees, tracked, taken, refused = [], [], [], 0, 0, 0
    for k, pose in enumerate(run.poses):
        if k > 0:
            state = predict(state, course.target, STEP_S, course.accel_N[k - 1])
        believed = None if pose is None else weighting(pose)
        tracked += pose is not None
        if pose is not None and believed is not None:
            used = gate if refused < REFUSALS else None
            after = update(state, course.target, course.R_NR[k], pose.X_RG, believed, used)
            state = after.state
            taken += after.taken
            refused = 0 if after.taken else refused + 1
        errors.append(state.error(course.states[k]))
        sigma.append(np.sqrt(np.diag(state.covariance)))
        nees.append(state.nees(course.states[k]))
    late = slice(round(SETTLED_S / STEP_S), None)
    off = np.array(errors)
    squares = (off[late].reshape(-1, 4, 3) ** 2).sum(axis=2).mean(axis=0)
    return Flown(squares, float(np.mean(nees[late])) / 12.0, taken / max(tracked, 1), off, np.array(sigma))


def cost(runs: Sequence[Run], weighting: Weighting, gate: float | None) -> float:
    """Logarithm of the product of the four errors, root mean square over runs."""
    return float(np.log(np.mean([fly(run, weighting, gate).squares for run in runs], axis=0)).sum())


def errors_of_poses(runs: Sequence[Run]) -> Array:
    """(n, 6) of all tracked poses: shift of o [m], turn [rad] in R."""
    return np.array(
        [
            pose_error(pose.X_RG, run.flight.X_RG(k), run.flight.target.o_G)
            for run in runs
            for k, pose in enumerate(run.poses)
            if pose is not None
        ]
    )


def constant_covariance(runs: Sequence[Run], left_out: float = 0.05) -> Array:
    """(6, 6) of the errors of poses, without the share that is farthest off in its own measure."""
    errors = errors_of_poses(runs)
    kept = errors
    for _ in range(10):
        second = kept.T @ kept / len(kept)
        distance = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(second), errors)
        kept = errors[distance <= np.quantile(distance, 1.0 - left_out)]
    return np.asarray(kept.T @ kept / len(kept))


@dataclass(frozen=True)
class Tuned:
    """The best of each filter on the training runs."""

    weightings: dict[str, Weighting]
    """by filter; with "+ residual" the poses of large residuals are left out"""
    numbers: dict[str, float]


def tune(runs: Sequence[Run], gate: float | None) -> Tuned:
    """Choose factors and thresholds by `cost`."""
    information = np.linalg.inv(constant_covariance(runs))
    poses = [pose for run in runs for pose in run.poses if pose is not None]
    found = np.quantile([pose.found_share for pose in poses], QUANTILES)
    residuals = np.quantile([pose.residual for pose in poses], 1.0 - np.array(QUANTILES))
    numbers: dict[str, float] = {}
    weightings: dict[str, Weighting] = {}

    def best(values: Sequence[float], make: Callable[[float], Weighting]) -> float:
        return min(values, key=lambda value: cost(runs, make(value), gate))

    factor = best(FACTORS, lambda s: Fixed(information / s))
    weightings["fixed"] = Fixed(information / factor)
    numbers["fixed factor"] = factor
    least = best([0.0, *found], lambda share: Gated(information / factor, share))
    again = best(FACTORS, lambda s: Gated(information / s, least))
    weightings["gated"] = Gated(information / again, least)
    numbers |= {"gated factor": again, "gated least found": least}
    factor = best(FACTORS, Calibrated)
    weightings["calibrated"] = Calibrated(factor)
    numbers["calibrated factor"] = factor
    for name in FILTERS:
        plain = weightings[name]
        most = best([np.inf, *residuals], lambda limit, plain=plain: ResidualChecked(plain, limit))  # type: ignore[misc]
        weightings[f"{name} + residual"] = ResidualChecked(plain, most)
        numbers[f"{name} most residual"] = most
    return Tuned(weightings, numbers)
