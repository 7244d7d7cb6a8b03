"""landmarks.ply: the sparse map in G, binary PLY with the properties x y z sigma_m observations."""

from pathlib import Path

import numpy as np

from polhode.files.atomic import write_bytes
from polhode.files.ply import binary_ply
from polhode.records.estimate import Landmarks
from polhode.runtime.errors import InputError

_VERTEX = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("sigma_m", "<f8"), ("observations", "<i4")])
_COMMENT = "landmarks in the geometric frame G [m]; sigma_m is one standard deviation [m]"


def write_landmarks(landmarks: Landmarks, path: Path) -> None:
    """Write the sparse map; ``inf`` where a standard deviation is undetermined."""
    vertices = np.zeros(len(landmarks.p_G), dtype=_VERTEX)
    for column, name in enumerate("xyz"):
        vertices[name] = landmarks.p_G[:, column]
    vertices["sigma_m"] = np.nan_to_num(landmarks.sigma_m, nan=np.inf, posinf=np.inf)
    vertices["observations"] = landmarks.observations
    write_bytes(path, binary_ply(vertices, [_COMMENT]))


def read_landmarks(path: Path) -> Landmarks:
    """Read landmarks.ply (the file, or its run folder). Raises InputError, one line."""
    file = path / "landmarks.ply" if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run that reached an estimate")
    content = file.read_bytes()
    body = content.partition(b"end_header\n")[2]
    vertices = np.frombuffer(body[: len(body) - len(body) % _VERTEX.itemsize], dtype=_VERTEX)
    if content != binary_ply(vertices, [_COMMENT]):
        raise InputError(f"{file}: not a point cloud that polhode wrote; run 'polhode run' again")
    p_G = np.stack([vertices["x"], vertices["y"], vertices["z"]], axis=1)
    bad = ~np.isfinite(p_G).all(axis=1) | np.isnan(vertices["sigma_m"])
    if bad.any():
        raise InputError(f"{file}: NaN or infinity in point {int(np.argmax(bad))}; run 'polhode run' again")
    return Landmarks(
        p_G=p_G,
        sigma_m=vertices["sigma_m"].astype(np.float64),
        observations=vertices["observations"].astype(np.int64),
    )
