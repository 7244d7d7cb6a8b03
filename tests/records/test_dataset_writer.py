"""What is written reads back equal, with the layout's own names."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation

from polhode.geometry.lie import exp_so3, make_pose
from polhode.records.dataset import read_wrench
from polhode.records.dataset_writer import write_sensor, write_truth, write_wrench
from polhode.records.read_truth import read_truth
from polhode.records.rig_calibration import read_calibration
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError

K_640 = np.array([[467.1, 0.0, 320.3], [0.0, 466.9, 241.7], [0.0, 0.0, 1.0]])
"""Of a camera of 640 x 480 pixels"""


def make_truth() -> Truth:
    rng = np.random.default_rng(2)
    moments = np.array([1.3, 1.0, 0.8])
    return Truth(
        timestamps_ns=1_600_000_000_000_000_001 + 500_000_000 * np.arange(5, dtype=np.int64),
        r_N=rng.normal(size=(5, 3)),
        R_NP=Rotation.random(5, rng=rng).as_matrix(),
        v_N=rng.normal(size=(5, 3)),
        w_P=rng.normal(size=(5, 3)),
        moments=moments,
        k1=float(np.log(moments[0] / moments[1])),
        k2=float(np.log(moments[1] / moments[2])),
        com_G=rng.normal(size=3),
        R_GP=exp_so3([0.1, 0.2, 0.3]),
        mesh=trimesh.creation.icosphere(subdivisions=1, radius=0.1),
        mass_kg=4.487,
    )


def test_truth_reads_back_equal(tmp_path: Path) -> None:
    truth = make_truth()
    write_truth(tmp_path / "mav0", truth)
    read = read_truth(tmp_path)
    for name in ("timestamps_ns", "r_N", "v_N", "w_P", "moments", "k1", "k2", "com_G", "R_GP", "mass_kg"):
        np.testing.assert_array_equal(getattr(read, name), getattr(truth, name))
    np.testing.assert_allclose(read.R_NP, truth.R_NP, atol=1e-15)
    assert read.mesh is not None and truth.mesh is not None
    np.testing.assert_allclose(read.mesh.vertices, truth.mesh.vertices, atol=1e-7)
    np.testing.assert_array_equal(read.mesh.faces, truth.mesh.faces)
    target = tmp_path / "mav0" / "target0"
    assert (target / "data.csv").read_text().splitlines()[0] == (
        "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
        "v_RS_R_x [m s^-1],v_RS_R_y [m s^-1],v_RS_R_z [m s^-1],"
        "w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]"
    )
    write_truth(tmp_path / "mav0", replace(truth, mass_kg=None))
    assert "mass_kg" not in yaml.safe_load((target / "target.yaml").read_text())
    assert read_truth(tmp_path).mass_kg is None
    with pytest.raises(InputError, match="target0 is missing: only a sequence with truth can be evaluated"):
        read_truth(tmp_path / "mav0")


def test_a_wrench_reads_back_equal_and_a_bad_one_is_told_in_a_line(tmp_path: Path) -> None:
    stamps = 1_600_000_000_000_000_001 + 50_000_000 * np.arange(6, dtype=np.int64)
    force_N, torque_P = np.array([[1, 2, 3], [0, 0, 1e-3]]), np.array([[4, 5, 6], [0, 0.1, 0]])
    write_wrench(tmp_path, stamps[:2], force_N, torque_P)
    file = tmp_path / "wrench0" / "data.csv"
    assert file.read_text().splitlines() == [
        "#timestamp [ns],force_N_x [N],force_N_y [N],force_N_z [N],"
        "torque_P_x [N m],torque_P_y [N m],torque_P_z [N m]",
        "1600000000000000001,1.0,2.0,3.0,4.0,5.0,6.0",
        "1600000000050000001,0.0,0.0,0.001,0.0,0.1,0.0",
    ]
    wrench = read_wrench(file.parent, stamps)
    np.testing.assert_array_equal(wrench.time_ns, stamps[:2])
    np.testing.assert_array_equal(wrench.force_N, force_N)
    np.testing.assert_array_equal(wrench.torque_P, torque_P)
    for text, message in (
        ("#only a header", "is empty"), ("1,0,0,0,0,0", "6 columns, expected 7"),
        ("1,0,0,0,0,0,nan", "NaN or infinity"), ("1,0,0,x,0,0,0", "not a number"),
        ("2,0,0,0,0,0,0\n2,0,0,0,0,0,0", "repeats"), ("1,0,0,1e300,0,0,0", "is no value of a force"),
        (f"{stamps[-1] + 1},0,0,0,0,0,0", "is after the last frame"),
    ):  # fmt: skip
        file.write_text(text)
        with pytest.raises(InputError, match=message) as caught:
            read_wrench(file.parent, stamps)
        assert "\n" not in str(caught.value) and str(file) in str(caught.value)


def test_calibration_reads_back_equal_in_euroc_keys(tmp_path: Path) -> None:
    dist = np.array([-0.2836, 0.0740, 1.9e-4, 1.76e-5, 1e-3])
    poses = [make_pose(exp_so3([0.01, 0.02, angle]), [angle, 0.01, -0.02]) for angle in (0.0, 0.1)]
    for index, X_BC in enumerate(poses):
        write_sensor(tmp_path / f"cam{index}", K_640, dist, X_BC, (640, 480), rate_hz=2.0)
    calibration = read_calibration(tmp_path)
    np.testing.assert_array_equal(calibration.K1, K_640)
    np.testing.assert_array_equal(calibration.dist0, dist)
    np.testing.assert_allclose(calibration.X_BC1, poses[1], atol=1e-15)
    sensor = yaml.safe_load((tmp_path / "cam0" / "sensor.yaml").read_text())
    assert sensor["intrinsics"] == [467.1, 466.9, 320.3, 241.7]
    assert sensor["T_BS"].keys() == {"cols", "rows", "data"}
    assert sensor["resolution"] == [640, 480]
    assert sensor["distortion_model"] == "radial-tangential"
    assert "bits" not in sensor
    # rounding in a pose is forgiven and made exact
    for index in (0, 1):
        rounded = np.round(poses[index], 4)
        write_sensor(tmp_path / f"cam{index}", K_640, np.zeros(4), rounded, (640, 480), rate_hz=2.0, bits=10)
    assert read_calibration(tmp_path).bits == 10
    R = read_calibration(tmp_path).X_BC0[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(R, poses[0][:3, :3], atol=1e-4)
