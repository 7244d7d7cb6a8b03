"""Speed of the surface past an inspector at rest, and the points that a grapple would meet most slowly."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, hat
from polhode.planning.prediction import BodyMotion
from polhode.records.estimate import Prediction

MAX_INSTANTS = 200


@dataclass(frozen=True)
class SurfaceSpeed:
    """Of points fixed to the target, relative to an inspector at rest in N."""

    now_m_s: Array
    """(V,) at the last stereo pair"""
    largest_m_s: Array
    """(V,) over the horizon"""
    mean_m_s: Array
    """(V,)"""
    normal_m_s: Array
    """(V,) along the outward normal at the last pair; positive: towards an observer in front of it"""
    sigma_m_s: Array
    """(V,) standard deviation of the speed at the last pair"""


def surface_speed(
    motion: BodyMotion,
    p_G: Array,
    normal_G: Array,
    covariance_body: Array,
    others: Sequence[BodyMotion] = (),
) -> SurfaceSpeed:
    """Speeds of points (V, 3) in G; the motion begins at the last pair. The largest speed is that of the
    ``others``, too: further hypotheses of the rotation.

    covariance_body (20, 20) of ``FinalState``. A point moves with v + w x (p - com).
    """
    largest, mean = _largest_and_mean(motion, p_G)
    for other in others:
        largest = np.maximum(largest, _largest_and_mean(other, p_G)[0])
    u = velocity(motion, 0, p_G)
    now = np.linalg.norm(u, axis=1)
    R = motion.R_NG[0]
    along_G = np.divide(u, now[:, None], out=np.zeros_like(u), where=now[:, None] > 0.0) @ R
    return SurfaceSpeed(
        now,
        largest,
        mean,
        np.einsum("ij,ij->i", u @ R, normal_G),
        _sigma(motion, R, p_G, along_G, covariance_body),
    )


def _largest_and_mean(motion: BodyMotion, p_G: Array) -> tuple[Array, Array]:
    """Speeds (V,) of points (V, 3) over the motion."""
    chosen = np.unique(np.linspace(0, len(motion.time_s) - 1, MAX_INSTANTS).round().astype(int))
    total, largest = np.zeros(len(p_G)), np.zeros(len(p_G))
    for k in chosen:
        # as velocity(), with one product per point: u = p_G A + b
        R, spin = motion.R_NG[k], hat(motion.w_N[k])
        lever = motion.p_NG[k] - motion.com_N[k]
        u = p_G @ (spin @ R).T + (motion.v_N[k] + spin @ lever)
        speed = np.sqrt(np.einsum("ij,ij->i", u, u))
        total, largest = total + speed, np.maximum(largest, speed)
    return largest, total / len(chosen)


def velocity(motion: BodyMotion, k: int | slice, p_G: Array) -> Array:
    """Of points (V, 3) fixed to the target, along N [m/s]: (V, 3) at instant k of the motion, or (T, V, 3) at
    the T instants of a slice.
    """
    rotated = p_G @ np.swapaxes(motion.R_NG[k], -1, -2)
    lever = rotated + motion.p_NG[k][..., None, :] - motion.com_N[k][..., None, :]
    return np.asarray(motion.v_N[k][..., None, :] + np.cross(motion.w_N[k][..., None, :], lever))


def velocity_covariance(prediction: Prediction, lever_P: Array) -> Array:
    """Covariance (T, V, 3, 3) along N [(m/s)^2] of the velocities of points fixed to the target.

    lever_P (V, 3): from the estimated centre of mass, along the estimated axes [m]. These are exact marks on
    the body in ``covariance_of_marks``, which has the uncertain centre of mass in r and v. So the velocity is
    v + R (w x lever) with an exact lever, to first order in v, theta and w.
    """
    R = prediction.R_NP[:, None]
    jacobian = np.concatenate(
        [
            np.broadcast_to(np.eye(3), (len(R), len(lever_P), 3, 3)),
            -R @ hat(np.cross(prediction.w_P[:, None], lever_P)),
            -R @ hat(lever_P),
        ],
        axis=-1,
    )
    covariance = prediction.covariance_of_marks[:, None, 3:, 3:]
    return np.asarray(jacobian @ covariance @ np.swapaxes(jacobian, -1, -2))


def _sigma(motion: BodyMotion, R: Array, p_G: Array, along_G: Array, covariance: Array) -> Array:
    """The velocity is v + R w_G x (p - com); the length of its change along itself, to first order."""
    lever = p_G - (motion.com_N[0] - motion.p_NG[0]) @ R
    w_G = motion.w_N[0] @ R
    by_attitude = np.cross(np.cross(w_G, lever), along_G)
    slopes = np.concatenate(
        [along_G @ R.T, by_attitude, np.cross(lever, along_G), -np.cross(along_G, w_G)], axis=1
    )
    chosen = np.r_[3:12, 17:20]
    part = covariance[np.ix_(chosen, chosen)]
    return np.asarray(np.sqrt(np.maximum(np.einsum("vi,ij,vj->v", slopes, part, slopes), 0.0)))


def slowest_points(speed: Array, p_G: Array, separation_m: float, count: int) -> list[int]:
    """Indices of the slowest points (V,), with at least this separation."""
    chosen: list[int] = []
    for n in np.argsort(speed, kind="stable"):
        if all(np.linalg.norm(p_G[n] - p_G[m]) >= separation_m for m in chosen):
            chosen.append(int(n))
            if len(chosen) == count:
                break
    return chosen
