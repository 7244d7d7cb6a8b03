"""The benchmark of the navigation filter: its flights, its drawn poses, its records."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.stats import chi2

from benchmarks.edges.tracking.calibrated_covariance import EdgeNoise, noise_parts
from benchmarks.navigation import recorded_flights
from benchmarks.navigation.compare_filters import draw, errors_table, ratio, wrong_table
from benchmarks.navigation.flights import (
    RIG,
    SCENARIOS,
    body_mesh,
    flight,
    inspector,
    instants,
    sun_R,
)
from benchmarks.navigation.found_poses import EdgeErrors, TrackedPose, drawn_pose, from_line, spread
from benchmarks.navigation.recorded_flights import (
    Calibrated,
    Fixed,
    PoseCalibration,
    ResidualChecked,
    Run,
    constant_covariance,
    fly,
    runs_of,
)
from benchmarks.record import add
from polhode.planning.edges.edge_model import EdgeModel, edge_model
from polhode.planning.edges.observability_metric import edge_motion, moved, pose_error
from polhode.planning.edges.visible_edges import control_points

BODY = "satellite"
TRUE_LEVELS = EdgeNoise((EdgeErrors.sigma_px**2, EdgeErrors.tau_px**2, 0.0), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def model() -> EdgeModel:
    return edge_model(body_mesh(BODY))


def test_the_inspector_flies_as_planned() -> None:
    accel, place, velocity, R_NR = inspector("approach")
    assert np.linalg.norm(place[0]) == 4.0 and np.isclose(np.linalg.norm(place[-1]), 2.0)
    assert np.allclose(velocity[[0, -1]], 0.0, atol=1e-12)
    around = inspector("fly-around")[1]
    assert np.allclose(np.linalg.norm(around, axis=1), 3.0, atol=0.01)
    assert np.allclose(around[0], -around[-1], atol=0.02)
    assert np.allclose(R_NR @ np.swapaxes(R_NR, 1, 2), np.eye(3))
    assert np.allclose(R_NR[:, :, 2], -place / np.linalg.norm(place, axis=1, keepdims=True))
    assert len(accel) == len(instants())


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_target_stays_in_sight(scenario: str) -> None:
    course = flight(scenario, BODY, 3)
    for k in range(0, len(course.states), 10):
        X = course.X_RG(k)
        uv = RIG.project((X @ np.append(course.target.o_G, 1.0))[None, :3])[0]
        assert abs(uv[0] - RIG.cx_px) < 100 and abs(uv[1] - RIG.cy_px) < 100
    assert 0.08 < np.linalg.norm(course.states[0].w_P) < 0.13


def test_spread_is_the_trackers_where_all_is_told(model: EdgeModel) -> None:
    X = flight("approach", BODY, 3).X_RG(0)
    points = control_points(model, RIG, X)
    f = edge_motion(points, RIG, X, model.centre_G)
    sign = np.random.default_rng(0).integers(-1, 2, len(points))
    _, of_edge = np.unique(points.feature, return_inverse=True)
    gain, parts = spread(f, points.weight, of_edge, sign, model.radius_m)
    assert np.allclose(parts, noise_parts(f, points.weight, points.feature, sign), rtol=1e-6, atol=1e-14)
    assert np.allclose(gain @ f, np.eye(6), atol=1e-8)


def test_drawn_poses_have_the_covariance_that_they_claim(model: EdgeModel) -> None:
    course, distances = flight("approach", BODY, 3), []
    for k in range(120):
        at, rng = k % 6 * 10, np.random.default_rng([5, k])
        X = course.X_RG(at)
        found = drawn_pose(model, RIG, X, sun_R(course.R_NR[at]), False, rng, EdgeErrors())
        assert found is not None
        tracked = from_line(json.loads(json.dumps(found.line()))).tracked(
            TRUE_LEVELS, "residual", model.radius_m
        )
        error = pose_error(tracked.X_RG, X, model.centre_G)
        distances.append(error @ tracked.information @ error)
    low, high = chi2.ppf([0.005, 0.995], 6 * len(distances)) / len(distances)
    assert low < np.mean(distances) < high


def test_wrong_poses_are_off_and_leave_residuals(model: EdgeModel) -> None:
    course = flight("approach", BODY, 3)
    off, residual = np.zeros((2, 20)), np.zeros((2, 20))
    for k in range(20):
        X, sun = course.X_RG(3 * k), sun_R(course.R_NR[3 * k])
        for wrong in 0, 1:
            rng = np.random.default_rng([6, k])
            found = drawn_pose(model, RIG, X, sun, bool(wrong), rng, EdgeErrors())
            assert found is not None
            tracked = found.tracked(TRUE_LEVELS, "residual", model.radius_m)
            error = pose_error(tracked.X_RG, X, model.centre_G)
            off[wrong, k], residual[wrong, k] = error @ tracked.information @ error, tracked.residual
    assert off[0].max() < 30.0 < np.median(off[1])
    assert np.median(residual[1]) > 1.5 * np.median(residual[0])


def test_runs_take_bad_poses_by_share_and_filters_use_what_they_believe(
    tmp_path: Path, model: EdgeModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = {"source": "drawn", "scenario": "approach", "body": BODY, "seed": 3}
    course = flight("approach", BODY, 3)
    found = [
        drawn_pose(
            model, RIG, course.X_RG(k), sun_R(course.R_NR[k]), False, np.random.default_rng(k), EdgeErrors()
        )
        for k in range(12)
    ]
    usual = [pose and pose.line() for pose in found]
    bad = [pose and {**pose, "found": -1.0} for pose in usual]
    record = tmp_path / "poses"
    add(record, [{"case": case, "poses": usual, "bad": bad}])
    belief = PoseCalibration(TRUE_LEVELS, "residual")

    def shares(wrong: float) -> list[float]:
        (run,) = runs_of(record, [case], wrong, belief)
        return [pose.found_share for pose in run.poses if pose is not None]

    assert min(shares(0.0)) > 0.0 and max(shares(1.0)) == -1.0
    (run,) = runs_of(record, [case], 0.0, belief)
    monkeypatch.setattr(recorded_flights, "SETTLED_S", 4.0)
    flown = fly(run, Calibrated(), 0.999)
    assert flown.taken == 1.0 and 0.1 < flown.nees < 3.0
    assert np.sqrt(flown.squares[0]) < 0.02 < np.linalg.norm(flown.errors[0, :3]) + 0.02
    blind = fly(run, ResidualChecked(Calibrated(), -1.0), None)
    assert blind.taken == 0.0 and blind.squares[2] > 10.0 * flown.squares[2]


def test_the_constant_covariance_leaves_out_the_worst() -> None:
    course = flight("approach", BODY, 3)
    rng = np.random.default_rng(1)
    poses: list[TrackedPose | None] = []
    for k in range(len(course.states)):
        step = 1e-3 * rng.standard_normal(6) + (1.0 if k == 7 else 0.0)
        X = moved(course.X_RG(k), step, course.target.o_G)
        poses.append(TrackedPose(X, np.eye(6), 1.0, 0.0))
    covariance = constant_covariance([Run(course, poses)])
    assert 0.5e-3 < np.sqrt(covariance[0, 0]) < 1.5e-3


def test_a_lost_filter_finds_back() -> None:
    """Refused poses let the next ones in."""
    course = flight("approach", BODY, 3)
    far = [TrackedPose(course.X_RG(k), np.eye(6) * 1e6, 1.0, 0.0) for k in range(len(course.states))]
    lost = Run(
        type(course)(
            course.target,
            course.states,
            course.R_NR,
            course.accel_N,
            course.start.plus(np.repeat([3.0, 0.0, 0.0, 0.0], 3)),
        ),
        list(far),
    )
    flown = fly(lost, Fixed(np.eye(6) * 1e6), 0.999)
    assert np.linalg.norm(flown.errors[-1, :3]) < 0.02 < np.linalg.norm(flown.errors[0, :3])


def made_up(wrong: float, gate: float) -> dict[str, object]:
    each = {
        "squares": [[1.0, 1.0, 1.0, 1.0]] * 3,
        "nees": [1.0] * 3,
        "taken": [0.5] * 3,
        "rms": [[0.1] * 4] * len(instants()),
    }
    worse = {**each, "squares": [[4.0, 4.0, 4.0, 4.0]] * 3}
    names = {"fixed": worse, "gated": worse, "calibrated": each}
    return {
        "case": {"source": "drawn", "scenario": "approach", "wrong": wrong, "gate": gate},
        **names,
        **{f"{name} + residual": value for name, value in names.items()},
    }


def test_tables_and_picture(tmp_path: Path) -> None:
    lines = [made_up(0.0, 0.999), made_up(0.05, 0.999), made_up(0.05, 1.0)]
    assert "| 2e+03 | 2e+03 | 1e+03 | 0.50 (0.50 to 0.50) |" in errors_table(lines)
    assert wrong_table(lines).count("1.00") == 12
    assert ratio(np.ones(3), np.full(3, 4.0)) == "0.50 (0.50 to 0.50)"
    draw(lines, tmp_path / "errors.png")
    assert Image.open(tmp_path / "errors.png").size[0] > 500
