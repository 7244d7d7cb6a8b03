"""Calibrations of OpenCV's functions: YAML, XML or JSON of FileStorage, or arrays of NumPy, with the names
that its samples use.

R and T turn points of the left camera into the right one, p_right = R p_left + T, as stereoCalibrate states
them. Both cameras are in one file, or the intrinsics in one and R and T in the other, as in OpenCV's sample.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from polhode.files.tables import numbers_at
from polhode.geometry.lie import Array, exp_so3, make_pose
from polhode.importers.calibrations.rig import (
    EQUIDISTANT,
    RADIAL_TANGENTIAL,
    Camera,
    Rig,
    camera_of,
    pose_from_inverse,
)
from polhode.runtime.errors import InputError

_SIDES = (("1", "left", "l", "0", "cam0"), ("2", "right", "r", "1", "cam1"))
_MATRIX = ("M{}", "K{}", "camera_matrix_{}", "camera_matrix{}", "cameraMatrix{}", "K_{}", "{}_K")
_DISTORTION = (
    "D{}", "dist{}", "distCoeffs{}", "dist_coeffs_{}", "distortion_coefficients_{}",
    "distortion_coefficients{}", "D_{}", "{}_D",
)  # fmt: skip
_ROTATION, _TRANSLATION = (
    ("R", "rotation", "rotation_matrix"),
    ("T", "translation", "translation_vector", "t"),
)


def is_opencv(content: Mapping[str, Any]) -> bool:
    """Whether a content has one of the names that ``read_opencv`` looks for."""
    known = {key.lower() for key in content}
    matrices = (pattern.format(name).lower() for pattern in _MATRIX for side in _SIDES for name in side)
    return not known.isdisjoint((*matrices, *(each.lower() for each in (*_ROTATION, *_TRANSLATION))))


def read_opencv(files: Mapping[Path, dict[str, Any]]) -> Rig:
    """The rig of one file, or of two that complete each other, by their content; lengths as in the file.

    Raises InputError when a matrix is missing, has the wrong size, or holds NaN.
    """
    values: dict[str, Any] = {}
    where: dict[str, Path] = {}
    for path, content in files.items():
        for key, value in content.items():
            values.setdefault(key, value)
            where.setdefault(key, path)
    shown = next(iter(files))
    R_key, T_key = _first(values, _ROTATION), _first(values, _TRANSLATION)
    if R_key is None or T_key is None:
        raise InputError(
            f"{shown} lacks {'R' if R_key is None else 'T'}, from the left to the right camera as "
            "stereoCalibrate gives it; add it, or give the file that has it as well: --calibration "
            "INTRINSICS EXTRINSICS"
        )
    # a matrix, or a rotation vector
    R = numbers_at(where[R_key], values, R_key, (9, 3))
    R = R.reshape(3, 3) if len(R) == 9 else np.asarray(exp_so3(R))
    t = numbers_at(where[T_key], values, T_key, (3,))
    X_01 = pose_from_inverse(make_pose(R, t))
    return Rig(_camera(shown, values, _SIDES[0], np.eye(4)), _camera(shown, values, _SIDES[1], X_01))


def read_opencv_camera(path: Path, values: dict[str, Any]) -> Camera:
    """One camera: ``camera_matrix`` and ``distortion_coefficients``, as OpenCV's sample writes them, or the
    left one of a pair. Raises InputError as ``read_opencv``."""
    for own, names in (
        ("M1", ("camera_matrix", "cameraMatrix", "mtx", "K")),
        ("D1", ("distortion_coefficients", "distCoeffs", "dist_coeffs", "dist", "D")),
    ):
        if (found := _first(values, names)) is not None:
            values.setdefault(own, values[found])
    return _camera(path, values, _SIDES[0], np.eye(4))


def _first(values: Mapping[str, Any], names: Sequence[str]) -> str | None:
    return next((name for name in names if name in values), None)


def _key(shown: Path, values: dict[str, Any], patterns: Sequence[str], side: Sequence[str], what: str) -> str:
    known = {key.lower(): key for key in values}
    for pattern in patterns:
        for name in side:
            if (found := known.get(pattern.format(name).lower())) is not None:
                return found
    raise InputError(
        f"{shown} lacks {what} of the {side[1]} camera; name it {patterns[0].format(side[0])}, as OpenCV's "
        "sample stereo_calib does"
    )


def _model(shown: Path, values: Mapping[str, Any]) -> str:
    """The model of distortion that a file names, or flags. Raises InputError for an omnidirectional one."""
    lower = {
        key.lower(): value[0] if isinstance(value, list) and len(value) == 1 else value
        for key, value in values.items()
    }
    if any(re.fullmatch(r"xi_?\w*", key) for key in lower):
        raise InputError(
            f"{shown}: an omnidirectional model (xi), which is not supported; calibrate as pinhole or fisheye"
        )
    words = " ".join(str(lower[key]) for key in lower if re.search(r"model|type", key)).lower()
    if re.search(r"fisheye|kannala|equi|kb4", words):
        return EQUIDISTANT
    flags = [value for key, value in lower.items() if "fisheye" in key]
    if any(str(value).lower() in ("1", "1.0", "true", "yes", "on") for value in flags):
        return EQUIDISTANT
    return str(values.get("distortion_model", values.get("model", "")) or "") or RADIAL_TANGENTIAL


def _camera(shown: Path, values: dict[str, Any], side: Sequence[str], X_BC: Array) -> Camera:
    key = _key(shown, values, _MATRIX, side, "the camera matrix")
    K = numbers_at(shown, values, key, (9,)).reshape(3, 3)
    if abs(K[0, 1]) > 1e-6 * abs(K[0, 0]) or abs(K[2] - [0.0, 0.0, 1.0]).max() > 1e-9:
        raise InputError(f"{shown} key '{key}': no camera matrix (fu 0 cu, 0 fv cv, 0 0 1); correct it")
    key = _key(shown, values, _DISTORTION, side, "the distortion")
    coefficients = numbers_at(shown, values, key, (4, 5, 8, 12, 14))
    named = _model(shown, values)
    size: list[float] | None = None
    known = {name.lower(): name for name in values}
    own = [f"{stem}{mark}{name}" for stem in ("image_size", "size") for mark in ("_", "") for name in side]
    found = _first(known, (*own, "image_size", "imagesize", "size", "resolution"))
    if found is not None:
        size = numbers_at(shown, values, known[found], (2,)).tolist()
    elif "image_width" in values and "image_height" in values:
        size = [numbers_at(shown, values, key, (1,))[0] for key in ("image_width", "image_height")]
    return camera_of(str(shown), K, named, coefficients, X_BC, size)
