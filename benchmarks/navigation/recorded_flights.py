"""Filters on recorded poses: how they weigh a pose, their tuning on other runs, their errors.

The constant covariance is that of the training runs' errors, without the worst twentieth; every filter's
covariance is then multiplied by the factor that gives the least errors there. So are the least share of found
edges and the largest residual chosen: each filter gets what is best for it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Protocol

import numpy as np

from benchmarks.edges.observability_tables import roc_area
from benchmarks.edges.tracking.calibrated_covariance import EdgeNoise, NoiseParts, fitted, nees
from benchmarks.navigation.error_state_filter import predict, update
from benchmarks.navigation.flights import STEP_S, SimulatedFlight, flight
from benchmarks.navigation.found_poses import TrackedPose, from_line
from benchmarks.record import Case, measured
from polhode.lie import Array
from polhode.planning.edges.observability_metric import pose_error


class Weighting(Protocol):
    """From a tracked pose to the information that a filter gives it."""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """(6, 6), or None: not used."""
        ...


@dataclass(frozen=True)
class Fixed:
    """Every pose alike."""

    information: Array
    """(6, 6)"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The constant."""
        return self.information


@dataclass(frozen=True)
class Gated:
    """Every pose alike, if enough of its edges were found: the binary metric."""

    information: Array
    """(6, 6)"""
    min_found: float
    """share of control points"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The constant, or None for a pose of few edges."""
        return self.information if tracked.found_share >= self.min_found else None


@dataclass(frozen=True)
class Calibrated:
    """Each pose by the covariance of its own view."""

    variance_factor: float = 1.0
    """by which covariances are multiplied"""

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """Of the view; None where it tells nothing."""
        return tracked.information / self.variance_factor if tracked.information.any() else None


@dataclass(frozen=True)
class ResidualChecked:
    """Another weighting, without the poses at which edges do not lie where they should.

    A tracker that converged on a wrong pose reports a small covariance all the same; its residuals tell.
    """

    weighting: Weighting
    max_residual: float

    def __call__(self, tracked: TrackedPose) -> Array | None:
        """The other's answer, or None for a pose with large residuals."""
        return self.weighting(tracked) if tracked.residual <= self.max_residual else None


FILTERS = ("fixed", "gated", "calibrated")
_flight = cache(flight)
SETTLED_S = 10.0
"""Errors count from here on."""
REFUSALS = 3
"""After so many in a row the next pose passes any gate, so that a filter that is lost can recover."""
FACTORS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
QUANTILES = (0.03, 0.06, 0.12, 0.25, 0.5)
"""Of the training poses that a threshold would leave out."""
WRONG_NEES = 100.0
"""Squared error over the calibrated covariance, 6 on average, from which a pose is wrong."""
PARTS = ("position [mm]", "velocity [mm/s]", "attitude [deg]", "rate [deg/s]")
UNITS = np.array([1e3, 1e3, 180.0 / np.pi, 180.0 / np.pi])


@dataclass(frozen=True)
class Run:
    """A flight with what was tracked at each instant; None where nothing was."""

    flight: SimulatedFlight
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


@dataclass(frozen=True)
class PoseCalibration:
    """How poses get their covariance."""

    levels: EdgeNoise
    """of the calibrated covariance"""
    statistic: str
    """that detects wrong poses"""


def runs_of(record: Path, cases: Sequence[Case], wrong: float, calibration: PoseCalibration) -> list[Run]:
    """The recorded runs of these cases.

    wrong: share of images, drawn by the run's seed, whose pose is the one that a bad start gave.
    """
    runs = []
    for line in measured(record, cases):
        course = _flight(**{key: line["case"][key] for key in ("scenario", "body", "seed")})
        rng = np.random.default_rng([line["case"]["seed"], 0x3A0])
        poses: list[TrackedPose | None] = []
        for usual, bad in zip(line["poses"], line["bad"], strict=True):
            chosen = bad if rng.random() < wrong else usual
            found = from_line(chosen) if chosen else None
            radius_m = course.target.radius_m
            poses.append(
                found.tracked(calibration.levels, calibration.statistic, radius_m) if found else None
            )
        runs.append(Run(course, poses))
    return runs


def calibrate(record: Path, cases: Sequence[Case]) -> tuple[PoseCalibration, dict[str, float]]:
    """The noise levels that explain usual poses, and the statistic that detects the others.

    Levels: greatest likelihood over all but the poses that they explain worst, a tenth of them. The numbers
    are the areas under the ROC curve of each statistic, over usual poses and bad ones, and the share of poses
    that are wrong: errors beyond WRONG_NEES.
    """
    poses, errors, usual = [], [], []
    for line in measured(record, cases):
        course = _flight(**{key: line["case"][key] for key in ("scenario", "body", "seed")})
        for kind in "poses", "bad":
            for k, each in enumerate(line[kind]):
                if each is not None:
                    poses.append(from_line(each))
                    errors.append(pose_error(poses[-1].X_RG, course.X_RG(k), course.target.o_G))
                    usual.append(kind == "poses")
    off, normal = np.array(errors), np.array(usual)
    noise = NoiseParts(
        np.concatenate([pose.noise.parts for pose in poses]),
        np.concatenate([pose.noise.residual_px for pose in poses]),
    )
    scale = np.sqrt(np.median(off[normal] ** 2, axis=0))
    whole = np.array(
        [np.linalg.matrix_rank(each) == 6 for each in noise.parts[:, 0] / np.outer(scale, scale)]
    )
    kept = normal & whole
    for _ in range(8):
        levels = fitted(NoiseParts(noise.parts[kept], noise.residual_px[kept]), off[kept])
        distance = np.full(len(off), np.inf)
        distance[whole] = nees(
            off[whole], levels.covariance(NoiseParts(noise.parts[whole], noise.residual_px[whole]))
        )
        kept = normal & (distance <= np.quantile(distance[normal], 0.9))
    wrong = distance > WRONG_NEES
    areas = {
        name: roc_area(np.array([pose.doubts[name] for pose in poses])[whole], wrong[whole])
        for name in poses[0].doubts
    }
    numbers = {f"area: {name}": area for name, area in areas.items()}
    numbers |= {"usual wrong": float(wrong[normal].mean()), "bad wrong": float(wrong[~normal].mean())}
    return PoseCalibration(levels, max(areas, key=lambda name: areas[name])), numbers


def fly(run: Run, weighting: Weighting, gate: float | None) -> Flown:
    """Follow a run from its first state with the covariance that it was drawn from."""
    course, state = run.flight, run.flight.start
    errors, sigma, nees_of, tracked, taken, refused = [], [], [], 0, 0, 0
    for k, pose in enumerate(run.poses):
        if k > 0:
            state = predict(state, course.target, STEP_S, course.accel_N[k - 1])
        information = None if pose is None else weighting(pose)
        tracked += pose is not None
        if pose is not None and information is not None:
            used = gate if refused < REFUSALS else None
            after = update(state, course.target, course.R_NR[k], pose.X_RG, information, used)
            state = after.state
            taken += after.taken
            refused = 0 if after.taken else refused + 1
        errors.append(state.error(course.states[k]))
        sigma.append(np.sqrt(np.diag(state.covariance)))
        nees_of.append(state.nees(course.states[k]))
    late = slice(round(SETTLED_S / STEP_S), None)
    off = np.array(errors)
    squares = (off[late].reshape(-1, 4, 3) ** 2).sum(axis=2).mean(axis=0)
    return Flown(squares, float(np.mean(nees_of[late])) / 12.0, taken / max(tracked, 1), off, np.array(sigma))


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
    information = np.asarray(np.linalg.inv(constant_covariance(runs)), dtype=np.float64)
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
