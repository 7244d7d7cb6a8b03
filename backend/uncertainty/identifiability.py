"""What the motion determines: eigenvectors of the information on com_G and inertia, without prior.

The scales are 1 cm for the centre of mass, 0.2 for k1 and k2, and 0.3 rad for the axes; a direction whose
scaled standard deviation exceeds 0.3 is undetermined: 3 mm, 0.06, 5 degrees. Directions that a spin without
nutation does not excite have 0.5 to 20 and more, those that a tumbling motion excites less than 0.25
(``tests/backend/uncertainty/test_identifiability.py`` has such motions).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from polhode.backend.solvers.gauss_newton import CONSTANT_SCALE
from polhode.backend.uncertainty.principal_axes import AxesDerivative, free_axis_covariance, ratio_covariance
from polhode.geometry.lie import Array, Bools
from polhode.records.estimate import Identifiability

SCALE = np.array([0.01, 0.01, 0.01, 0.2, 0.2, 0.3, 0.3, 0.3])

LIMIT = 0.3
CAP = 10.0
"""Scaled sigma of a direction without information: bounds the effect of rounding on other directions."""
NAMES = ("com_x", "com_y", "com_z", "k1", "k2", "axes_x", "axes_y", "axes_z")


@dataclass(frozen=True)
class IdentifiabilityAnalysis:
    """The result, and the undetermined directions."""

    record: Identifiability
    lost: Array
    """(8, m) unit scaled directions, as changes of (com_G, xi)"""
    turned: Array
    """(8, n) the same for each rotation of the axes that is undetermined"""

    @property
    def lost_constants(self) -> Bools:
        """(8,) components of com_G and xi that an undetermined direction involves."""
        return np.asarray(np.abs(self.lost).max(axis=1, initial=0.0) > 0.1 * CONSTANT_SCALE)


def analyse(
    information: Array, derivative: AxesDerivative, w_P: Array, apart_sigmas: float = 2.0
) -> IdentifiabilityAnalysis:
    """information (8, 8) of (com_G, xi) without prior; w_P (F, 3) the rates, for the reason that is given.

    apart_sigmas: moments that are nearer to each other may be equal.
    """
    # d(com_G, xi) / d(com_P, k1, k2, theta), scaled
    to_solver = block_diag(derivative.R_GP, np.linalg.inv(np.vstack([derivative.ratios, derivative.axes])))
    to_solver = to_solver * SCALE
    values, vectors = np.linalg.eigh(to_solver.T @ information @ to_solver)
    sigma = 1.0 / np.sqrt(np.maximum(values, CAP**-2))
    lost = sigma > LIMIT
    share = np.sqrt(np.sum((vectors[:, lost] * sigma[lost]) ** 2, axis=1))
    good = share <= LIMIT
    covariance = (vectors * sigma**2) @ vectors.T * SCALE[:, None] * SCALE
    total = np.sqrt(np.diag(covariance))
    in_solver = to_solver / SCALE
    of_ratios = ratio_covariance(derivative, (in_solver @ covariance @ in_solver.T)[3:, 3:])
    total[3:5] = np.maximum(total[3:5], np.sqrt(np.diag(of_ratios)))
    good[3:5] &= total[3:5] <= LIMIT * SCALE[3:5]
    # axes whose moments may be equal are free to turn, however large the estimated difference
    k = np.log(derivative.moments[:2] / derivative.moments[1:])
    equal = ~good[3:5] | (k < apart_sigmas * total[3:5])
    good[[7, 5]] &= ~equal
    good[6] &= not equal.all()
    # Without both ratios the order of the moments is unknown, and so are the axes. A spin about any axis of a
    # nearly spherical body looks like one about a principal axis of another: errors of 60 degrees were
    # observed.
    good[5:] &= good[3:5].all()
    total[5:] = np.sqrt(np.diag(free_axis_covariance(covariance[5:, 5:], ~good[5:])))
    good[5:] &= total[5:] <= LIMIT * SCALE[5:]
    detail = {name: _description(n, good, total, w_P) for n, name in enumerate(NAMES)}
    record = Identifiability(
        k1=bool(good[3]),
        k2=bool(good[4]),
        com=bool(good[:3].all()),
        axes=bool(good[5:].all()),
        detail=detail,
        com_P=good[:3],
        axes_P=good[5:],
        sigma=np.where(good, total, np.inf),
    )
    return IdentifiabilityAnalysis(record, to_solver @ vectors[:, lost], to_solver[:, 5:][:, ~good[5:]])


def with_more(known: Identifiability, sigma: Array) -> Identifiability:
    """With further independent errors of standard deviations (8,), in the units of ``sigma``, in sigmas and
    descriptions; what is determined stays so."""
    both, detail = np.hypot(known.sigma, sigma), dict(known.detail)
    changed = np.isfinite(both) & (sigma > 0.0)
    detail |= {NAMES[n]: determined_description(n, both[n]) for n in np.flatnonzero(changed).tolist()}
    return replace(known, sigma=both, detail=detail)


def determined_description(n: int, sigma: float) -> str:
    """Description of quantity n of NAMES when its standard deviation is sigma [m, 1, rad]."""
    unit = "mm" if n < 3 else "" if n < 5 else "deg"
    number = sigma * (1e3 if n < 3 else 1.0 if n < 5 else np.rad2deg(1.0))
    return f"determined, standard deviation about {number:.2g} {unit}".strip()


def _description(n: int, good: Bools, sigma: Array, w_P: Array) -> str:
    if good[n]:
        return determined_description(n, sigma[n])
    mean_square = np.mean(w_P**2, axis=0)
    rate = np.sqrt(mean_square.sum())
    if rate < 0.01:
        return "not determined: the target hardly rotates"
    spin = int(np.argmax(mean_square))
    steady = mean_square[spin] > 0.98 * mean_square.sum()
    about = f"the {'xyz'[spin]} principal axis"
    if n < 3:
        if steady and n == spin:
            return f"not determined: the target spins about {about}, a shift along it moves nothing"
        return "not determined: the rotation moves the centre of mass too little in the body"
    if steady:
        return f"not determined: the target spins steadily about {about}, without nutation"
    return "not determined: the motion is too short, or two moments are too nearly equal"


def undetermined_states(
    determined: IdentifiabilityAnalysis, jacobians: Array, response: Array, w_P: Array
) -> Bools:
    """Components (F, 12) of the states that change along an undetermined direction.

    jacobians (F, 12, s + 8) of the states in their own s variables and the constants; response (s F, 8).
    """
    change = _largest_change(determined.lost, jacobians, response)
    of_axes = np.hstack([determined.lost, determined.turned])
    change[:, 6:] = _largest_change(of_axes, jacobians, response)[:, 6:]
    rate = max(float(np.sqrt(np.mean(np.sum(w_P**2, axis=1)))), 0.01)
    # the prior bounds r and v; the axes may be far off, where the linear change is not meaningful
    lost = change > np.repeat([0.3 * 0.01, 0.3 * 0.01 * rate, 0.01, 0.002 * rate], 3)
    free = ~determined.record.axes_P
    if np.sum(free) >= 2:
        # the axes may even be exchanged: no component in P is known
        lost[:, 6:] = True
    elif free.any():
        # the other two may be turned by any angle, which mixes the rates about them; one may just be 0
        across = 9 + np.flatnonzero(~free)
        lost[:, across] |= lost[:, across].any(axis=1, keepdims=True)
    return np.asarray(lost)


def _largest_change(directions: Array, jacobians: Array, response: Array) -> Array:
    """Root of the summed squares (F, 12) of the states' changes along directions (8, m)."""
    n_frames = len(jacobians)
    own = response.reshape(n_frames, -1, 8) @ directions
    constants = np.broadcast_to(directions, (n_frames, *directions.shape))
    return np.asarray(np.linalg.norm(jacobians @ np.concatenate([own, constants], axis=1), axis=2))
