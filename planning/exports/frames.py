"""The frame F that files are written in: G, P, or that of the user's CAD model."""

import numpy as np

from polhode.lie import Array, inverse_pose, make_pose
from polhode.planning.exports.records import Placement


def frame_G() -> Placement:
    """The geometric frame of the run: its mesh and landmarks as they are."""
    return Placement("G", np.eye(4), "G, the geometric frame of the run, fixed to the target")


def frame_P(R_GP: Array, com_G: Array) -> Placement:
    """Principal axes at the centre of mass."""
    words = "P, the principal axes of the target (Jxx >= Jyy >= Jzz), origin at its centre of mass"
    return Placement("P", inverse_pose(make_pose(R_GP, com_G)), words)


def frame_cad(X_cadG: Array, words: str) -> Placement:
    """The frame of a CAD model."""
    return Placement("cad", X_cadG, f"that of the CAD model; {words}")
