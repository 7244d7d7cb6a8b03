"""The filter on the recorded poses of approaches: sizes of errors from other bodies, and errors on arrival.

The filter knows how far single edges are off, over what is stated of them, and the whole surface,
over the mesh's sigma. For the flights to one body these sizes are those with which the poses of the flights
to all other bodies are most probable. Meshes of some bodies are worse than those of others, so that the
covariance that is promised on arrival is stretched besides, in each of its parts, by the factor with which
95 % of the flights to the other bodies arrive within it (split conformal prediction: Vovk, Gammerman and
Shafer, Algorithmic Learning in a Random World, 2005).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from lab.navigation.approach_flights import (
    GATE,
    Flight,
    Weights,
    next_state,
    promised,
    sized,
    started,
)
from lab.navigation.body_filter import MeasuredPose, arrival_covariance, update
from lab.navigation.inspections import SIZE_M
from lab.navigation.mesh_errors import UNSEEN, PoseErrors
from polhode.geometry.lie import Array, inverse_pose
from polhode.planning.edges.observability_metric import motion_scale, pose_error
from polhode.planning.prediction import nominal_motion

FITTED_SHARE = 0.9
"""Of the poses, from which sizes are estimated"""
UNOBSERVED_SIGMA = 5e-3
"""[half sizes of the body, rad] Directions that the image's noise leaves so uncertain are not used: a turn of
a body of revolution about its axis brings edges to where others were, and the tracker settles anywhere"""
CONFIDENCE = 0.95
"""Of the region that is promised"""
POSITION, ATTITUDE, VELOCITY, RATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


@dataclass(frozen=True)
class Arrival:
    """The end of a flight."""

    error: Array
    """(12,) of the pose in the camera (``pose_error``), v_N, w_G"""
    covariance: Array
    """(12, 12) by the filter itself"""
    taken: int
    """poses that passed the gate"""

    @property
    def sizes(self) -> Array:
        """(3,) of the errors of position [m], attitude [rad], rate [rad/s]."""
        return np.array([np.linalg.norm(self.error[part]) for part in (POSITION, ATTITUDE, RATE)])


def errors_of_poses(flight: Flight) -> Array:
    """(T, 6) of the tracked poses, without the prediction's part in them."""
    pairs = zip(flight.X_RG, flight.true_X_RG, strict=True)
    off = np.array([pose_error(found, true, flight.known.centre_G) for found, true in pairs])
    return np.asarray(off + flight.beyond)


def without_unobserved(flight: Flight) -> Flight:
    """The flight, its poses without the directions that their edges hardly determine."""
    way = replace(flight.way, expected=tuple(map(_usable, flight.way.expected)))
    return replace(flight, way=way, found=tuple(map(_usable, flight.found)))


def _usable(errors: PoseErrors) -> PoseErrors:
    unit = motion_scale(0.5 * SIZE_M)
    variances, directions = np.linalg.eigh(errors.noise / np.outer(unit, unit))
    weak = unit[:, None] * directions[:, variances > UNOBSERVED_SIGMA**2]
    return replace(errors, noise=errors.noise + UNSEEN**2 * weak @ weak.T)


def arrival(flight: Flight, errors: Sequence[PoseErrors], weights: Weights) -> Arrival:
    """Of a filter that gives the poses these errors."""
    known, way = flight.known, flight.way
    X_NG = nominal_motion(known.estimate, way.time_s).X_NG
    sizes = [sized(each, weights) for each in errors]
    bias = tuple(size[1] for size in sizes)
    state, taken = started(known, way, bias[0], weights.outward * known.sigma_m), 0
    for k, camera in enumerate(way.X_NR):
        if k:
            state = next_state(state, known, way, k, bias, X_NG)
        if flight.shown[k]:
            pose = MeasuredPose(flight.X_RG[k], sizes[k][0], errors[k].outward, flight.beyond[k])
            after = update(state, camera, pose, known.centre_G, GATE)
            state, taken = after.state, taken + after.taken
    pose_off = pose_error(inverse_pose(way.X_NR[-1]) @ state.X_NG, flight.true_X_RG[-1], known.centre_G)
    error = np.concatenate([pose_off, state.v_N - flight.true_v_N, state.w_G - flight.true_w_G])
    return Arrival(error, arrival_covariance(state, way.X_NR[-1], known.centre_G), taken)


def promise(flight: Flight, weights: Weights) -> Array:
    """Covariance (12, 12) on arrival, before there was an image."""
    X_NG = nominal_motion(flight.known.estimate, flight.way.time_s).X_NG
    return promised(flight.known, flight.way, weights, X_NG)


def squared_distance(error: Array, covariance: Array, part: slice) -> float:
    """Squared error (12,) of a part over its covariance (12, 12)."""
    return float(error[part] @ np.linalg.solve(covariance[part, part], error[part]))


def stretch(arrivals: Sequence[Arrival], promises: Sequence[Array]) -> Array:
    """(12,) factors of the promised sigmas with which ``CONFIDENCE`` of these flights arrive within."""
    out = np.ones(12)
    share = min(np.ceil((len(arrivals) + 1) * CONFIDENCE) / len(arrivals), 1.0)
    for part in (POSITION, ATTITUDE, VELOCITY, RATE):
        pairs = zip(arrivals, promises, strict=True)
        squares = [squared_distance(each.error, promised, part) for each, promised in pairs]
        largest = float(np.quantile(squares, share, method="higher"))
        out[part] = np.sqrt(largest / chi2.ppf(CONFIDENCE, part.stop - part.start))
    return out


def fitted_sizes(flights: Sequence[Flight], expected: bool) -> Weights:
    """Sizes of the edges' errors with which the poses are most probable, without the worst tenth.

    That of the noise is given: from single poses, noise and errors of edges cannot be told apart.

    ``expected``: of the errors that were expected before the flight, not those of the found points.
    """
    off = np.concatenate([errors_of_poses(each)[each.shown] for each in flights])
    parts = [_parts(each, expected) for each in flights]
    noise, edges, outward = (np.concatenate([part[k] for part in parts]) for k in range(3))
    # of the squares, what remains without the worst ones of a normal distribution
    remaining = chi2.cdf(chi2.ppf(FITTED_SHARE, 6), 8) / FITTED_SHARE
    size = np.zeros(2)
    kept = np.ones(len(off), dtype=bool)

    def distances(size: Array) -> tuple[Array, Array]:
        e, o = np.exp(2.0 * size)
        P = Weights.noise**2 * noise + e * edges + o * outward
        return np.einsum("ni,ni->n", off, np.linalg.solve(P, off[..., None])[..., 0]), P

    def improbability(size: Array) -> float:
        square, P = distances(size)
        prior = 0.5 * np.sum((size / 3.0) ** 2)
        return float(0.5 * np.sum((square / remaining + np.linalg.slogdet(P)[1])[kept]) + prior)

    for _ in range(3):
        simplex = size + np.vstack([np.zeros(2), 0.5 * np.eye(2)])
        options = {"xatol": 0.01, "fatol": 0.01, "initial_simplex": simplex}
        size = minimize(improbability, size, method="Nelder-Mead", options=options).x
        square, _ = distances(size)
        kept = square <= np.quantile(square, FITTED_SHARE)
    return Weights(Weights.noise, *(float(each) for each in np.exp(size)))


def _parts(flight: Flight, expected: bool) -> tuple[Array, Array, Array]:
    """Covariances (n, 6, 6) of the poses that are shown, for sizes of one."""
    every = flight.way.expected if expected else flight.found
    errors = [each for each, shown in zip(every, flight.shown, strict=True) if shown]
    sigma_m = flight.known.sigma_m
    sizes = [sized(each, Weights(1.0, 1.0, 1.0)) for each in errors]
    noise, edges = ([size[k] for size in sizes] for k in range(2))
    outward = [sigma_m**2 * np.outer(each.outward, each.outward) for each in errors]
    return np.reshape(noise, (-1, 6, 6)), np.reshape(edges, (-1, 6, 6)), np.reshape(outward, (-1, 6, 6))
