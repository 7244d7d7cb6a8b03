"""How far two estimates of the same motion differ, in the standard deviations of their difference.

Of estimates from disjoint measurements the difference has the sum of both covariances. Of an estimate from a
part of the other's measurements it has the part's less the whole's (Hausman, "Specification Tests in
Econometrics", Econometrica 46, 1978), of which the part's is a bound that stays positive. What both take from
the same source, as the disturbances of the dynamics, makes the sum too large, so agreement then looks closer
than it is.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.lie import Array, log_so3
from polhode.records import Ints, MotionEstimate


@dataclass(frozen=True)
class Disagreement:
    """The quantity in which two estimates differ most."""

    quantity: str
    sigmas: float
    """Root mean square of its components, in standard deviations of the difference"""


def disagreements(a: MotionEstimate, b: MotionEstimate, at: Ints, contained: bool) -> list[Disagreement]:
    """By quantity, those that both determine: position and velocity in the frames ``at``, rotation since the
    first frame and rate in the last one, ratios of inertia.

    ``contained``: the measurements of ``a`` are among those of ``b``.
    """
    found = []
    for name, pairs in _differences(a, b, at):
        squares = [s for s in (_mean_square(*pair, contained) for pair in pairs) if s is not None]
        if squares:
            found.append(Disagreement(name, float(np.sqrt(np.mean(squares)))))
    return found


def largest(found: list[Disagreement]) -> Disagreement | None:
    """The quantity that differs most; None: none is determined."""
    return max(found, key=lambda each: each.sigmas, default=None)


Difference = tuple[Array, Array, Array]
"""a minus b (n,), covariance of a (n, n), of b (n, n)"""


def _differences(a: MotionEstimate, b: MotionEstimate, at: Ints) -> Iterator[tuple[str, list[Difference]]]:
    for name, part, x, y in (
        ("position", slice(0, 3), a.r_N, b.r_N),
        ("velocity", slice(3, 6), a.v_N, b.v_N),
    ):
        yield (
            name,
            [(x[k] - y[k], a.covariance[k, part, part], b.covariance[k, part, part]) for k in at],
        )
    P_a, P_b = a.covariance_last_body, b.covariance_last_body
    if P_a is not None and P_b is not None:
        R_a, R_b = (each.X_NG[0, :3, :3].T @ each.X_NG[-1, :3, :3] for each in (a, b))
        rotation, rate = slice(6, 9), slice(9, 12)
        yield "rotation", [(log_so3(R_b.T @ R_a), P_a[rotation, rotation], P_b[rotation, rotation])]
        w_a, w_b = (each.mass.R_GP @ each.w_P[-1] for each in (a, b))
        yield "rate", [(w_a - w_b, P_a[rate, rate], P_b[rate, rate])]
    k = np.array([a.mass.k1 - b.mass.k1, a.mass.k2 - b.mass.k2])
    yield "inertia", [(k, a.mass.cov_k, b.mass.cov_k)]


def _mean_square(difference: Array, P_a: Array, P_b: Array, contained: bool) -> float | None:
    """Mean square of the whitened components that both determine; None: there are none."""
    known = np.isfinite(np.diagonal(P_a)) & np.isfinite(np.diagonal(P_b)) & (np.diagonal(P_a) > 0.0)
    if not known.any():
        return None
    covariance = P_a[np.ix_(known, known)]
    if not contained:
        covariance = covariance + P_b[np.ix_(known, known)]
    d = difference[known]
    return float(d @ np.linalg.solve(covariance, d)) / len(d)
