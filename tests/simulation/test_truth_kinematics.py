"""The truth of the repository's scenes is one motion: rates are derivatives, moments are sorted."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from polhode.config.loader import load_config
from polhode.geometry.lie import Array, log_so3
from polhode.simulation.dataset.sequence import SequencePlan, plan_sequence, truth_of
from polhode.simulation.motion.target import TargetMotion, target_motion

CONFIGS = Path(__file__).parents[2] / "configs"
PATHS = [CONFIGS / "ts38.yaml", CONFIGS / "sample.yaml", *sorted(CONFIGS.glob("scenes/*.yaml"))]


def _rigid(path: Path) -> bool:
    """Whether no energy is lost and no disturbance acts."""
    scene = load_config(path).scene
    assert scene is not None
    return not (scene.motion.energy_loss or scene.motion.accel_psd or scene.motion.torque_psd)


@pytest.fixture(scope="module", params=PATHS, ids=lambda path: path.stem)
def plan(request: pytest.FixtureRequest) -> SequencePlan:
    config = load_config(request.param)
    assert config.scene is not None
    return plan_sequence(config.scene, config.seed)


def _finely(plan: SequencePlan, step_s: float) -> TargetMotion:
    fine = plan.scene.model_copy(update={"frames": 201, "interval_s": step_s, "truth_horizon_s": 0.0})
    return target_motion(fine, plan.mass, plan.seed)


def test_velocities_are_the_derivatives_of_position_and_attitude(plan: SequencePlan) -> None:
    motion = _finely(plan, 0.01)
    slope = (motion.r_N[2:] - motion.r_N[:-2]) / 0.02
    np.testing.assert_allclose(slope, motion.v_N[1:-1], atol=1e-11)
    motion = _finely(plan, 0.002)
    turn = log_so3(np.swapaxes(motion.R_NP[:-2], 1, 2) @ motion.R_NP[2:]) / 0.004
    # Central difference: the error is of second order in the step, (w dt)^2 |w| / 6 at most.
    assert np.abs(turn - motion.w_P[1:-1]).max() < 5e-6


@pytest.mark.parametrize(
    "plan", [path for path in PATHS if _rigid(path)], ids=lambda p: p.stem, indirect=True
)
def test_attitude_agrees_with_scipys_integration_of_another_form(plan: SequencePlan) -> None:
    """Angular momentum in N and the rotation matrix by LSODA: none of the simulator's equations."""
    truth = truth_of(plan)
    stop = plan.scene.frames - 1
    t_s = (truth.timestamps_ns[stop] - truth.timestamps_ns[0]) * 1e-9
    pushes = plan.scene.motion.pushes
    edges_s = sorted(
        {t for push in pushes for t in (push.start_s, push.start_s + push.duration_s) if t < t_s}
    )
    state = np.concatenate([truth.R_NP[0].ravel(), truth.R_NP[0] @ (truth.moments * truth.w_P[0])])
    for start_s, end_s in pairwise([0.0, *edges_s, t_s]):
        torque_P = np.zeros(3)
        for push in pushes:
            assert push.period_s is None
            if push.start_s <= start_s < push.start_s + push.duration_s:
                torque_P += push.torque_P

        def derivative(_: float, y: Array, torque_P: Array = torque_P) -> Array:
            R, h_N = y[:9].reshape(3, 3), y[9:]
            w_N = R @ ((R.T @ h_N) / truth.moments)
            return np.concatenate([np.cross(w_N, R, axisb=0, axisc=0).ravel(), R @ torque_P])

        state = solve_ivp(derivative, (start_s, end_s), state, "LSODA", rtol=1e-10, atol=1e-13).y[:, -1]
    R_end = Rotation.from_matrix(state[:9].reshape(3, 3))
    error = (Rotation.from_matrix(truth.R_NP[stop]).inv() * R_end).magnitude()
    assert error < 1e-5


def test_truth_is_sorted_right_handed_and_continues_a_minute(plan: SequencePlan) -> None:
    truth = truth_of(plan)
    assert truth.moments[0] >= truth.moments[1] >= truth.moments[2] > 0
    assert truth.moments[0] <= truth.moments[1] + truth.moments[2]
    assert np.linalg.det(truth.R_GP) == pytest.approx(1.0)
    J_G = truth.R_GP @ np.diag(truth.moments) @ truth.R_GP.T
    np.testing.assert_allclose(J_G, plan.mass.J_G, atol=1e-12 * truth.moments[0])
    assert truth.k1 == pytest.approx(np.log(truth.moments[0] / truth.moments[1]))
    assert truth.k2 == pytest.approx(np.log(truth.moments[1] / truth.moments[2]))
    last_image_ns = truth.timestamps_ns[plan.scene.frames - 1]
    assert truth.timestamps_ns[-1] - last_image_ns == 60_000_000_000


def test_the_session_starts_with_the_thesis_spin_about_body_axes() -> None:
    config = load_config(CONFIGS / "ts38.yaml")
    assert config.scene is not None
    plan = plan_sequence(config.scene, config.seed)
    w_G_rpm = plan.mass.R_GP @ plan.target.w_P[0] * 60 / (2 * np.pi)
    np.testing.assert_allclose(w_G_rpm, [0.5, 10.0, 0.5])
    assert np.linalg.norm(plan.target.r_N[0]) == pytest.approx(0.6, abs=1e-3)
    assert np.linalg.norm(plan.target.v_N[0]) == pytest.approx(3e-3, rel=1e-3)


@pytest.mark.parametrize(("name", "after_s"), [("ts38", 54.25), ("sample", 14.0)])
def test_the_spin_about_the_middle_axis_passes_zero_when_the_config_says(name: str, after_s: float) -> None:
    config = load_config(CONFIGS / f"{name}.yaml")
    assert config.scene is not None
    plan = plan_sequence(config.scene, config.seed)
    t_s = (plan.target.timestamps_ns - plan.target.timestamps_ns[0]) * 1e-9
    turned = t_s[np.argmax(plan.target.w_P[:, 1] < 0)]
    assert turned == pytest.approx(after_s, abs=1.0)
    assert turned < t_s[plan.scene.frames - 1]
