"""Writing a sequence in the layout of docs/dataset.md: what ``polhode simulate`` produces."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from polhode.files.atomic import replaced
from polhode.geometry.lie import Array, Ints, continuous_wxyz, wxyz_from_matrix
from polhode.records.calibration_prior import (
    COVARIANCE_FILE,
    DISTORTION,
    INTRINSICS,
    KEYS,
    CalibrationPrior,
)
from polhode.records.truth import Truth

STATE_COLUMNS = (
    "timestamp [ns]",
    *(f"p_RS_R_{axis} [m]" for axis in "xyz"),
    *(f"q_RS_{axis} []" for axis in "wxyz"),
    *(f"v_RS_R_{axis} [m s^-1]" for axis in "xyz"),
    *(f"w_RS_S_{axis} [rad s^-1]" for axis in "xyz"),
)
WRENCH_COLUMNS = (
    "timestamp [ns]",
    *(f"force_N_{axis} [N]" for axis in "xyz"),
    *(f"torque_P_{axis} [N m]" for axis in "xyz"),
)


def image_path(camera: Path, timestamp_ns: int) -> Path:
    """File of one image of a camera folder (``mav0/cam0``)."""
    return camera / "data" / f"{timestamp_ns}.png"


def mask_path(mav0: Path, camera_index: int, timestamp_ns: int) -> Path:
    """File of one mask, camera_index 0 (left) or 1 (right)."""
    return mav0 / f"masks{camera_index}" / f"{timestamp_ns}.png"


def write_png(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.bool_]) -> None:
    """Write an image (H, W) or (H, W, 3), or a mask (H, W), creating the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = pixels.astype(np.uint8) * np.uint8(255) if pixels.dtype == np.bool_ else pixels
    Image.fromarray(values).save(path)


def write_sensor(
    camera: Path,
    K: ArrayLike,
    dist: ArrayLike,
    X_BC: ArrayLike,
    size_px: tuple[int, int],
    rate_hz: float,
    bits: int = 8,
    fisheye: bool = False,
) -> None:
    """Write ``sensor.yaml`` of a camera folder: K (3, 3) [px], dist (n,) in OpenCV's order, X_BC (4, 4);
    ``size_px`` is width and height.

    More than 8 ``bits`` are stated, because they cannot be inferred from dark images.
    """
    K, dist = np.asarray(K, dtype=np.float64), np.asarray(dist, dtype=np.float64)
    sensor: dict[str, object] = {
        "sensor_type": "camera",
        "T_BS": {"cols": 4, "rows": 4, "data": _flat(X_BC)},
        "rate_hz": float(rate_hz),
        "resolution": [int(side) for side in size_px],
        "camera_model": "pinhole",
        "intrinsics": _flat([K[0, 0], K[1, 1], K[0, 2], K[1, 2]]),
        "distortion_model": "equidistant" if fisheye else "radial-tangential",
        "distortion_coefficients": _flat(dist if len(dist) else np.zeros(4)),
    }
    if bits > 8:
        sensor["bits"] = int(bits)
    _write_yaml(camera / "sensor.yaml", sensor)


def write_prior(mav0: Path, prior: CalibrationPrior) -> None:
    """State in ``sensor.yaml`` of the cameras that are there how well their calibration is known; and in
    ``calibration_covariance.npz``, where its errors depend on one another."""
    sigma = dict(zip(prior.names, prior.sigma.tolist(), strict=True))
    for camera in ("cam0", "cam1"):
        path = mav0 / camera / "sensor.yaml"
        if not path.exists():
            continue
        own = {name.partition(".")[2]: s for name, s in sigma.items() if name.startswith(camera)}
        sensor = yaml.safe_load(path.read_text(encoding="utf-8"))
        count = len(sensor["distortion_coefficients"])
        keys = {"intrinsics_sigma": INTRINSICS, "distortion_sigma": DISTORTION[:count], **KEYS}
        if camera == "cam1":
            keys["clock_offset_sigma_s"] = ("clock_offset",)
        for key, names in keys.items():
            values = [own.get(name, 0.0) for name in names]
            alike = key not in ("intrinsics_sigma", "distortion_sigma") and len(set(values)) == 1
            sensor[key] = values[0] if alike else values
        _write_yaml(path, sensor)
    if np.count_nonzero(prior.covariance - np.diag(np.diag(prior.covariance))):
        used = np.array([(mav0 / name[:4]).exists() for name in prior.names])
        names = np.array(prior.names)[used]
        with replaced(mav0 / COVARIANCE_FILE) as partial, partial.open("wb") as stream:
            np.savez_compressed(stream, names=names, covariance=prior.covariance[np.ix_(used, used)])


def write_range_sensor(
    folder: Path, scale_m: float, sigma_m: float, growth_per_m: float = 0.0, along_ray: bool = False
) -> None:
    """Write ``sensor.yaml`` of a folder of range images: metres per unit, and the noise of a pixel."""
    sensor: dict[str, object] = {
        "sensor_type": "range",
        "scale_m": float(scale_m),
        "sigma_m": float(sigma_m),
        "sigma_growth_per_m": float(growth_per_m),
        "along": "ray" if along_ray else "axis",
    }
    _write_yaml(folder / "sensor.yaml", sensor)


def write_camera_csv(camera: Path, timestamps_ns: Iterable[int]) -> None:
    """Write ``data.csv`` of a camera folder: one row ``<ns>,<ns>.png`` per frame."""
    lines = ["#timestamp [ns],filename", *(f"{int(stamp)},{int(stamp)}.png" for stamp in timestamps_ns)]
    _write(camera / "data.csv", "\n".join(lines) + "\n")


def write_inspector(
    mav0: Path, timestamps_ns: Ints, X_NB: Array, sigma_p_m: float = 0.0, sigma_theta_rad: float = 0.0
) -> None:
    """Write ``inspector0``: poses X_NB (n, 4, 4) as estimated, and their standard deviations."""
    folder = mav0 / "inspector0"
    q_NB_wxyz = continuous_wxyz(wxyz_from_matrix(X_NB[:, :3, :3]))
    poses = np.hstack([X_NB[:, :3, 3], q_NB_wxyz])
    _write_states(folder / "data.csv", STATE_COLUMNS[:8], timestamps_ns, poses)
    sigmas = {"sensor_type": "pose", "sigma_p_m": float(sigma_p_m), "sigma_theta_rad": float(sigma_theta_rad)}
    _write_yaml(folder / "sensor.yaml", sigmas)


def write_wrench(mav0: Path, timestamps_ns: Ints, force_N: Array, torque_P: Array) -> None:
    """Write ``wrench0``: known forces (n, 3) in N [N] and torques (n, 3) in P [N m] on the target."""
    _write_states(
        mav0 / "wrench0" / "data.csv", WRENCH_COLUMNS, timestamps_ns, np.hstack([force_N, torque_P])
    )


def write_truth(mav0: Path, truth: Truth) -> None:
    """Write ``target0``: states, mass properties, and the surface in G when there is one."""
    folder = mav0 / "target0"
    q_NP_wxyz = continuous_wxyz(wxyz_from_matrix(truth.R_NP))
    states = np.hstack([truth.r_N, q_NP_wxyz, truth.v_N, truth.w_P])
    _write_states(folder / "data.csv", STATE_COLUMNS, truth.timestamps_ns, states)
    properties = {
        "moments": _flat(truth.moments),
        "k1": float(truth.k1),
        "k2": float(truth.k2),
        "com_G": _flat(truth.com_G),
        "R_GP": np.asarray(truth.R_GP, dtype=np.float64).tolist(),
    }
    if truth.mass_kg is not None:
        properties["mass_kg"] = float(truth.mass_kg)
    _write_yaml(folder / "target.yaml", properties)
    if truth.mesh is not None:
        truth.mesh.export(folder / "mesh.ply")


def _write_states(path: Path, columns: tuple[str, ...], timestamps_ns: Ints, values: Array) -> None:
    # repr of a float is the shortest text that reads back to the same bits.
    lines = ["#" + ",".join(columns)]
    for stamp, row in zip(timestamps_ns, values, strict=True):
        lines.append(",".join([str(int(stamp)), *(repr(float(value)) for value in row)]))
    _write(path, "\n".join(lines) + "\n")


def _write_yaml(path: Path, mapping: dict[str, object]) -> None:
    _write(path, yaml.safe_dump(mapping, sort_keys=False, default_flow_style=None, width=1000))


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _flat(values: ArrayLike) -> list[float]:
    return [float(value) for value in np.asarray(values, dtype=np.float64).ravel()]
