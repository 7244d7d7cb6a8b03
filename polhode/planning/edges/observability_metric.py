"""The observability metric: C = sum of f f^T over control points, and C^-1, per degree of freedom.

f is the image motion normal to the edge under each generator of SE(3) (Drummond and Cipolla, IEEE PAMI
24(7), 2002), in metres, radians and pixels: L_i is the image motion of a point under generator i, f_i =
L_i . n. Here the generators move the target: three translations along the axes of R, then three rotations
about axes parallel to them through a given point o.

C [px^2 per m^2, m rad, rad^2] is the information of the edges for one pixel of noise normal to them; C^-1 is
the covariance of the pose. Where C is singular, the unobservable variances are infinite, and a description
names the directions.
"""

from dataclasses import dataclass

import numpy as np

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, exp_so3, log_so3, transform_points
from polhode.planning.edges.visible_edges import ControlPoints

DEGREES_OF_FREEDOM = ("x", "y", "z", "about x", "about y", "about z")
"""Translations along R's axes (right, down, forward), rotations about them through o."""


def edge_motion(points: ControlPoints, rig: RectifiedRig, X_RG: Array, o_G: Array) -> Array:
    """f (m, 6): motion normal to the edges [px per m, px per rad] per motion of the target about o_G (3,)."""
    p_R = transform_points(X_RG, points.p_G)
    o_R = transform_points(X_RG, o_G[None])[0]
    x, y, z = p_R.T
    nx, ny = points.normal_px.T
    scale = rig.focal_px / z
    # n^T d(u, v)/dp
    shift = np.stack([scale * nx, scale * ny, -scale * (nx * x + ny * y) / z], axis=1)
    return np.hstack([shift, np.cross(p_R - o_R, shift)])


def moved(X_RG: Array, step: Array, o_G: Array) -> Array:
    """The pose (4, 4) after a step (6,) of the generators: rotated about o, then translated [m, rad]."""
    R_step = exp_so3(step[3:])
    o_R = X_RG[:3, :3] @ o_G + X_RG[:3, 3]
    X = np.eye(4)
    X[:3, :3] = R_step @ X_RG[:3, :3]
    X[:3, 3] = R_step @ (X_RG[:3, 3] - o_R) + o_R + step[:3]
    return X


def pose_error(X_RG: Array, true_X_RG: Array, o_G: Array) -> Array:
    """Step (6,) from the true pose to an estimate: translation of o along R's axes [m], rotation [rad]."""
    shift = (X_RG[:3, :3] - true_X_RG[:3, :3]) @ o_G + X_RG[:3, 3] - true_X_RG[:3, 3]
    return np.concatenate([shift, log_so3(X_RG[:3, :3] @ true_X_RG[:3, :3].T)])


def motion_scale(radius_m: float) -> Array:
    """(6,) radius for translations [m], 1 for rotations [rad]."""
    return np.array([radius_m] * 3 + [1.0] * 3)


def spectrum(C: Array, radius_m: float) -> tuple[Array, Array, Bools]:
    """Eigenvalues (..., 6) with translations in radii, directions (..., 6, 6), and which are observable."""
    scale = motion_scale(radius_m)
    values, directions = np.linalg.eigh(C * np.outer(scale, scale))
    # not 1e-9 of the largest information, nor a sigma above 5 radii or radians for a noise of one pixel
    observable = values > np.maximum(1e-9 * values[..., -1:], 1.0 / 5.0**2)
    return values, directions, np.asarray(observable)


def observable_covariance(C: Array, radius_m: float) -> Array:
    """(..., 6, 6) pseudoinverses of C (..., 6, 6) over its observable directions."""
    values, directions, observable = spectrum(C, radius_m)
    inverse_values = np.where(observable, 1.0 / np.where(observable, values, 1.0), 0.0)
    inverse = (directions * inverse_values[..., None, :]) @ np.swapaxes(directions, -1, -2)
    return np.asarray(inverse * np.outer(motion_scale(radius_m), motion_scale(radius_m)))


def is_unobservable(directions: Array, observable: Bools) -> Bools:
    """(..., 6) degrees of freedom with a component along an unobservable direction."""
    return np.asarray(np.einsum("...ij,...j->...i", directions**2, (~observable).astype(np.float64)) > 1e-6)


@dataclass(frozen=True)
class EdgeObservability:
    """Information that the edges of one view, or of several together, give about the pose."""

    C: Array
    """(6, 6) information for one pixel of noise"""
    radius_m: float
    """Half the body's diameter: scale at which translations and rotations are compared"""
    points: int
    """number of control points"""

    @property
    def unobservable(self) -> Array:
        """(k, 6) unobservable directions: translations in radii, rotations in radians, unit length."""
        _, directions, observable = spectrum(self.C, self.radius_m)
        return np.asarray(directions[:, ~observable].T)

    @property
    def covariance(self) -> Array:
        """C^-1 (6, 6) [m^2, m rad, rad^2] for one pixel of noise; inf on the diagonal where unobservable.

        The covariances of an unobservable degree of freedom are NaN.
        """
        _, directions, observable = spectrum(self.C, self.radius_m)
        covariance = observable_covariance(self.C, self.radius_m)
        unobservable = is_unobservable(directions, observable)
        covariance[unobservable, :] = np.nan
        covariance[:, unobservable] = np.nan
        covariance[unobservable, unobservable] = np.inf
        return covariance

    @property
    def sigma(self) -> Array:
        """(6,) roots of C^-1's diagonal [m/px, rad/px]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def position_dop(self) -> float:
        """Root of the sum of the translations' variances [m/px], as the PDOP of GPS."""
        return float(np.linalg.norm(self.sigma[:3]))

    @property
    def attitude_dop(self) -> float:
        """Root of the sum of the rotations' variances [rad/px]."""
        return float(np.linalg.norm(self.sigma[3:]))

    @property
    def geometric_dop(self) -> float:
        """Root of the sum of all variances, translations in radii [1/px]."""
        return float(np.linalg.norm(self.sigma / motion_scale(self.radius_m)))

    @property
    def condition(self) -> float:
        """Largest over smallest eigenvalue, translations in radii; inf where a direction is unobservable."""
        values, _, observable = spectrum(self.C, self.radius_m)
        return float(values[-1] / values[0]) if observable.all() else np.inf

    def describe_unobservable(self) -> str:
        """Description of the unobservable directions; empty where the whole pose is observable."""
        if self.points == 0:
            return "no edge is visible: the whole pose is unobservable"
        if len(self.unobservable) == 6:
            return "the visible edges determine no motion: the whole pose is unobservable"
        return "; ".join(_describe(direction) for direction in self.unobservable)


def observability(f: Array, weight: Array, radius_m: float) -> EdgeObservability:
    """C = sum of w f f^T over f (m, 6), weights (m,)."""
    return EdgeObservability((f * weight[:, None]).T @ f, radius_m, len(f))


def _describe(direction: Array) -> str:
    """Description of an unobservable motion (6,)."""
    shift, turn = float(np.linalg.norm(direction[:3])), float(np.linalg.norm(direction[3:]))
    if turn < 0.1:
        return f"translation along {_axis(direction[:3])} is unobservable"
    if shift < 0.1:
        return f"rotation about {_axis(direction[3:])} is unobservable"
    return (
        f"rotation about {_axis(direction[3:])} with translation along {_axis(direction[:3])} "
        f"({shift / turn:.2f} radii per radian) is unobservable"
    )


def _axis(v: Array) -> str:
    """Name of the camera axis that v is nearly parallel to, otherwise its components."""
    unit = v / np.linalg.norm(v)
    main = int(np.argmax(np.abs(unit)))
    if abs(unit[main]) > 0.995:
        return f"the camera's {DEGREES_OF_FREEDOM[main]} axis"
    unit = unit * np.sign(unit[main])
    return f"({unit[0]:.2f}, {unit[1]:.2f}, {unit[2]:.2f}) of the camera"
