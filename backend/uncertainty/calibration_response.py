"""What errors of the calibration do to the solution, which takes the calibration as right.

They are considered, not estimated (Schmidt, "Application of state-space methods to navigation problems",
1966): the solution moves by -inv(H) J^T W e where the observations move by e, and the covariance is increased
by what these moves have as covariance. They are common to all frames, and no number of frames averages them.
"""

from dataclasses import dataclass

import numpy as np

from polhode.backend.problem.iterate import N_POSE
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.geometry.lie import Array, Ints
from polhode.records.tracks import StereoTracks


@dataclass(frozen=True)
class LinearObservations:
    """The whitened observations at a solution: derivatives, weights, effects of c errors that they share."""

    to_pose: Array
    """(M, 3, 6)"""
    to_landmark: Array
    """(M, 3, 3)"""
    weight: Array
    """(M,)"""
    effect: Array
    """(M, 3, c)"""
    frame: Ints
    """(M,)"""
    landmark: Ints
    """(M,)"""

    def landmark_moves(self, C_inv: Array, poses: Array | None = None) -> Array:
        """Moves (L, 3, c) of the landmarks, those of the poses (F, 6, c) given; None: none.

        C_inv (L, 3, 3): inverse information, the poses given.
        """
        effect = self.effect if poses is None else self.effect + self.to_pose @ poses[self.frame]
        pull = np.zeros((len(C_inv), 3, effect.shape[2]))
        weighted = self.weight[:, None, None] * np.swapaxes(self.to_landmark, 1, 2)
        np.add.at(pull, self.landmark, weighted @ effect)
        return np.asarray(-C_inv @ pull)

    def refitted(self, poses: Array, moved: Array) -> Array:
        """What is left (M, 3, c) of the effects, poses moved by (F, 6, c) and landmarks by (L, 3, c)."""
        at_poses = self.to_pose @ poses[self.frame]
        return np.asarray(self.effect + at_poses + self.to_landmark @ moved[self.landmark])

    def gradient(self, moved: Array, n_frames: int) -> Array:
        """Gradient (F, 6, c) in the poses, the landmarks moved by (L, 3, c)."""
        effect = self.effect + self.to_landmark @ moved[self.landmark]
        out = np.zeros((n_frames, N_POSE, effect.shape[2]))
        np.add.at(out, self.frame, self.weight[:, None, None] * (np.swapaxes(self.to_pose, 1, 2) @ effect))
        return out


def whitened_effects(fit: MotionFit, tracks: StereoTracks) -> Array:
    """Effects (M, 3, c) of one sigma of each error on the whitened observations; c = 0 where it is exact."""
    d, at, effects = fit.data, fit.iterate, tracks.calibration
    if effects is None:
        return np.zeros((len(d.frame), 3, 0))
    k, (arm_N, p_N, p_R) = d.frame, seen_points(fit)
    velocity_R = None
    if effects.right_later_s.any() and d.n_frames > 1:
        w_N = np.einsum("fij,fj->fi", at.R_NG, at.w_G)
        from_com = arm_N - (at.R_NG @ at.com_G)[k]
        v_N = at.v_N[k] + np.cross(w_N[k], from_com)
        turning, moving = (np.gradient(values, _times(d), axis=0) for values in (d.R_RN, d.t_R))
        velocity_R = (
            np.einsum("mij,mj->mi", d.R_RN[k], v_N) + np.einsum("mij,mj->mi", turning[k], p_N) + moving[k]
        )
    return d.inv_sigma[:, :, None] * effects.at(tracks.rig, p_R, velocity_R)


def seen_points(fit: MotionFit) -> tuple[Array, Array, Array]:
    """Places (M, 3) of the observed points: from the origin of G along N, in N, in R [m]."""
    d, at = fit.data, fit.iterate
    arm_N = np.einsum("mij,mj->mi", at.R_NG[d.frame], at.p_G[d.landmark])
    p_N = arm_N + at.p_NG[d.frame]
    return arm_N, p_N, np.einsum("mij,mj->mi", d.R_RN[d.frame], p_N) + d.t_R[d.frame]


def _times(data: MotionData) -> Array:
    return np.concatenate([[0.0], np.cumsum(data.dt_s)])
