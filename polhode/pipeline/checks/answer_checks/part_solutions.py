"""Whether parts of the measurements, solved apart, give the same motion within their standard deviations.

- Forward prediction: the first part of the sequence, continued by the dynamics, against the whole. A wrong
  inertia, a wrong clock, a push or a change of the body bends the rest away from the prediction.
- Halves: two disjoint sets of landmarks, chosen at random. Errors that each landmark has by itself scatter as
  the sigmas say, or more.
- Outline and interior: landmarks near the outline of what is seen of them, and the others. Outlines and
  rings of a body of revolution that stand still, errors of depth at oblique surfaces and a wrong calibration
  move the two apart.

What all landmarks share, as a shift of the whole target, none of them shows.

Of estimates from disjoint measurements the difference has the sum of both covariances. Of an estimate from a
part of the other's measurements it has the part's less the whole's (Hausman, "Specification Tests in
Econometrics", Econometrica 46, 1978), of which the part's is a bound that stays positive. What both take from
the same source, as the disturbances of the dynamics, makes the sum too large, so agreement then looks closer
than it is.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from polhode.backend.subset_solution import estimate_part
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, Ints, log_so3
from polhode.records.estimate import MotionEstimate
from polhode.records.tracks import StereoTracks
from polhode.run_directory.check_table import frame_step, make_check
from polhode.run_directory.summary_schema import Check


@dataclass(frozen=True)
class Disagreement:
    """The quantity in which two estimates differ most."""

    quantity: str
    sigmas: float
    """Root mean square of its components, in standard deviations of the difference"""


def part_checks(tracks: StereoTracks, estimate: MotionEstimate, config: Backend) -> list[Check]:
    """Forward prediction, halves, outline and interior."""
    frames = np.arange(0, tracks.n_frames, frame_step(tracks.n_frames))

    def compare(key: str, first: Bools, second: Bools, at: Ints, contained: bool, **facts: Any) -> Check:
        """Of two sets of observations (M,), with states in ``frames``."""
        a, b = (estimate_part(tracks, estimate, config, rows, frames) for rows in (first, second))
        found = None if a is None or b is None else largest(disagreements(a, b, at, contained))
        if found is None:
            return make_check(key, None)
        return make_check(key, found.sigmas, quantity=found.quantity, **facts)

    until = int(np.quantile(tracks.frame, 0.7)) if len(tracks.frame) else 0
    early, every = tracks.frame <= until, tracks.frame <= tracks.n_frames
    half = (np.random.default_rng(0).permutation(tracks.n_landmarks) % 2 == 0)[tracks.landmark]
    outer, inner = outline_and_interior(tracks, estimate)
    states = np.arange(len(frames))
    return [
        compare("prediction", early, every, states[-1:], contained=True, until_s=tracks.time_s[until]),
        compare("halves", half, ~half, states, contained=False),
        compare("outline", outer, inner, states, contained=False),
    ]


def outline_and_interior(tracks: StereoTracks, estimate: MotionEstimate) -> tuple[Bools, Bools]:
    """Observations (M,) of the landmarks that are nearer to the outline, and of the others.

    The outline of a frame is the convex hull of its landmarks in the image; the distance from it, over the
    radius of a disc of its area, is averaged over a landmark's frames.
    """
    good = estimate.inlier_weight > 0.0
    distance = np.full(len(tracks.frame), np.nan)
    order = np.argsort(tracks.frame, kind="stable")
    bounds = np.searchsorted(tracks.frame[order], np.arange(tracks.n_frames + 1))
    for k in range(tracks.n_frames):
        own = order[bounds[k] : bounds[k + 1]]
        own = own[good[own]]
        if len(own) < 8:
            continue
        uv = tracks.uvd_px[own, :2]
        try:
            hull = ConvexHull(uv)
        except QhullError:
            continue
        inwards = -np.max(hull.equations[:, :2] @ uv.T + hull.equations[:, 2:], axis=0)
        # of a plane hull, Qhull's volume is the area
        distance[own] = inwards / max(float(np.sqrt(hull.volume / np.pi)), 1.0)
    known = np.isfinite(distance)
    count = np.bincount(tracks.landmark[known], minlength=tracks.n_landmarks)
    mean = np.bincount(tracks.landmark[known], distance[known], tracks.n_landmarks) / np.maximum(count, 1)
    of_landmark = mean[tracks.landmark]
    outer = known & (of_landmark <= np.median(of_landmark[known])) if known.any() else known
    return outer, known & ~outer


def disagreements(a: MotionEstimate, b: MotionEstimate, at: Ints, contained: bool) -> list[Disagreement]:
    """By quantity, those that both determine: position and velocity in the frames ``at``, rotation since the
    first frame and rate in the last one, ratios of inertia.

    ``contained``: the measurements of ``a`` are among those of ``b``.
    """
    # by quantity: a minus b (n,), covariance of a (n, n), of b (n, n)
    pairs: dict[str, list[tuple[Array, Array, Array]]] = {}
    for name, part, d in (("position", slice(0, 3), a.r_N - b.r_N), ("velocity", slice(3, 6), a.v_N - b.v_N)):
        pairs[name] = [(d[k], a.covariance[k, part, part], b.covariance[k, part, part]) for k in at]
    P_a, P_b = a.covariance_last_body, b.covariance_last_body
    if P_a is not None and P_b is not None:
        R_a, R_b = (each.X_NG[0, :3, :3].T @ each.X_NG[-1, :3, :3] for each in (a, b))
        rotation, rate = slice(6, 9), slice(9, 12)
        pairs["rotation"] = [(log_so3(R_b.T @ R_a), P_a[rotation, rotation], P_b[rotation, rotation])]
        w_a, w_b = (each.mass.R_GP @ each.w_P[-1] for each in (a, b))
        pairs["rate"] = [(w_a - w_b, P_a[rate, rate], P_b[rate, rate])]
    k = np.array([a.mass.k1 - b.mass.k1, a.mass.k2 - b.mass.k2])
    pairs["inertia"] = [(k, a.mass.cov_k, b.mass.cov_k)]
    found = []
    for name, each in pairs.items():
        squares = [s for s in (_mean_square(*pair, contained) for pair in each) if s is not None]
        if squares:
            found.append(Disagreement(name, float(np.sqrt(np.mean(squares)))))
    return found


def largest(found: list[Disagreement]) -> Disagreement | None:
    """The quantity that differs most; None: none is determined."""
    return max(found, key=lambda each: each.sigmas, default=None)


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
