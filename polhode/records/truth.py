"""The truth of a simulated sequence.

Frames (docs/notation.md): N inertial, R rectified left camera, G geometric frame of the target, P principal
axes at the centre of mass. ``p_N = X_NG @ p_G``; ``p_G = R_GP @ p_P + com_G``.
"""

from dataclasses import dataclass

import trimesh

from polhode.geometry.lie import Array, Ints


@dataclass(frozen=True)
class Truth:
    """Truth of a simulated sequence, which only ``evaluate`` reads."""

    timestamps_ns: Ints
    r_N: Array
    R_NP: Array
    v_N: Array
    w_P: Array
    moments: Array
    k1: float
    k2: float
    com_G: Array
    R_GP: Array
    mesh: trimesh.Trimesh | None
    mass_kg: float | None = None
