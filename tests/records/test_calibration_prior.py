"""How well a calibration is known: read, written, defaulted, refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from polhode.geometry.lie import exp_so3, make_pose
from polhode.records.calibration_prior import (
    COVARIANCE_FILE,
    DEFAULT,
    EXACT,
    CalibrationPrior,
    default_prior,
    exact_prior,
    parameter_names,
    prior_of,
)
from polhode.records.dataset_writer import write_prior, write_sensor
from polhode.records.rig_calibration import StereoCalibration, read_calibration, read_range_calibration
from polhode.runtime.errors import InputError

K = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
X_01 = make_pose(exp_so3(np.array([0.01, -0.05, 0.02])), np.array([0.12, 0.0, 0.01]))


def written(mav0: Path, **changes: dict[str, Any]) -> Path:
    """A rig, with keys added to its files by camera."""
    for name, X, dist in (("cam0", np.eye(4), [-0.2, 0.1, 0, 0, 0.01]), ("cam1", X_01, [-0.2, 0.1, 0, 0])):
        write_sensor(mav0 / name, K, dist, X, (640, 480), 2.0)
        path = mav0 / name / "sensor.yaml"
        sensor = yaml.safe_load(path.read_text()) | changes.get(name, {})
        path.write_text(yaml.safe_dump(sensor))
    return mav0


def prior(mav0: Path) -> CalibrationPrior:
    found = read_calibration(mav0).prior
    assert found is not None
    return found


def test_absent_sigmas_are_those_of_a_good_laboratory_calibration(tmp_path: Path) -> None:
    calibration = read_calibration(written(tmp_path))
    found = prior_of(calibration)
    assert found.source == DEFAULT == prior_of(replace(calibration, prior=None)).source
    sigma = dict(zip(found.names, found.sigma, strict=True))
    assert sigma["cam0.fu"] / 800.0 == pytest.approx(3.2e-4, rel=0.02) and sigma["cam1.cv"] == 0.1
    assert sigma["cam1.clock_offset"] == sigma["cam0.p_x"] == 0.0
    # a principal point and the turn of the right camera leave a fifteenth of a pixel of the disparities
    at = [found.names.index(name) for name in ("cam1.cu", "cam1.theta_y")]
    seen = np.array([1.0, -800.0])
    assert np.sqrt(seen @ found.covariance[np.ix_(at, at)] @ seen) < 0.15
    assert abs(found.factor @ found.factor.T - found.covariance).max() < 1e-9 * found.covariance.max()


def test_what_is_stated_is_read_and_written_back(tmp_path: Path) -> None:
    own = {"intrinsics_sigma": [0.5, 0.6, 0.1, 0.2], "T_BS_sigma_theta_rad": [1e-4, 2e-4, 3e-4]}
    mav0 = written(tmp_path / "a", cam0={"distortion_sigma": [1e-3] * 5}, cam1=own | {
        "T_BS_sigma_p_m": 2e-4, "clock_offset_sigma_s": 1e-5})  # fmt: skip
    found = prior(mav0)
    sigma = dict(zip(found.names, found.sigma.tolist(), strict=True))
    assert sigma["cam1.fv"] == 0.6 and sigma["cam1.theta_z"] == 3e-4 and sigma["cam1.p_y"] == 2e-4
    assert sigma["cam0.k3"] == 1e-3 and sigma["cam1.clock_offset"] == 1e-5
    assert sigma["cam0.cu"] == 0.1 and found.source == (
        "the sigmas of sensor.yaml, else the default of a good laboratory calibration"
    )
    at = found.names.index("cam1.cu")
    assert np.count_nonzero(found.covariance[at]) == 1
    again = written(tmp_path / "b")
    write_prior(again, found)
    assert (again / COVARIANCE_FILE).exists()
    np.testing.assert_allclose(prior(again).covariance, found.covariance, rtol=1e-9, atol=1e-30)
    exact = written(tmp_path / "c")
    write_prior(exact, exact_prior(read_calibration(exact)))
    assert not (exact / COVARIANCE_FILE).exists() and prior(exact).source == EXACT
    assert prior(exact).factor.shape[1] == 0
    one = read_range_calibration(mav0).prior
    assert one is not None and one.sigma[one.names.index("cam0.k3")] == 1e-3


def test_a_joint_covariance_beats_the_sigmas(tmp_path: Path) -> None:
    mav0 = written(tmp_path, cam0={"intrinsics_sigma": [9.0] * 4})
    C = np.array([[4.0, 1.9], [1.9, 1.0]])
    np.savez(mav0 / COVARIANCE_FILE, names=["cam0.fu", "cam1.fu"], covariance=C)
    found = prior(mav0)
    at = [found.names.index(name) for name in ("cam0.fu", "cam1.fu")]
    np.testing.assert_allclose(found.covariance[np.ix_(at, at)], C)
    assert found.sigma[found.names.index("cam0.fv")] == 9.0 and COVARIANCE_FILE in found.source


@pytest.mark.parametrize(
    ("camera", "keys", "words"),
    [
        ("cam0", {"intrinsics_sigma": [1.0, 1.0, -1.0, 1.0]}, "is negative"),
        ("cam1", {"intrinsics_sigma": [1.0, 1.0]}, "2 numbers, expected 4"),
        ("cam1", {"distortion_sigma": [1.0] * 5}, "5 numbers, expected 4"),
        ("cam1", {"T_BS_sigma_p_m": [1.0, 2.0]}, "2 numbers, expected 1 or 3"),
        ("cam1", {"T_BS_sigma_theta_rad": float("nan")}, "NaN"),
        ("cam1", {"clock_offset_sigma_s": "soon"}, "expected a list of numbers"),
        ("cam0", {"clock_offset_sigma_s": 1e-3}, "belongs in cam1"),
    ],
)
def test_wrong_sigmas_are_refused(tmp_path: Path, camera: str, keys: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        read_calibration(written(tmp_path, **{camera: keys}))
    assert f"{camera}/sensor.yaml" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("names", "covariance", "words"),
    [
        (["cam0.fu", "cam0.focus"], np.eye(2), "no parameter of this rig"),
        (["cam0.fu", "cam0.fu"], np.eye(2), "twice"),
        (["cam0.fu"], np.eye(2), "1 x 1 finite numbers"),
        (["cam0.fu", "cam0.fv"], np.diag([1.0, np.nan]), "finite"),
        (["cam0.fu", "cam0.fv"], np.array([[1.0, 0.5], [0.0, 1.0]]), "not symmetric"),
        (["cam0.fu", "cam0.fv"], np.array([[1.0, 2.0], [2.0, 1.0]]), "not positive semidefinite"),
        (["cam0.fu", "cam0.fv"], np.array([[0.0, 2.0], [2.0, 1.0]]), "not positive semidefinite"),
    ],
)
def test_wrong_covariances_are_refused(tmp_path: Path, names: list[str], covariance: Any, words: str) -> None:
    mav0 = written(tmp_path)
    np.savez(mav0 / COVARIANCE_FILE, names=names, covariance=covariance)
    with pytest.raises(InputError, match=words):
        read_calibration(mav0)


def test_names_are_those_of_the_lenses() -> None:
    fisheye = StereoCalibration(K, K, np.zeros(4), np.zeros(4), np.eye(4), X_01, 640, 480, None, True, True)
    names = parameter_names(fisheye)
    assert len(names) == len(set(names)) == 2 * 8 + 12 + 1
    assert np.isfinite(default_prior(fisheye).covariance).all()


def test_the_errors_of_a_seed_do_not_depend_on_the_signs_of_eigenvectors() -> None:
    # the third error is the sum of the others, the fourth is exact
    root = np.array([[2.0, 0.0], [-1.0, 3.0], [1.0, 3.0], [0.0, 0.0]])
    found = CalibrationPrior(("a", "b", "c", "d"), root @ root.T, "a test").factor
    np.testing.assert_allclose(found, root, atol=1e-12)
