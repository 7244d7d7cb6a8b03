"""The state and mass properties of a run as Basilisk's spacecraft hub wants them.

    polhode export RUN --to json -o target.json --mass-kg 500
    python -m examples.basilisk_state target.json

Prints the assignments for a ``spacecraft.Spacecraft()`` whose body frame B is the frame P of the principal
axes: Basilisk's N is polhode's, and its attitude is modified Rodrigues parameters of B relative to N.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from polhode.geometry.lie import Array


def main(arguments: list[str] | None = None) -> int:
    """Read the export and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("export", type=Path, help="what polhode export --to json wrote")
    document = json.loads(parser.parse_args(arguments).export.read_text())
    for name, value in hub_state(document).items():
        print(f"spacecraft.hub.{name} = {np.asarray(value).tolist()}")
    for words in document["inertial"]["words"]:
        print(f"# {words}")
    return 0


def hub_state(document: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes of Basilisk's ``HubEffector`` [m, m/s, rad/s, kg, kg m^2], vectors as columns."""
    last, inertial = document["last"], document["inertial"]
    return {
        "mHub": inertial["mass_kg"],
        "r_BcB_B": _column([0.0, 0.0, 0.0]),
        "IHubPntBc_B": np.diag(inertial["moments_kg_m2"]),
        "r_CN_NInit": _column(last["r_N"]),
        "v_CN_NInit": _column(last["v_N"]),
        "sigma_BNInit": _column(rodrigues_parameters(np.array(last["q_NP_wxyz"]))),
        "omega_BN_BInit": _column(last["w_P"]),
    }


def rodrigues_parameters(q_wxyz: Array) -> Array:
    """Modified Rodrigues parameters (3,) of a unit quaternion (4,): e tan(angle / 4), at most of length 1."""
    q = np.asarray(q_wxyz, dtype=np.float64)
    q = q if q[0] >= 0.0 else -q
    return np.asarray(q[1:] / (1.0 + q[0]))


def _column(values: Any) -> Array:
    return np.asarray(values, dtype=np.float64).reshape(3, 1)


if __name__ == "__main__":
    sys.exit(main())
