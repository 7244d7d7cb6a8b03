"""The unknowns of the problem, their layout as a vector, and how a correction changes them."""

from dataclasses import dataclass

import numpy as np

from polhode.backend.problem.inertia import N_INERTIA, InertiaForm, inertia_from_second_moments
from polhode.backend.problem.wrench import N_WRENCH
from polhode.geometry.lie import Array, exp_so3

N_POSE = 6
"""Unknowns of a pose: p_NG [m], theta [rad] in R_NG = R_ref Exp(theta)."""
N_STATE = 12
"""Unknowns of a frame: pose, v_N [m/s] of the centre of mass, w_G [rad/s]."""
N_CAMERA = 6
"""Errors of the camera's stated pose: shift and rotation along N; unknowns if that pose is noisy."""
N_CONSTANTS = 3 + N_INERTIA
"""com_G (3) [m], xi (5) of the inertia."""
POSE, POSITION, ROTATION = slice(0, 6), slice(0, 3), slice(3, 6)
VELOCITY, RATE = slice(6, 9), slice(9, 12)
CAMERA, CAMERA_SHIFT, CAMERA_ROTATION = slice(12, 18), slice(12, 15), slice(15, 18)
"""Where they stand among the unknowns of a frame."""
ERR_R, ERR_V, ERR_THETA, ERR_W = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Where position, velocity, attitude and rate stand in a residual of the dynamics and in a reported state."""
COM, XI = slice(0, 3), slice(3, 8)
"""Where they stand among the constants."""


@dataclass(frozen=True)
class Iterate:
    """A value of all unknowns: F frames, L landmarks.

    As a vector (s F + c + 3 L): per frame p_NG, theta, v_N, w_G (s = 12), and the errors of the camera's pose
    where they are unknowns (s = 18); then com_G, xi; then the landmarks.
    theta = 0 at the iterate itself: it is a right perturbation of its R_NG.
    """

    p_NG: Array
    """(F, 3) origin of G [m]"""
    R_NG: Array
    """(F, 3, 3)"""
    v_N: Array
    """(F, 3) velocity of the centre of mass [m/s]"""
    w_G: Array
    """(F, 3) angular velocity [rad/s]"""
    com_G: Array
    """(3,) [m]"""
    xi: Array
    """(5,) inertia in the coordinates of the form"""
    R_inertia: Array
    """(3, 3) reference rotation of the inertia's form"""
    p_G: Array
    """(L, 3) landmarks [m]"""
    camera: Array | None = None
    """(F, 6) shift [m] and rotation [rad], along N, from the stated camera pose to the true one; None:
    exact"""

    wrench: Array | None = None
    """(11,) unknowns of a known wrench (``wrench.py``), after xi in the vector; None: none acts"""
    R_torque: Array | None = None
    """(3, 3) reference of the torque's axes in G"""

    @property
    def n_frames(self) -> int:
        return len(self.p_NG)

    @property
    def n_constants(self) -> int:
        """Number of constants: com_G, xi and the wrench's unknowns."""
        return N_CONSTANTS if self.wrench is None else N_CONSTANTS + N_WRENCH

    @property
    def n_state(self) -> int:
        """Number of unknowns of a frame."""
        return N_STATE if self.camera is None else N_STATE + N_CAMERA

    @property
    def n_states(self) -> int:
        """Number of unknowns of all frames; the constants follow them."""
        return self.n_state * self.n_frames

    @property
    def n_dense(self) -> int:
        """Size of the part of the vector without the landmarks."""
        return self.n_states + self.n_constants

    def vector(self) -> Array:
        """The unknowns as a vector, theta = 0."""
        camera = np.zeros((self.n_frames, 0)) if self.camera is None else self.camera
        states = np.concatenate([self.p_NG, np.zeros_like(self.p_NG), self.v_N, self.w_G, camera], axis=1)
        wrench = np.zeros(0) if self.wrench is None else self.wrench
        return np.concatenate([states.ravel(), self.com_G, self.xi, wrench, self.p_G.ravel()])

    def moved_to(self, x: Array) -> "Iterate":
        """The unknowns at vector x, whose theta rotates the R_NG of this iterate."""
        states = x[: self.n_states].reshape(-1, self.n_state)
        constants, landmarks = x[self.n_states : self.n_dense], x[self.n_dense :]
        return Iterate(
            p_NG=states[:, POSITION],
            R_NG=self.R_NG @ exp_so3(states[:, ROTATION]),
            v_N=states[:, VELOCITY],
            w_G=states[:, RATE],
            com_G=constants[COM],
            xi=constants[XI],
            R_inertia=self.R_inertia,
            p_G=landmarks.reshape(-1, 3),
            camera=None if self.camera is None else states[:, CAMERA],
            wrench=None if self.wrench is None else constants[N_CONSTANTS:],
            R_torque=self.R_torque,
        )

    def second_moments(self, form: InertiaForm) -> Array:
        """Sigma (3, 3) in G, determinant 1."""
        return form.second_moments(self.xi, self.R_inertia)

    def J_G(self, form: InertiaForm) -> Array:
        """Inertia (3, 3) in G, up to scale."""
        return inertia_from_second_moments(self.second_moments(form))
