"""covariance.npz, measurements.npz and landmarks.ply: round trips, and readers that are not ours."""

import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.backend.problem.inertia import FORMS
from polhode.backend.uncertainty.ambiguity import OpenRotation, end_of
from polhode.geometry.lie import exp_so3
from polhode.records.calibration_effects import CalibrationEffects, kept_terms
from polhode.records.tracks import Wrench
from polhode.run_directory.archives import (
    read_covariance,
    read_hypotheses,
    read_measurements,
    read_relative_poses,
    read_residuals,
    write_covariance,
    write_hypotheses,
    write_measurements,
)
from polhode.run_directory.point_cloud_file import read_landmarks, write_landmarks
from polhode.runtime.errors import InputError


def _equal(again: Any, given: Any) -> None:
    """All fields of two records, records among them compared as such."""
    for field in fields(again):
        one, other = getattr(again, field.name), getattr(given, field.name)
        if field.name in ("rig", "wrench", "calibration"):
            assert (one is None) == (other is None)
            _equal(one, other) if one is not None else None
        else:
            np.testing.assert_array_equal(one, other)


def test_measurements_come_back_equal_with_their_rig(example: Any, tmp_path: Path) -> None:
    file = tmp_path / "measurements.npz"
    write_measurements(example.tracks, file, example.relative, example.estimate)
    relative, residuals = read_relative_poses(tmp_path), read_residuals(tmp_path)
    assert relative is not None and residuals is not None
    _equal(read_measurements(tmp_path), example.tracks)
    _equal(relative, example.relative)
    np.testing.assert_array_equal(residuals.residuals_px, example.estimate.residuals_px)
    np.testing.assert_array_equal(residuals.inlier_weight, example.estimate.inlier_weight)
    # a known wrench, no observation, and what a run did not reach
    wrench = Wrench(np.array([5, 9], dtype=np.int64), np.eye(2, 3), -np.eye(2, 3))
    none = {name: getattr(example.tracks, name)[:0] for name in ("frame", "landmark", "uvd_px", "sigma_px")}
    rng, later_s = np.random.default_rng(0), np.array([0.0, 1e-3])
    left, right = rng.normal(size=(2, int(kept_terms().sum()), 2, 2))
    shift, turn = rng.normal(size=(2, 3, 2))
    effects = CalibrationEffects(
        *("a guess", left, right, shift, turn, later_s, turn, shift),
        has_ranges=True, names=("cam0.fu", "cam1.fu", "cam1.p_x"), factor=turn,
    )  # fmt: skip
    more = ({"wrench": wrench}, {"calibration": effects}, none)
    for given in (replace(example.tracks, **changes) for changes in more):
        write_measurements(given, file)
        _equal(read_measurements(tmp_path), given)
        assert read_relative_poses(tmp_path) is None and read_residuals(tmp_path) is None


def test_covariances_come_back_and_the_page_names_exactly_the_keys_of_the_file(
    example: Any, undetermined: Any, tmp_path: Path
) -> None:
    file, frames = tmp_path / "covariance.npz", len(example.estimate.timestamps_ns)
    write_covariance(example.estimate, file)
    assert read_covariance(tmp_path).covariance_X_NG is None
    root = np.random.default_rng(0).normal(size=(frames, 6, 6))
    given = root @ root.transpose(0, 2, 1)
    given[3] = np.nan
    estimate = replace(example.estimate, covariance_X_NG=given)
    write_covariance(estimate, file)
    again = read_covariance(tmp_path)
    np.testing.assert_array_equal(again.timestamps_ns, estimate.timestamps_ns)
    np.testing.assert_array_equal(again.covariance, estimate.covariance)
    np.testing.assert_array_equal(again.last_joint, estimate.covariance_last_joint)
    np.testing.assert_array_equal(again.covariance_of_marks, estimate.covariance_of_marks)
    assert again.covariance_X_NG is not None
    np.testing.assert_array_equal(again.covariance_X_NG[3], np.diag([np.inf] * 6))
    np.testing.assert_array_equal(np.delete(again.covariance_X_NG, 3, 0), np.delete(given, 3, 0))
    with np.load(file) as archive:
        assert archive["order"].tolist()[::3] == ["r_N_x", "v_N_x", "theta_P_x", "w_P_x"]
        assert len(archive["order"]) == 12 and len(archive["last_joint_order"]) == 20
        assert archive["covariance_X_NG_order"].tolist()[2:4] == ["shift_G_z", "turn_G_x"]
        shapes = {name: archive[name].shape for name in archive.files}
    page = (Path(__file__).parents[2] / "docs" / "run_directory.md").read_text()
    rows = re.findall(
        r"^\| `(\w+)` \| \(([^)]*)\) \|", page.split("## covariance.npz\n")[1].split("\n## ")[0], re.MULTILINE
    )
    assert shapes == {
        name: tuple(
            frames if size == "F" else int(size) for size in shape.replace(" ", "").split(",") if size
        )
        for name, shape in rows
    }
    # no NaN enters the archive
    write_covariance(undetermined.estimate, file)
    covariance = read_covariance(tmp_path).covariance
    assert not np.any(np.isnan(covariance))
    np.testing.assert_array_equal(covariance[:, 7, 7], np.inf)
    np.testing.assert_array_equal(covariance[:, 7, :7], 0.0)
    np.testing.assert_array_equal(covariance[:, 6, 6], undetermined.estimate.covariance[:, 6, 6])


def test_hypotheses_come_back_and_a_run_without_them_has_none(example: Any, tmp_path: Path) -> None:
    assert read_hypotheses(tmp_path) == ()
    estimate = replace(example.estimate, covariance_last_body=np.eye(20))
    given = [
        end_of(estimate, OpenRotation("sphere", turn, odds)) for turn, odds in ((110.0, 0.7), (250.0, 0.3))
    ]
    write_hypotheses(given, tmp_path / "hypotheses.npz")
    for again, one in zip(read_hypotheses(tmp_path), given, strict=True):
        _equal(again, one)
    np.testing.assert_allclose(given[0].R_NG @ given[0].R_GP, estimate.R_NP[-1])
    np.testing.assert_allclose(given[0].R_GP.T @ given[0].w_G, estimate.w_P[-1])


def test_the_inertia_of_the_joint_covariance_is_what_the_page_describes() -> None:
    """Five numbers, and the matrix that the page makes of them."""
    R = exp_so3([0.3, -0.2, 0.5])
    J = R @ np.diag([1.4, 1.0, 0.8]) @ R.T
    xi, _ = FORMS["second_moments"].coordinates(0.5 * np.trace(J) * np.eye(3) - J)
    L = np.diag([np.exp(xi[0]), np.exp(xi[1]), np.exp(-xi[0] - xi[1])])
    L[1, 0], L[2, 0], L[2, 1] = xi[2:]
    S = L @ L.T
    found = np.trace(S) * np.eye(3) - S
    assert np.linalg.det(S) == pytest.approx(1.0)
    np.testing.assert_allclose(found / found[0, 0], J / J[0, 0], atol=1e-9)
    xi, R_ref = FORMS["ratios_axes"].coordinates(0.5 * np.trace(J) * np.eye(3) - J)
    d = np.diag(R_ref.T @ S @ R_ref)
    np.testing.assert_allclose(xi, [np.log(d[0] / d[2]), np.log(d[1] / d[2]), 0.0, 0.0, 0.0], atol=1e-9)
    assert d[0] < d[1] < d[2]


def test_trimesh_opens_the_landmarks_with_their_properties(example: Any, tmp_path: Path) -> None:
    landmarks = replace(example.estimate.landmarks, sigma_m=np.r_[np.nan, np.full(149, 4e-4)])
    write_landmarks(landmarks, tmp_path / "landmarks.ply")
    cloud = trimesh.load(tmp_path / "landmarks.ply")
    assert isinstance(cloud, trimesh.PointCloud)
    np.testing.assert_array_equal(cloud.vertices, landmarks.p_G)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(data["observations"].ravel(), landmarks.observations)
    again = read_landmarks(tmp_path)
    np.testing.assert_array_equal(again.p_G, landmarks.p_G)
    np.testing.assert_array_equal(again.sigma_m, np.r_[np.inf, np.full(149, 4e-4)])
    np.testing.assert_array_equal(again.observations, landmarks.observations)
    nothing = replace(landmarks, p_G=np.empty((0, 3)), sigma_m=np.empty(0), observations=np.empty(0, int))
    write_landmarks(nothing, tmp_path / "landmarks.ply")
    assert read_landmarks(tmp_path).p_G.shape == (0, 3)


@pytest.mark.parametrize(
    ("read", "name"),
    [
        (read_measurements, "measurements.npz"),
        (read_covariance, "covariance.npz"),
        (read_landmarks, "landmarks.ply"),
    ],
)
def test_a_missing_or_damaged_file_is_refused_in_one_line(read: Any, name: str, tmp_path: Path) -> None:
    for content in (None, b"", b"PK\x03\x04 cut short", b"ply\nformat ascii 1.0\nend_header\n"):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError) as caught:
            read(tmp_path)
        assert name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("read", "name", "value", "words"),
    [
        (read_measurements, "uvd_px", (7, np.nan), "uvd_px holds NaN or infinity in row 7"),
        (read_measurements, "sigma_px", (3, 0.0), "sigma_px is not positive"),
        (read_measurements, "timestamps_ns", (4, 0), "timestamps_ns does not increase in row 4"),
        (read_measurements, "frame", (1, 99), "frame points outside"),
        (read_measurements, "uvd_px", np.zeros((3, 3)), "uvd_px is 3 x 3, expected"),
        (read_measurements, "uvd_px", np.array(["a"]), "uvd_px holds <U1, expected numbers"),
        (read_measurements, "X_NR", np.zeros((1, 4, 4)), "X_NR is 1 x 4 x 4, expected 24 x 4 x 4"),
        (read_measurements, "rig_baseline_m", np.array(0.0), "rig_baseline_m is not positive"),
        (read_measurements, "wrench_torque_P", np.zeros((1, 3)), "wrench_torque_P is 1 x 3, expected 2 x 3"),
        (read_measurements, "wrench_time_ns", np.array([5, 5]), "wrench_time_ns does not increase in row 1"),
        (read_relative_poses, "relative_X_RiRj", np.full((23, 4, 4), np.nan), "relative_X_RiRj holds NaN"),
        (read_relative_poses, "relative_j", np.full(23, 24), "relative_j points outside the run"),
        (
            read_relative_poses,
            "relative_inliers",
            np.zeros(2, dtype=int),
            "relative_inliers is 2, expected 23",
        ),
        (read_residuals, "inlier_weight", np.array([[1.0]]), "inlier_weight is 1 x 1, expected"),
    ],
)
def test_arrays_that_cannot_be_or_do_not_belong_together_are_refused_in_one_line(
    read: Any, name: str, value: Any, words: str, example: Any, tmp_path: Path
) -> None:
    file = tmp_path / "measurements.npz"
    wrench = Wrench(np.array([5, 9], dtype=np.int64), np.eye(2, 3), -np.eye(2, 3))
    write_measurements(replace(example.tracks, wrench=wrench), file, example.relative, example.estimate)
    with np.load(file) as archive:
        arrays = {key: archive[key] for key in archive.files}
    assert name in arrays
    if isinstance(value, tuple):
        row, number = value
        value = arrays[name].copy()
        value[row] = number
    np.savez(file, **{**arrays, name: value})
    with pytest.raises(InputError) as caught:
        read(tmp_path)
    assert str(caught.value).startswith(f"{file}: {words}") and "\n" not in str(caught.value)
