"""Trajectories that see more: the table against the metric, the limits, what cannot be flown."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import trimesh

from benchmarks.edges.trajectory_optimization import (
    BestTrajectory,
    CameraPathTask,
    best_trajectory,
    camera_poses,
    min_range,
    path_metric,
    straight_path,
    target_centres,
)
from benchmarks.edges.view_table import camera_attitude, view_table
from polhode.errors import InputError
from polhode.lie import transform_points
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.information import feature_information
from polhode.planning.keep_out.measured_body import grown_body
from polhode.planning.keep_out.volumes import InstantKeepOut
from polhode.planning.prediction import FinalEstimate, nominal_motion
from tests.planning.bodies import estimate, measured
from tests.planning.edges.views import RIG, block

SUN_N = np.array([0.8, -0.3, -0.6])
WATCH = CameraPathTask(
    np.array([0.1, 0.0, -3.2]), 40.0, 6, 0.02, (2.15, 3.6), 0.15, 0.1, sun_N=SUN_N, phase_deg=(20.0, 100.0)
)  # fmt: skip


def tumbling() -> FinalEstimate:
    return estimate((0.02, 0.05, 0.04))


def volume(model: EdgeModel, target: FinalEstimate, added_m: float = 0.02) -> InstantKeepOut:
    fine = model.surface.subdivide_to_size(0.08)
    assert isinstance(fine, trimesh.Trimesh)
    body = grown_body(measured(fine, 1e-3), 0.03, cells=16)
    motion = nominal_motion(target, np.linspace(0.4, 40.0, 100))
    return InstantKeepOut(body, motion, np.zeros((100, 6, 6)), 0.0, added_m)


def near_origin(target: FinalEstimate) -> FinalEstimate:
    return replace(target, last=replace(target.last, r_N=np.zeros(3)))


@pytest.fixture(scope="module")
def flown() -> tuple[EdgeModel, FinalEstimate, InstantKeepOut, BestTrajectory]:
    model, target = block(), near_origin(tumbling())
    keep_out = volume(model, target)
    found = best_trajectory(model, RIG, target, keep_out, WATCH, turns_deg=(60.0,), subdivisions=1)
    return model, target, keep_out, found


def test_the_best_way_is_better_by_the_true_metric_and_keeps_its_limits(
    flown: tuple[EdgeModel, FinalEstimate, InstantKeepOut, BestTrajectory],
) -> None:
    model, _, keep_out, found = flown
    path = found.best.path
    assert found.best.value < 0.7 * found.straight_path.value
    assert found.starts >= 3 and found.tried == 5
    time = keep_out.motion.time_s
    p, _, accel = path.at(time)
    away = p - target_centres(model, keep_out.motion)
    far = np.linalg.norm(away, axis=1)
    assert far.min() >= 2.15 - 2e-4 and far.max() <= 3.6 + 2e-4
    phase = np.degrees(np.arccos(away @ SUN_N / far / np.linalg.norm(SUN_N)))
    assert phase.min() >= 20.0 - 0.01 and phase.max() <= 100.0 + 0.01
    assert np.linalg.norm(accel, axis=1).max() <= 0.02 + 1e-6
    assert found.gap_m >= 0.25 - 1e-4
    np.testing.assert_allclose(path.p_N[0], WATCH.start_N, atol=1e-8)
    np.testing.assert_allclose(path.v_N[0], 0.0, atol=1e-8)


def test_all_of_the_body_is_in_the_image_all_the_way(
    flown: tuple[EdgeModel, FinalEstimate, InstantKeepOut, BestTrajectory],
) -> None:
    model, _, _, found = flown
    for X in found.best.X_RG[::4]:
        uv = RIG.project(transform_points(X, model.surface.vertices))[:, :2]
        assert (uv > 0.0).all() and (uv < [639.0, 479.0]).all()
        o = RIG.project(transform_points(X, model.centre_G[None]))[0, :2]
        np.testing.assert_allclose(o, [319.5, 239.5], atol=1e-6)


def test_with_the_range_held_only_the_direction_is_chosen() -> None:
    model, target = block(), near_origin(tumbling())
    task = replace(WATCH, fixed_range=True)
    found = best_trajectory(model, RIG, target, volume(model, target), task, (60.0,), subdivisions=2)
    assert found.best.value < found.straight_path.value
    np.testing.assert_allclose(found.best.range_m, found.straight_path.range_m, rtol=0.03)


def test_a_goal_is_reached_at_rest() -> None:
    model, target = block(), near_origin(tumbling())
    goal = np.array([1.1, 0.2, -2.4])
    task = replace(WATCH, goal_N=goal)
    found = best_trajectory(model, RIG, target, volume(model, target), task, (), subdivisions=1)
    np.testing.assert_allclose(found.best.path.p_N[-1], goal, atol=1e-7)
    np.testing.assert_allclose(found.best.path.v_N[-1], 0.0, atol=1e-7)


def test_between_its_views_the_table_is_smooth_and_near_the_metric() -> None:
    model = block()
    table = view_table(model, RIG, (2.2, 3.6), subdivisions=2, spacing_px=20.0)
    value, row = table.log_trace_of(), ca.DM(table.log_trace[0])
    p, r = ca.SX.sym("p", 3), ca.SX.sym("r", len(table.log_trace[0]))
    derivative = ca.Function("derivative", [p, r], [ca.jacobian(value(p, r), p)])
    rng = np.random.default_rng(0)
    found, true = [], []
    for _ in range(25):
        d = rng.normal(size=3)
        p_G = rng.uniform(2.3, 3.5) * d / np.linalg.norm(d)
        R = camera_attitude(-p_G, np.array([0.0, 0.0, 1.0]))
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, -R @ (p_G + model.centre_G)
        C = feature_information(model, RIG, X[None], spacing_px=20.0, clear=True).scaled.sum(axis=1)[0]
        true.append(np.log(np.trace(np.linalg.inv(C + np.eye(6)))))
        found.append(float(value(p_G, row)))
        # derivative against finite differences
        slope = np.asarray(derivative(p_G, row))
        step = 1e-5 * rng.normal(size=3)
        change = float(value(p_G + step, row)) - float(value(p_G - step, row))
        assert change == pytest.approx(2.0 * float(slope.reshape(-1) @ step), rel=1e-4, abs=1e-9)
    assert np.sqrt(np.mean((np.array(found) - true) ** 2)) < 0.6
    assert np.corrcoef(found, true)[0, 1] > 0.7


def test_the_straight_way_is_what_it_says() -> None:
    model, target = block(), near_origin(tumbling())
    for steps in 6, 7:
        path = straight_path(model, target, replace(WATCH, steps=steps))
        np.testing.assert_allclose(path.v_N[-1], 0.0, atol=1e-12)
        p, v, _ = path.at(path.time_s)
        np.testing.assert_allclose(p, path.p_N, atol=1e-12)
        np.testing.assert_allclose(v, path.v_N, atol=1e-12)
        end = target_centres(model, nominal_motion(target, np.array([0.0, 40.0])))[1]
        assert np.linalg.norm(p[-1] - end) == pytest.approx(2.15)
    seen = path_metric(model, RIG, target, WATCH, path)
    assert seen.C.shape == (25, 6, 6) and seen.sun_R is not None
    np.testing.assert_allclose(np.linalg.norm(seen.sun_R, axis=1), 1.0)


def test_cameras_look_at_the_target_wherever_up_is() -> None:
    target = near_origin(tumbling())
    motion = nominal_motion(target, np.array([0.0, 10.0]))
    p = np.array([[0.0, -3.0, 0.0], [1.0, 2.0, -2.0]])
    X = camera_poses(p, motion.p_NG, motion, np.array([0.0, -1.0, 0.0]))
    np.testing.assert_allclose(X[:, 0:2, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(X[:, 2, 3], 3.0)
    np.testing.assert_allclose(np.linalg.det(X[:, :3, :3]), 1.0)
    # up in N is up in the image: y of the camera points away from it
    up_R = X[1, :3, :3] @ motion.R_NG[1].T @ [0.0, -1.0, 0.0]
    assert abs(up_R[0]) < 1e-12 and up_R[1] < 0.0


def test_what_cannot_be_flown_is_refused_with_the_reason() -> None:
    model, target = block(), near_origin(tumbling())
    keep_out = volume(model, target)

    def refuses(match: str, **changed: object) -> None:
        task = replace(WATCH, **changed)  # type: ignore[arg-type]
        with pytest.raises(InputError, match=match):
            best_trajectory(model, RIG, target, keep_out, task, (), subdivisions=0)

    assert min_range(model, RIG) == pytest.approx(0.580172 / np.sin(np.arctan(235.0 / 800.0)), rel=1e-4)
    refuses("does not fit into the image", range_m=(1.0, 3.6))
    refuses("the start is 3.2 m from the target", range_m=(2.15, 3.0))
    refuses("phase angle", sun_N=np.array([0.0, 0.0, 1.0]))
    refuses("no phase angle is left", phase_deg=(80.0, 60.0))
    refuses("inside the keep-out volume", clearance_m=3.0)
    refuses("the thrust reaches", max_accel_m_s2=1e-4)
    # the far side is near enough through the target, but not around it
    far_side = {
        "goal_N": np.array([-0.1, 0.0, 2.6]),
        "phase_deg": (20.0, 150.0),
        "max_accel_m_s2": 0.015,
        "steps": 4,
    }
    refuses("no trajectory was found", **far_side)
