"""How well the calibration of a rig is known: the joint covariance of all its parameters.

The names of the parameters are ``cam0.fu``, ``fv``, ``cu``, ``cv`` [px] and the coefficients of the
distortion in OpenCV's order, likewise of ``cam1``; ``cam1.p_x`` to ``p_z`` [m], the position of the right
camera along the axes of the left one; ``cam1.theta_x`` to ``theta_z`` [rad], a turn R_C0C1 Exp(theta) along
the axes of the right one; ``cam1.clock_offset`` [s], how much later than stated the right image is;
``cam0.p_x`` and so on, the position of the left camera in the inspector's body, along its axes, and
``cam0.theta_x`` and so on, a turn along the camera's own. Each is the true value minus the stated one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from polhode.files.array_files import read_arrays
from polhode.files.tables import numbers_at, read_mapping
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.runtime.errors import InputError

if TYPE_CHECKING:
    from polhode.records.rig_calibration import StereoCalibration

COVARIANCE_FILE = "calibration_covariance.npz"
INTRINSICS = ("fu", "fv", "cu", "cv")
DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
POSITION = tuple(f"p_{axis}" for axis in "xyz")
TURN = tuple(f"theta_{axis}" for axis in "xyz")
CLOCK = "cam1.clock_offset"
KEYS = {"T_BS_sigma_p_m": POSITION, "T_BS_sigma_theta_rad": TURN}

FOCAL_COMMON, FOCAL_EACH = 3e-4, 1e-4
"""Of the default prior: the distances of the board fix the scale of all four focal lengths together"""
CENTRE_PX = 0.1
"""Of the principal points; the turn of the right camera follows, as the board's images allow no offset"""
TURN_RAD = float(np.deg2rad(0.002))
"""Of the right camera about each axis, besides"""
BASELINE_SHARE = 2e-4
RADIAL_PX, TANGENTIAL_PX = 0.05, 0.02
"""Effect of the distortion's error in the corner of the image"""

DEFAULT = (
    "the default of a good laboratory calibration, as sensor.yaml states none: focal lengths 0.03 %, "
    "principal points 0.1 px, rig 0.002 deg and 0.02 % of the baseline, distortion 0.05 px in the corners"
)
EXACT = "exact: all stated sigmas are 0"


@dataclass(frozen=True)
class CalibrationPrior:
    """Joint Gaussian of the errors of the calibration."""

    names: tuple[str, ...]
    """(n,)"""
    covariance: Array
    """(n, n)"""
    source: str
    """Where it is from, in words"""

    @property
    def sigma(self) -> Array:
        """(n,)"""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def factor(self) -> Array:
        """(n, c) with factor factor^T the covariance: one sigma each of c independent errors.

        Cholesky's, without the columns of what is exact: unlike eigenvectors it is the same on all
        processors, so that a seed draws the same errors.
        """
        scale = self.sigma
        left = self.covariance / np.outer(scale, scale).clip(1e-300)
        columns = []
        for k in range(len(left)):
            # of a variance of 1, what the errors before leave
            if left[k, k] > 1e-9:
                columns.append(left[:, k] / np.sqrt(left[k, k]))
                left = left - np.outer(columns[-1], columns[-1])
        return scale[:, None] * np.reshape(columns, (-1, len(left))).T

    def without(self, *starts: str) -> "CalibrationPrior":
        """Exact where names begin so."""
        kept = np.array([not name.startswith(starts) for name in self.names])
        return replace(self, covariance=self.covariance * np.outer(kept, kept))

    def draw(self, rng: np.random.Generator) -> dict[str, float]:
        """Errors drawn from it, by name."""
        drawn = self.factor @ rng.normal(size=self.factor.shape[1])
        return dict(zip(self.names, drawn.tolist(), strict=True))


def parameter_names(calibration: "StereoCalibration") -> tuple[str, ...]:
    """All that can be stated of a rig, in the order of the module's description."""
    lenses = zip(("cam0", "cam1"), (calibration.dist0, calibration.dist1), strict=True)
    of_lenses = [f"{camera}.{n}" for camera, dist in lenses for n in (*INTRINSICS, *_coefficients(dist))]
    poses = [f"{camera}.{name}" for camera in ("cam1", "cam0") for name in (*POSITION, *TURN)]
    return (*of_lenses, *poses, CLOCK)


def _coefficients(dist: Array) -> tuple[str, ...]:
    return DISTORTION[: len(dist)]


def exact_prior(calibration: "StereoCalibration") -> CalibrationPrior:
    """No errors at all."""
    names = parameter_names(calibration)
    return CalibrationPrior(names, np.zeros((len(names), len(names))), EXACT)


def default_prior(calibration: "StereoCalibration") -> CalibrationPrior:
    """That of a good laboratory calibration: what ``polhode calibrate`` states with twenty sharp images of a
    flat board, times the few that a board's flatness and some days between calibration and use cost.

    Clock and pose in the inspector are exact: a stereo camera has one trigger, and ``inspector0`` states how
    well its poses are known.
    """
    names = parameter_names(calibration)
    at = {name: n for n, name in enumerate(names)}
    columns: list[Array] = []

    def error(values: dict[str, float]) -> None:
        column = np.zeros(len(names))
        column[[at[name] for name in values]] = list(values.values())
        columns.append(column)

    K = calibration.K0, calibration.K1
    focal = {f"cam{i}.f{axis}": K[i][n, n] for i in (0, 1) for n, axis in enumerate("uv")}
    error({name: FOCAL_COMMON * value for name, value in focal.items()})
    R_10 = calibration.X_BC1[:3, :3].T @ calibration.X_BC0[:3, :3]
    for name, value in focal.items():
        error({name: FOCAL_EACH * value})
        # a principal point that is off by one pixel, and the turn of the right camera that hides it
        along = (np.eye(3)[1] if name.endswith("u") else -np.eye(3)[0]) / value
        turn = CENTRE_PX * (along if name.startswith("cam1") else -R_10 @ along)
        error({name.replace(".f", ".c"): CENTRE_PX} | _of_right(TURN, turn))
    baseline_m = float(np.linalg.norm(calibration.X_BC1[:3, 3] - calibration.X_BC0[:3, 3]))
    for axis in np.eye(3):
        error(_of_right(TURN, TURN_RAD * axis))
        error(_of_right(POSITION, BASELINE_SHARE * baseline_m * axis))
    lenses = (calibration.fisheye0, calibration.dist0), (calibration.fisheye1, calibration.dist1)
    for i, (is_fisheye, dist) in enumerate(lenses):
        f, (width, height), (cu, cv) = K[i][0, 0], calibration.size_px(i), K[i][:2, 2]
        corner = float(np.hypot(max(cu, width - cu), max(cv, height - cv))) / f
        error({f"cam{i}.k1": RADIAL_PX / (f * corner**3)})
        if not is_fisheye and len(dist) >= 4:
            for name in ("p1", "p2"):
                error({f"cam{i}.{name}": TANGENTIAL_PX / (3.0 * f * corner**2)})
    factor = np.stack(columns, axis=1)
    return CalibrationPrior(names, factor @ factor.T, DEFAULT)


def _of_right(names: tuple[str, ...], values: Array) -> dict[str, float]:
    return {f"cam1.{name}": float(value) for name, value in zip(names, values, strict=True)}


def changed(calibration: "StereoCalibration", errors: Mapping[str, float]) -> "StereoCalibration":
    """The calibration with errors added, by name."""

    def of(camera: int, names: tuple[str, ...]) -> Array:
        return np.array([errors.get(f"cam{camera}.{name}", 0.0) for name in names])

    K, dist = [calibration.K0.copy(), calibration.K1.copy()], [calibration.dist0, calibration.dist1]
    for i in (0, 1):
        K[i][[0, 1, 0, 1], [0, 1, 2, 2]] += of(i, INTRINSICS)
        dist[i] = dist[i] + of(i, _coefficients(dist[i]))
    X_BC0, X_01 = calibration.X_BC0, inverse_pose(calibration.X_BC0) @ calibration.X_BC1
    X_01 = make_pose(X_01[:3, :3] @ exp_so3(of(1, TURN)), X_01[:3, 3] + of(1, POSITION))
    X_BC0 = make_pose(X_BC0[:3, :3] @ exp_so3(of(0, TURN)), X_BC0[:3, 3] + of(0, POSITION))
    return replace(
        calibration, K0=K[0], K1=K[1], dist0=dist[0], dist1=dist[1], X_BC0=X_BC0, X_BC1=X_BC0 @ X_01
    )


def prior_of(calibration: "StereoCalibration") -> CalibrationPrior:
    """What is stated of a calibration, or the default."""
    return calibration.prior or default_prior(calibration)


def read_prior(mav0: Path, calibration: "StereoCalibration", cameras: tuple[str, ...]) -> CalibrationPrior:
    """The sigmas of the ``sensor.yaml`` in the folders ``cameras``, and ``calibration_covariance.npz``.

    What one of them states is independent of what another, or the default in the place of what is absent,
    states. Raises InputError, one line, for what is wrong.
    """
    default = default_prior(calibration)
    names, covariance = default.names, default.covariance.copy()
    stated: dict[str, float] = {}
    for index, camera in enumerate(cameras):
        stated |= _stated(
            mav0 / camera / "sensor.yaml", index, calibration.dist1 if index else calibration.dist0
        )
    at = [names.index(name) for name in stated]
    covariance[at], covariance[:, at] = 0.0, 0.0
    covariance[at, at] = np.square(list(stated.values()))
    joint = _read_covariance(mav0 / COVARIANCE_FILE, names)
    if joint is not None:
        at = [names.index(name) for name in joint.names]
        covariance[at], covariance[:, at] = 0.0, 0.0
        covariance[np.ix_(at, at)] = joint.covariance
    if not stated and joint is None:
        return default
    if not covariance.any():
        return CalibrationPrior(names, covariance, EXACT)
    files = [*(["the sigmas of sensor.yaml"] if stated else []), *([COVARIANCE_FILE] if joint else [])]
    known = {*stated, *(joint.names if joint else ())}
    left_out = [n for n, s in zip(names, default.sigma, strict=True) if s > 0.0 and n not in known]
    rest = ", else the default of a good laboratory calibration" if left_out else ""
    return CalibrationPrior(names, covariance, " and ".join(files) + rest)


def states_sigmas(mav0: Path, cameras: tuple[str, ...]) -> bool:
    """Whether the ``sensor.yaml`` of a camera, or a covariance, says how well the calibration is known."""
    if (mav0 / COVARIANCE_FILE).exists():
        return True
    files = [mav0 / camera / "sensor.yaml" for camera in cameras]
    return any("_sigma" in key for file in files if file.exists() for key in read_mapping(file, ""))


def _stated(path: Path, index: int, dist: Array) -> dict[str, float]:
    """Sigmas by name that one ``sensor.yaml`` states."""
    sensor = read_mapping(path, "a camera needs its calibration (see docs/dataset.md)")
    out: dict[str, float] = {}
    keys = {"intrinsics_sigma": INTRINSICS, "distortion_sigma": _coefficients(dist), **KEYS}
    if index == 1:
        keys["clock_offset_sigma_s"] = (CLOCK.partition(".")[2],)
    elif "clock_offset_sigma_s" in sensor:
        raise InputError(f"{path} key 'clock_offset_sigma_s': it belongs in cam1/sensor.yaml; move it there")
    for key, own in keys.items():
        if key not in sensor:
            continue
        single = isinstance(sensor[key], int | float | str) and not isinstance(sensor[key], bool)
        value = {key: [sensor[key]] if single else sensor[key]}
        values = numbers_at(path, value, key, (1, 3) if key in KEYS else (len(own),))
        if (values < 0.0).any():
            raise InputError(f"{path} key '{key}': {values.min():g} is negative; give standard deviations")
        wide = np.broadcast_to(values, len(own)).tolist()
        out |= {f"cam{index}.{name}": value for name, value in zip(own, wide, strict=True)}
    return out


def _read_covariance(path: Path, known: tuple[str, ...]) -> CalibrationPrior | None:
    if not path.exists():
        return None
    arrays = read_arrays(path)
    if missing := {"names", "covariance"} - set(arrays):
        raise InputError(f"{path} lacks the array '{min(missing)}'; give names and covariance")
    names, C = tuple(map(str, arrays["names"].ravel().tolist())), np.asarray(arrays["covariance"])
    n = len(names)
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{path}: {unknown[0][:40]!r} is no parameter of this rig; see docs/dataset.md")
    if len(set(names)) < n:
        raise InputError(f"{path}: a name occurs twice; give each parameter once")
    if C.dtype.kind not in "fiu" or C.shape != (n, n) or not np.isfinite(C).all():
        raise InputError(f"{path}: covariance must be {n} x {n} finite numbers, one row for each name")
    variance = np.diag(C := C.astype(np.float64))
    scale = np.sqrt(np.maximum(variance, 0.0))
    unit = np.asarray(C / np.outer(scale, scale).clip(1e-300), dtype=np.float64)
    if (variance < 0.0).any() or abs(unit - unit.T).max(initial=0.0) > 1e-6:
        raise InputError(f"{path}: covariance is not symmetric with variances of at least 0; correct it")
    if n and (abs(unit).max() > 1.0 + 1e-6 or np.linalg.eigvalsh(unit)[0] < -1e-6):
        raise InputError(f"{path}: covariance is not positive semidefinite; correct it")
    return CalibrationPrior(names, 0.5 * (C + C.T), COVARIANCE_FILE)
