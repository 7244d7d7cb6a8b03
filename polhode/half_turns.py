"""The four descriptions of one motion that half-turns about the principal axes lead to.

A half-turn keeps the axes, the order of the moments, and right-handedness.
"""

import numpy as np

from polhode.lie import Array

HALF_TURNS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
"""Diagonals of the four rotations that keep the principal axes: none, and half-turns about x, y, z."""
HALF_TURN_NAMES = ("none", "x", "y", "z")


def nearest_half_turn(R_AP: Array, R_AQ: Array) -> Array:
    """The half-turn S (3, 3), or none, after which the axes R_AP S (3, 3) lie nearest to the axes R_AQ."""
    along = np.einsum("ij,ij->j", R_AP, R_AQ)
    return np.diag(HALF_TURNS[int(np.argmax(HALF_TURNS @ along))])


def best_half_turn(R_NP: Array, R_NP_true: Array) -> int:
    """Index into HALF_TURNS of the S that brings R_NP diag(S) nearest to the truth, over frames (F, 3, 3)."""
    between = np.swapaxes(R_NP, -1, -2) @ R_NP_true
    agreement = np.einsum("sk,fkk->s", HALF_TURNS, between)
    return int(np.argmax(agreement))
