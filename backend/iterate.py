"""The unknowns of the problem, and how a vector of corrections changes them."""

from dataclasses import dataclass

import numpy as np

from backend.inertia import InertiaForm, inertia_from_second_moments
from backend.kernels import N_CONSTANTS, N_STATE
from polhode.lie import Array, exp_so3


@dataclass(frozen=True)
class Iterate:
    """One value of all unknowns. F frames, L landmarks.

    As a vector (12 F + 8 + 3 L): per frame p_NG, theta, v_N, w_G; then com_G, xi; then the landmarks.
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

    @property
    def n_frames(self) -> int:
        return len(self.p_NG)

    @property
    def n_dense(self) -> int:
        """Size of the part of the vector without the landmarks."""
        return N_STATE * self.n_frames + N_CONSTANTS

    def vector(self) -> Array:
        """The unknowns as a vector, theta = 0."""
        states = np.concatenate([self.p_NG, np.zeros_like(self.p_NG), self.v_N, self.w_G], axis=1)
        return np.concatenate([states.ravel(), self.com_G, self.xi, self.p_G.ravel()])

    def moved_to(self, x: Array) -> "Iterate":
        """The unknowns at vector x, whose theta turns the R_NG of this iterate."""
        n = N_STATE * self.n_frames
        states = x[:n].reshape(-1, N_STATE)
        R_NG = self.R_NG @ exp_so3(states[:, 3:6])
        com_G, xi, p_G = x[n : n + 3], x[n + 3 : n + 8], x[n + 8 :].reshape(-1, 3)
        return Iterate(states[:, 0:3], R_NG, states[:, 6:9], states[:, 9:12], com_G, xi, self.R_inertia, p_G)

    def second_moments(self, form: InertiaForm) -> Array:
        """Sigma (3, 3) in G, determinant 1."""
        return form.second_moments(self.xi, self.R_inertia)

    def J_G(self, form: InertiaForm) -> Array:
        """Inertia (3, 3) in G, up to scale."""
        return inertia_from_second_moments(self.second_moments(form))
