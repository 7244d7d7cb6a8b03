"""The truth of a simulated sequence, ``target0/``. Only ``pipeline.evaluation`` may import it.

An import-linter contract and a test keep the estimate blind to it.
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from polhode.files.foreign_meshes import open_mesh
from polhode.files.tables import attitudes_of, numbers_at, read_mapping, read_table, require_below
from polhode.records.truth import Truth
from polhode.runtime.errors import InputError

MAX_STATE = 1e12
MIN_MOMENT = 1e-30


def read_truth(folder: Path) -> Truth:
    """Read ``mav0/target0`` of the sequence ``folder``: states in time, mass properties, surface in G.

    Raises InputError when something is missing or wrong. The mesh is None when there is no mesh.ply.
    """
    target = folder / "mav0" / "target0"
    if not target.is_dir():
        raise InputError(f"{target} is missing: only a sequence with truth can be evaluated")
    table = read_table(target / "data.csv", columns=13)
    values = table.values
    require_below(table, MAX_STATE, "a state [m, m/s, rad/s]")
    if abs(values[:, 10:]).max() > 300.0:
        raise InputError(f"{table.path}: an angular velocity above {300.0:g} rad/s; correct it")
    properties_path = target / "target.yaml"
    properties = read_mapping(properties_path, "the truth needs moments, com_G and R_GP")
    moments = numbers_at(properties_path, properties, "moments", (3,))
    if not ((moments > MIN_MOMENT) & (moments < 1.0 / MIN_MOMENT)).all():
        raise InputError(f"{properties_path} key 'moments': give three positive moments of inertia")
    R_GP = numbers_at(properties_path, properties, "R_GP", (9,)).reshape(3, 3)
    com_G = numbers_at(properties_path, properties, "com_G", (3,))
    if abs(R_GP).max() > 2.0 or abs(R_GP @ R_GP.T - np.eye(3)).max() > 1e-2:
        raise InputError(f"{properties_path} key 'R_GP': not a rotation; give nine numbers, row by row")
    if abs(com_G).max() > MAX_STATE:
        raise InputError(f"{properties_path} key 'com_G': above {MAX_STATE:g} m")
    return Truth(
        timestamps_ns=table.timestamps_ns,
        r_N=values[:, 0:3],
        R_NP=attitudes_of(table, values[:, 3:7], "q_NP"),
        v_N=values[:, 7:10],
        w_P=values[:, 10:13],
        moments=moments,
        k1=_ratio(properties_path, properties, "k1", moments[0] / moments[1]),
        k2=_ratio(properties_path, properties, "k2", moments[1] / moments[2]),
        com_G=com_G,
        R_GP=R_GP,
        mesh=_read_mesh(target / "mesh.ply"),
        mass_kg=_mass(properties_path, properties),
    )


def _ratio(path: Path, properties: dict[str, Any], key: str, quotient: float) -> float:
    return float(numbers_at(path, properties, key, (1,))[0]) if key in properties else float(np.log(quotient))


def _mass(path: Path, properties: dict[str, Any]) -> float | None:
    return float(numbers_at(path, properties, "mass_kg", (1,))[0]) if "mass_kg" in properties else None


def _read_mesh(path: Path) -> trimesh.Trimesh | None:
    if not path.exists():
        return None
    mesh = open_mesh(path).mesh(process=False)
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(f"{path} has no triangles")
    if not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path} contains NaN or infinity")
    return mesh
