"""The worked example in small: MuJoCo's own tumble is ours, and the gap is measured right."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from examples import inspect_tumbling
from examples.inspect_tumbling import RADIUS_M, Flight, build, separation
from polhode.geometry.lie import exp_so3, matrix_from_wxyz, wxyz_from_matrix
from polhode.geometry.rigid_body import propagate
from polhode.records.truth import Truth

MOMENTS = np.array([1.3e-2, 1.0e-2, 0.8e-2])
R_GP, COM_G = exp_so3([0.3, 0.1, -0.2]), np.array([0.01, 0.0, -0.02])
ONE, MESH = np.zeros((1, 3)), trimesh.creation.box((0.2, 0.1, 0.05))
TRUTH = Truth(
    np.zeros(1, dtype=np.int64), ONE, np.eye(3)[None], ONE, ONE, MOMENTS, 0.26, 0.22, COM_G, R_GP, MESH, 4.0
)


def test_mujoco_tumbles_as_eulers_equations_say() -> None:
    mujoco = pytest.importorskip("mujoco")
    model = build(TRUTH)
    model.opt.timestep = 0.01
    data = mujoco.MjData(model)
    R0, w = exp_so3([0.1, 0.4, 0.2]), np.array([0.3, 1.0, 0.4])
    data.qpos[0:3], data.qpos[3:7], data.qpos[7:11] = [0.0, 0.0, 0.5], wxyz_from_matrix(R0), [5.0, 0, 0, 1.0]
    data.qvel[0:3], data.qvel[3:6] = [0.01, 0.0, 0.0], w
    for _ in range(500):
        mujoco.mj_step(model, data)
    r, _, R, _ = propagate([0.0, 5.0], [0.0, 0.0, 0.5], [0.01, 0.0, 0.0], R0, w, np.diag(MOMENTS))
    np.testing.assert_allclose(data.qpos[0:3], r[-1], atol=1e-6)
    np.testing.assert_allclose(matrix_from_wxyz(data.qpos[3:7]), R[-1], atol=1e-5)


def test_the_gap_is_that_to_the_true_surface() -> None:
    R_NP, r_N = exp_so3([0.2, 0.5, -0.1]), np.array([0.3, 0.2, 0.1])
    p_G = np.array([0.1 + RADIUS_M + 0.07, 0.02, 0.01])
    p_N = r_N + R_NP @ (R_GP.T @ (p_G - COM_G))
    flight = Flight(np.zeros(1), p_N[None], r_N[None], wxyz_from_matrix(R_NP)[None], 0)
    assert separation(flight, TRUTH)[0] == pytest.approx(0.07, abs=2e-4)


@pytest.mark.parametrize("has_mujoco", [False, True])
def test_without_mujoco_or_truth_one_line_says_so_before_the_planning(
    has_mujoco: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    if has_mujoco:
        pytest.importorskip("mujoco")
    else:
        monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.setattr(inspect_tumbling, "keep_out", lambda *each: pytest.fail("planned"))
    (tmp_path / "SEQ" / "mav0").mkdir(parents=True)
    words = ["example", str(tmp_path / "RUN"), str(tmp_path / "SEQ"), "-o", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", words)
    assert inspect_tumbling.main() == 2
    stderr = capsys.readouterr().err
    assert ("target0 is missing" if has_mujoco else "needs MuJoCo: pip install") in stderr
    assert stderr.startswith("error: ") and stderr.count("\n") == 1 and not (tmp_path / "out").exists()
