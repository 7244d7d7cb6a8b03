"""An approach after an inspection: planned with the metric, flown on rendered images, and recorded.

The inspector waits for a while after the last pair, so that the tumble has another phase, and starts from a
place of the seed's, 2.4 m from the target. It compares several straight ways to 1.5 m and takes that which
promises the least covariance of the pose on arrival, by the metric of the edges that the Sun will show along
the predicted tumble. Images of the true body are rendered along the way and tracked from the filter's own
prediction. The line of a flight has all that filters need, so that others can be compared on the same poses.

Truth and estimate have frames G of their own; what all pairs of the inspection have in common aligns them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lab.edges.trials import LENS
from lab.edges.views import EdgeBody, EdgeViews, ViewOptions, edge_rig
from lab.navigation.body_filter import (
    BodyState,
    MeasuredPose,
    arrival_covariance,
    first_state,
    measured_jacobian,
    predict,
    update,
)
from lab.navigation.inspections import (
    Inspection,
    inspection,
    poses_of_run,
    true_frame,
)
from lab.navigation.mesh_errors import PoseErrors, covariance_of, pose_errors
from lab.record import Case
from polhode.config.loader import load_config
from polhode.files.images import Grey
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, make_pose, transform_points
from polhode.planning.edges.edge_refinement import RefinedEdges
from polhode.planning.edges.measured_edges import measured_edge_model
from polhode.planning.edges.observability_metric import moved, pose_error
from polhode.planning.edges.tracking import PosePrior, TrackedPose, TrackingOptions, track_edges
from polhode.planning.edges.visible_edges import SPACING_PX, control_points, in_sunlight
from polhode.planning.observability.assess import refined_edges_of_run
from polhode.planning.plan import final_estimate, surface_of
from polhode.planning.prediction import FinalEstimate, FinalState, nominal_motion
from polhode.records.metrics import truth_at
from polhode.records.read_truth import read_truth
from polhode.run_directory.trajectory_file import target_poses
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import build_body
from polhode.studies.flat_metrics import as_json

START_M, END_M, ASIDE_DEG = 2.4, 1.5, 60.0
"""Range at both ends, and how far the start is from the place of the inspection, seen from the target"""
WAYS, WITHIN_DEG = 6, 50.0
"""Ways that are compared, and how far around the target they lead"""
STEP_S, IMAGES = 4.0, 8
MAX_WAIT_S = 24.0
RIG = edge_rig(500.0, 400, 400)
FLOOR_PX = 0.15
"""Sigma of an edge in the image however clear it is and however well its place on the body is known"""
TURN_OF_BIAS_RAD = 0.5
"""Turn of the view after which the common error of the poses is forgotten to 1 / e"""
GATE = 0.999
OVERSTATED = 3.0
"""How much better a pose is, by the tracker's information, than it turns out, as edges share errors: the
prediction weighs so much more in the tracker. Filters get the pose without it (``Flight.beyond``)"""
MIN_EDGES = 12
"""Of a model that is flown to"""
DRAWN_STARTS, CONTENT = 5, 0.6
"""Starts besides the predicted pose, until the image confirms so much of the edges"""
MIN_AGREEMENT = 0.35
"""Of a tracked pose that is shown to the filter: the mesh lacks edges, and has others"""


@dataclass(frozen=True)
class Weights:
    """Sizes of the three kinds of errors."""

    noise: float = 1.0
    """of the image's, over what is stated"""
    edges: float = 3.0
    """of the displacements of single edges, over what is stated"""
    outward: float = 0.1
    """of the displacement of the whole surface, over the mesh's sigma"""


@dataclass(frozen=True)
class Known:
    """What a run knows, as far as an approach needs it."""

    estimate: FinalEstimate
    centre_G: Array
    """(3,) of the mesh: the point whose place is estimated"""
    sigma_m: float
    """of a place on an edge: of the mesh, and of its simplification to edges"""


@dataclass(frozen=True)
class Way:
    """Cameras, and the errors that poses will have there."""

    time_s: Array
    """(T,) after the last pair"""
    X_NR: Array
    """(T, 4, 4)"""
    expected: tuple[PoseErrors, ...]
    """(T,)"""


@dataclass(frozen=True)
class Flight:
    """What was flown, and what happened."""

    known: Known
    way: Way
    X_RG: Array
    """(T, 4, 4) tracked"""
    beyond: Array
    """(T, 6) steps from there to what the edges would give without the filter's prediction"""
    found: tuple[PoseErrors, ...]
    """(T,) of the tracked poses, by the points that were found"""
    agreement: Array
    """(T,) 0: the tracker did not converge"""
    true_X_RG: Array
    """(T, 4, 4)"""
    true_v_N: Array
    """(3,) on arrival"""
    true_w_G: Array
    """(3,) on arrival"""

    @property
    def shown(self) -> Bools:
        """(T,) which poses a filter gets to see."""
        return np.asarray(self.agreement >= MIN_AGREEMENT)


@dataclass(frozen=True)
class Truth:
    """What the images show, at the instants of a way."""

    body: EdgeBody
    X_NB: Array
    """(T, 4, 4) pose of the body's own frame"""
    X_BG: Array
    """(4, 4) the run's frame G in it"""
    v_N: Array
    """(3,) of the true centre of mass on arrival"""
    w_G: Array
    """(3,) on arrival, along the run's G"""


def next_state(
    state: BodyState, known: Known, way: Way, k: int, bias: tuple[Array, ...], X_NG: Array
) -> BodyState:
    """The state at image k from that before; X_NG (T, 4, 4) predicted before the flight."""
    before = inverse_pose(way.X_NR[k - 1])[:3, :3] @ X_NG[k - 1, :3, :3]
    after = inverse_pose(way.X_NR[k])[:3, :3] @ X_NG[k, :3, :3]
    turn = np.arccos(np.clip(0.5 * (np.trace(after @ before.T) - 1.0), -1.0, 1.0))
    kept = float(np.exp(-turn / TURN_OF_BIAS_RAD))
    return predict(state, known.estimate, float(way.time_s[k] - way.time_s[k - 1]), bias[k], kept)


def started(known: Known, way: Way, bias: Array, outward_m: float) -> BodyState:
    """The state at the first image."""
    state = first_state(known.estimate, bias, outward_m)
    return predict(state, known.estimate, float(way.time_s[0]), bias, 1.0)


def sized(errors: PoseErrors, weights: Weights) -> tuple[Array, Array]:
    """Covariances (6, 6) of what is new in an image, and of what nearby views have in common."""
    return weights.noise**2 * errors.noise, weights.edges**2 * errors.edges


def promised(known: Known, way: Way, weights: Weights, X_NG: Array) -> Array:
    """Covariance (12, 12) on arrival, before there is an image: every pose is found, where it is expected."""
    sizes = [sized(each, weights) for each in way.expected]
    bias = tuple(size[1] for size in sizes)
    state = started(known, way, bias[0], weights.outward * known.sigma_m)
    for k, (camera, errors) in enumerate(zip(way.X_NR, way.expected, strict=True)):
        if k:
            state = next_state(state, known, way, k, bias, X_NG)
        pose = MeasuredPose(inverse_pose(camera) @ state.X_NG, sizes[k][0], errors.outward, np.zeros(6))
        state = update(state, camera, pose, known.centre_G).state
    return arrival_covariance(state, way.X_NR[-1], known.centre_G)


@lru_cache(maxsize=6)
def known_of(inspected: Inspection) -> tuple[Known, RefinedEdges]:
    """The end of a run, and the edges of its mesh, where the images have them.

    Raises InputError where the images confirm too few.
    """
    estimate, _ = final_estimate(inspected.run)
    surface = surface_of(inspected.run)
    model = measured_edge_model(surface.mesh, surface.sigma_m)
    sigma = surface.sigma_m[np.isfinite(surface.sigma_m)]
    sigma_m = float(np.hypot(np.median(sigma), 0.5 * model.tolerance_m))
    edges = refined_edges_of_run(inspected.run, inspected.sequence)
    if edges.model.size < MIN_EDGES:
        raise InputError(f"the images confirm {edges.model.size} of {model.size} edges of the mesh")
    return Known(estimate, model.centre_G, sigma_m), edges


def planned(known: Known, edges: RefinedEdges, sun_N: Array, seed: int) -> Way:
    """The best of the ways that a seed's start offers."""
    model = edges.model
    rng = np.random.default_rng([seed, 0xA99])
    time_s: Array = rng.uniform(2.0, MAX_WAIT_S) + STEP_S * np.arange(IMAGES, dtype=np.float64)
    X_NG = nominal_motion(known.estimate, time_s).X_NG
    o_N = X_NG[:, :3, :3] @ model.centre_G + X_NG[:, :3, 3]
    back = -o_N[0] / np.linalg.norm(o_N[0])
    start = _aside(back, np.deg2rad(ASIDE_DEG) * np.sqrt(rng.uniform()), rng.uniform(0.0, 2.0 * np.pi))
    best, least = None, np.inf
    for X_NR in _ways(start, o_N):
        expected = tuple(
            _expected(edges, inverse_pose(camera) @ pose, sun_N, camera)
            for camera, pose in zip(X_NR, X_NG, strict=True)
        )
        way = Way(time_s, X_NR, expected)
        pose = promised(known, way, Weights(), X_NG)[:6, :6]
        size = float(np.trace(pose[:3, :3]) / model.radius_m**2 + np.trace(pose[3:, 3:]))
        if best is None or size < least:
            best, least = way, size
    assert best is not None
    return best


def _expected(edges: RefinedEdges, X_RG: Array, sun_N: Array, X_NR: Array) -> PoseErrors:
    """Of a view of the predicted body, with the edges that have contrast in sunlight."""
    model = edges.model
    points = control_points(model, RIG, X_RG, SPACING_PX)
    X_GR = inverse_pose(X_RG)
    points = in_sunlight(model, points, X_GR[:3, 3], X_GR[:3, :3] @ X_NR[:3, :3].T @ sun_N)
    z = transform_points(X_RG, points.p_G)[:, 2]
    sigma_px = np.hypot(FLOOR_PX, RIG.focal_px * edges.sigma_m[points.feature] / z)
    return pose_errors(edges, RIG, X_RG, points, points.weight / sigma_px**2)


def _ways(start: Array, o_N: Array) -> Iterator[Array]:
    """Camera poses X_NR (T, 4, 4) from the unit direction ``start`` (3,) of the target o_N (T, 3)."""
    share = np.linspace(0.0, 1.0, len(o_N))
    begin = o_N[0] + START_M * start
    for number in range(WAYS):
        # evenly over the cap, by the golden angle
        angle = np.deg2rad(WITHIN_DEG) * np.sqrt(number / (WAYS - 1))
        end = o_N[-1] + END_M * _aside(start, angle, number * np.pi * (3.0 - np.sqrt(5.0)))
        place = begin + share[:, None] * (end - begin)
        ahead = o_N - place
        ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
        level = np.cross([0.0, 1.0, 0.0], ahead)
        level /= np.linalg.norm(level, axis=1, keepdims=True)
        yield make_pose(np.stack([level, np.cross(ahead, level), ahead], axis=2), place)


def _aside(direction: Array, angle_rad: float, around_rad: float) -> Array:
    """A unit direction (3,) so far from another one."""
    across = np.cross(direction, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(across, direction)
    axis = np.cos(around_rad) * across + np.sin(around_rad) * up
    return np.asarray(exp_so3(angle_rad * axis) @ direction)


def flown(inspected: Inspection, seed: int) -> Flight:
    """One flight."""
    known, edges = known_of(inspected)
    model = edges.model
    sun_N = _sun(inspected, seed)
    way = planned(known, edges, sun_N, seed)
    truth = _truth(inspected, known, way)
    views = EdgeViews(truth.body, RIG, seed, ViewOptions(earth=0.2, sensor=LENS))
    X_NG = nominal_motion(known.estimate, way.time_s).X_NG
    weights = Weights()
    found, poses, beyond, agreement = [], [], [], []
    state, bias = None, list[Array]()
    for k, (camera, expected) in enumerate(zip(way.X_NR, way.expected, strict=True)):
        bias.append(sized(expected, weights)[1])
        if state is None:
            state = started(known, way, bias[0], weights.outward * known.sigma_m)
        else:
            state = next_state(state, known, way, k, tuple(bias), X_NG)
        X_RB = inverse_pose(camera) @ truth.X_NB[k]
        image = views.image(X_RB, camera[:3, :3].T @ sun_N, k)
        prior = _prior(state, camera, known, expected.outward)
        tracked = _tracked(edges, image, prior, np.random.default_rng([seed, k]))
        poses.append(tracked.X_RG)
        beyond.append(np.zeros(6))
        agreement.append(tracked.agreement if tracked.converged else 0.0)
        errors = expected
        if tracked.converged:
            noise = covariance_of(tracked.information.C / tracked.scale**2, model.radius_m)
            errors = pose_errors(edges, RIG, tracked.X_RG, tracked.points, tracked.weight, noise)
            beyond[k] = noise @ prior.information @ pose_error(tracked.X_RG, prior.X_RG, known.centre_G)
        found.append(errors)
        if agreement[-1] >= MIN_AGREEMENT:
            own, bias[k] = sized(errors, weights)
            pose = MeasuredPose(tracked.X_RG, own, errors.outward, beyond[k])
            state = update(state, camera, pose, known.centre_G, GATE).state
    return Flight(
        known,
        way,
        np.array(poses),
        np.array(beyond),
        tuple(found),
        np.array(agreement),
        np.array([inverse_pose(a) @ b @ truth.X_BG for a, b in zip(way.X_NR, truth.X_NB, strict=True)]),
        truth.v_N,
        truth.w_G,
    )


def _prior(state: BodyState, X_NR: Array, known: Known, outward: Array) -> PosePrior:
    """Of the pose that a tracker finds, by the filter's prediction."""
    H = measured_jacobian(state, X_NR, known.centre_G, outward)
    off = state.bias + outward * state.outward
    X_RG = moved(inverse_pose(X_NR) @ state.X_NG, off, known.centre_G)
    return PosePrior(X_RG, OVERSTATED**2 * np.linalg.inv(H @ state.covariance @ H.T))


def _tracked(edges: RefinedEdges, image: Grey, prior: PosePrior, rng: np.random.Generator) -> TrackedPose:
    """The pose from the predicted one if the image confirms it, else the best of others as probable."""
    covariance = OVERSTATED**2 * np.linalg.inv(prior.information)
    starts = rng.multivariate_normal(np.zeros(6), covariance, size=DRAWN_STARTS)
    best = None
    for step in (np.zeros(6), *starts):
        options = TrackingOptions(
            ranges_px=(4.0, 4.0),
            restarts=int(best is None),
            floor_px=FLOOR_PX,
            sigma_m=edges.sigma_m,
            prior=prior,
        )
        start = moved(prior.X_RG, step, edges.model.centre_G)
        found = track_edges(edges.model, RIG, image, start, options=options)
        if best is None or (found.converged, found.agreement) > (best.converged, best.agreement):
            best = found
        if best.converged and best.agreement >= CONTENT:
            break
    assert best is not None
    return best


def _sun(inspected: Inspection, seed: int) -> Array:
    """(3,) of the inspection, turned by up to 30 degrees."""
    rng = np.random.default_rng([seed, 0x5A4])
    scene = load_config(inspected.sequence / "scene.yaml").scene
    assert scene is not None
    sun_N = np.array(scene.light.sun_direction_N)
    axis = rng.normal(size=3)
    return np.asarray(exp_so3(np.deg2rad(30.0) * rng.uniform() * axis / np.linalg.norm(axis)) @ sun_N)


def _truth(inspected: Inspection, known: Known, way: Way) -> Truth:
    truth, (timestamps_ns, _) = read_truth(inspected.sequence), poses_of_run(inspected)
    config = load_config(inspected.sequence / "scene.yaml")
    assert config.scene is not None
    X_BG = true_frame(inspected, known.centre_G)
    ahead = truth_at(truth, timestamps_ns[-1] + np.round(1e9 * way.time_s).astype(np.int64))
    return Truth(
        EdgeBody("true", build_body(config.scene.body, config.seed), config.scene.body),
        target_poses(ahead, truth.R_GP, truth.com_G),
        X_BG,
        ahead.v_N[-1],
        X_BG[:3, :3].T @ truth.R_GP @ ahead.w_P[-1],
    )


_UPPER = np.triu_indices(6)


def as_line(flight: Flight) -> dict[str, Any]:
    """Lists of numbers, for a record."""
    last, estimate = flight.known.estimate.last, flight.known.estimate
    return {
        "state": {
            "r_N": last.r_N,
            "v_N": last.v_N,
            "R_NG": last.R_NG,
            "w_G": last.w_G,
            "J_G": last.J_G,
            "J_jacobian": last.J_jacobian,
            "covariance": last.covariance,
            "com_G": estimate.com_G,
            "accel_psd": estimate.accel_psd,
            "torque_psd": estimate.torque_psd,
        },
        "centre_G": flight.known.centre_G,
        "sigma_m": flight.known.sigma_m,
        "time_s": flight.way.time_s,
        "X_NR": flight.way.X_NR,
        "expected": _packed(flight.way.expected),
        "X_RG": flight.X_RG,
        "beyond": flight.beyond,
        "found": _packed(flight.found),
        "agreement": flight.agreement,
        "true_X_RG": flight.true_X_RG,
        "true_v_N": flight.true_v_N,
        "true_w_G": flight.true_w_G,
    }


def from_line(line: dict[str, Any]) -> Flight:
    """The flight of ``as_line``."""
    state = {name: np.array(value) for name, value in line["state"].items()}
    last = FinalState(
        **{name: state[name] for name in ("r_N", "v_N", "R_NG", "w_G", "J_G", "J_jacobian", "covariance")},
        R_GP=np.eye(3),
    )
    estimate = FinalEstimate(last, state["com_G"], float(state["accel_psd"]), float(state["torque_psd"]))
    return Flight(
        Known(estimate, np.array(line["centre_G"]), line["sigma_m"]),
        Way(np.array(line["time_s"]), np.array(line["X_NR"]), _unpacked(line["expected"])),
        np.array(line["X_RG"]),
        np.array(line["beyond"]),
        _unpacked(line["found"]),
        np.array(line["agreement"]),
        np.array(line["true_X_RG"]),
        np.array(line["true_v_N"]),
        np.array(line["true_w_G"]),
    )


def _packed(errors: tuple[PoseErrors, ...]) -> list[list[float]]:
    """(T, 48): upper triangles of both covariances, and the error of the outward displacement."""
    return [[*each.noise[_UPPER], *each.edges[_UPPER], *each.outward] for each in errors]


def _unpacked(rows: list[list[float]]) -> tuple[PoseErrors, ...]:
    return tuple(PoseErrors(_full(row[:21]), _full(row[21:42]), np.array(row[42:])) for row in rows)


def _full(upper: list[float]) -> Array:
    """(6, 6)."""
    out = np.zeros((6, 6))
    out[_UPPER] = upper
    return np.asarray(out + out.T - np.diag(np.diagonal(out)))


@dataclass(frozen=True)
class FlightMeasurement:
    """Measures a case: a body, one of its inspections, and the seed of the flight."""

    inspections: Path
    """Folder that keeps them"""

    def __call__(self, case: Case) -> dict[str, Any]:
        """The line of the flight, or why there was none."""
        inspected = inspection(self.inspections, case["body"], case["inspection"])
        if inspected.error:
            return {"no_flight": f"the inspection failed: {inspected.error}"}
        try:
            return as_json(as_line(flown(inspected, case["seed"])))
        except InputError as error:
            return {"no_flight": str(error)}
