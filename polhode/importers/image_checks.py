"""Whether the images contradict the calibration or the timestamps: exchanged cameras, clocks apart.

**Exchanged cameras.** Matches of a pair must lie on the epipolar lines, in front of both cameras. If they do
so only with left and right exchanged, the sources or the calibrations are in the wrong order.

**Clocks apart.** If the right image was taken later than the left one by dt, a feature is off its epipolar
line by what it moved across the line in dt: e_i(-dt) = b, where e_i(t) is the distance [px] of feature i
from its line at time t, a parabola through the right images before, at and after the pair, and b a constant
that a slightly wrong calibration adds. dt and b fit best over all features of several pairs (Tukey's
biweight, Gauss-Newton from the best of a grid). Features whose path bends unlike the others' are wrong.

Errors of one pair's features are alike (light that moves over a surface, b that is no constant), so the
standard deviation is also taken from the scatter between pairs, and the larger one counts (sandwich estimator
with pairs as clusters: Liang and Zeger, "Longitudinal data analysis using generalized linear models",
Biometrika 73, 1986). Two errors are proportional to dt: noise in the speeds makes dt smaller, by its share of
their variance; and a parabola through points of a circle sees less speed than there is, by a share of
w^2 T^2 / 6 for a turn of w T between frames. Both are in the stated sigma, not in that of a dt of 0.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from polhode.files.images import Grey
from polhode.geometry.lie import Array, Bools, Ints
from polhode.importers.calibrations.rig import Rig
from polhode.importers.stereo_matches import EpipolarGeometry, StereoMatches, directions, match_pair
from polhode.runtime.errors import InputError

PAIRS = 8
"""Pairs that are looked at, spread over the recording."""
MAX_SIGMAS = 6.0
SPAN_FRAMES = 1.2
"""Offsets that are tried, either way: beyond the images before and after, a parabola says nothing."""
TUKEY = 4.685
"""Standard deviations beyond which a residual has no weight: 95 % efficiency for normal noise."""


@dataclass(frozen=True)
class ClockOffset:
    """What the right images were taken later than the left ones."""

    dt_s: float
    sigma_s: float
    """With what is proportional to dt"""
    noise_s: float
    """Without it: standard deviation if dt is 0"""
    features: int
    interval_s: float

    @property
    def is_observable(self) -> bool:
        """Whether the motion of the features shows it."""
        return self.noise_s < 0.1 * self.interval_s

    @property
    def is_apart(self) -> bool:
        """Whether the images of a pair were not taken together."""
        off = abs(self.dt_s)
        # smaller offsets [intervals between frames] are not reported; with MAX_SIGMAS none is reported where
        # there is none, over eleven simulated scenes
        return self.is_observable and off > max(MAX_SIGMAS * self.noise_s, 0.05 * self.interval_s)


def match_some(
    read: Callable[[int, int], Grey], stamps_ns: Ints, advance: Callable[[], None] = lambda: None
) -> list[StereoMatches]:
    """Matches of some pairs; ``read`` gives image (camera, k). A pair has one before and one after it."""
    inner = np.arange(1, len(stamps_ns) - 1)
    chosen = inner[np.unique(np.linspace(0, len(inner) - 1, min(PAIRS, len(inner))).astype(int))]
    out = []
    for k in chosen.tolist():
        before_s, after_s = (1e-9 * float(stamps_ns[other] - stamps_ns[k]) for other in (k - 1, k + 1))
        out.append(match_pair(read(0, k), read(1, k), read(1, k - 1), read(1, k + 1), before_s, after_s))
        advance()
    return out


def require_order(matches: Sequence[StereoMatches], rig: Rig, name: str) -> None:
    """Raise InputError if the matches fit the calibration only with left and right exchanged."""
    as_given = sum(_fitting(rig, each.left_px, each.right_px) for each in matches)
    exchanged = sum(_fitting(rig, each.right_px, each.left_px) for each in matches)
    # a chance match has an even chance of either: of 40, more than 32 on one side have less than 1e-4
    if exchanged >= 40 and exchanged > 4.0 * as_given:
        raise InputError(
            f"{name}: the cameras are exchanged: {exchanged} features fit the calibration with left for "
            f"right, and {as_given} as given; exchange the sources, or the cameras of the calibration"
        )


def _fitting(rig: Rig, left_px: Array, right_px: Array) -> int:
    """Number of matches near their epipolar lines and in front of both cameras."""
    geometry = EpipolarGeometry.of(rig)
    left, right = directions(rig.left, left_px), directions(rig.right, right_px)
    off = np.abs((geometry.lines(left) * right).sum(axis=1))
    return int(((off < 3.0) & geometry.in_front(left, right)).sum())


def clock_offset(matches: Sequence[StereoMatches], rig: Rig, interval_s: float) -> ClockOffset | None:
    """The offset that fits best; None: too few features are seen in three right images."""
    parabolas = (
        np.concatenate([_parabolas(each, rig, pair) for pair, each in enumerate(matches)])
        if matches
        else np.empty((0, 5))
    )
    parabolas = parabolas[_plausible(parabolas)] if len(parabolas) else parabolas
    if len(parabolas) < 20:
        return None
    start = min(
        interval_s * np.linspace(-SPAN_FRAMES, SPAN_FRAMES, 97), key=lambda dt: _spread(_at(parabolas, -dt))
    )
    return _refined(parabolas, float(start), interval_s)


def _parabolas(matches: StereoMatches, rig: Rig, pair: int) -> Array:
    """(n, 5) coefficients c, s, q of e(t) = c + s t + q t^2 [px], of the features seen in all right images;
    where each is across its line [px], and the number of the pair."""
    geometry = EpipolarGeometry.of(rig)
    left = directions(rig.left, matches.left_px)
    lines = geometry.lines(left)
    now, before, after = (
        directions(rig.right, points) for points in (matches.right_px, matches.before_px, matches.after_px)
    )
    e0, e1, e2 = ((lines * each).sum(axis=1) for each in (before, now, after))
    t0, t2 = matches.before_s, matches.after_s
    d0, d2 = (e0 - e1) / t0, (e2 - e1) / t2
    q = (d2 - d0) / (t2 - t0)
    # what is further from its line [px] is a wrong match, whatever the clocks
    good = np.isfinite(e0 + e2) & geometry.in_front(left, now) & (np.abs(e1) < 40.0)
    across = (lines[:, :2] * now[:, :2]).sum(axis=1)
    return np.asarray(np.column_stack([e1, d0 - q * t0, q, across, np.full(len(q), pair)])[good])


def _plausible(parabolas: Array) -> Bools:
    """(n,) whether the curvature is that of the others: a wrong match before or after bends the path."""
    q = parabolas[:, 2]
    return np.asarray(np.abs(q - np.median(q)) <= TUKEY * 1.4826 * max(_spread(q), 1e-6))


def _at(parabolas: Array, t_s: float) -> Array:
    return np.asarray(parabolas[:, 0] + parabolas[:, 1] * t_s + parabolas[:, 2] * t_s**2)


def _spread(values: Array) -> float:
    return float(np.median(np.abs(values - np.median(values))))


def _refined(parabolas: Array, dt_s: float, interval_s: float) -> ClockOffset:
    """Gauss-Newton with Tukey's weights from a start; the noise is that of the residuals."""
    b = float(np.median(_at(parabolas, -dt_s)))
    noise_s = scale = np.inf
    for _ in range(20):
        r = _at(parabolas, -dt_s) - b
        scale = max(1.4826 * _spread(r), 1e-3)
        w = np.maximum(1.0 - (r / (TUKEY * scale)) ** 2, 0.0) ** 2
        J = np.column_stack([-(parabolas[:, 1] - 2.0 * parabolas[:, 2] * dt_s), -np.ones(len(r))])
        H = (J * w[:, None]).T @ J
        if not np.linalg.det(H) > 1e-12 * H[0, 0] * H[1, 1]:
            break
        inverse = np.linalg.inv(H)
        step = -inverse @ (J.T @ (w * r))
        dt_s = float(np.clip(dt_s + step[0], -1.5 * interval_s, 1.5 * interval_s))
        b += float(step[1])
        single = float(scale * np.sqrt(inverse[0, 0]))
        noise_s = max(single, _between_pairs(J * (w * r)[:, None], parabolas[:, 4], inverse))
        if abs(step[0]) < 1e-6 * interval_s:
            break
    # of a speed across the line, which is a difference over two intervals
    noise = scale / (np.sqrt(2.0) * interval_s)
    speeds = 1.4826 * _spread(parabolas[:, 1])
    # speeds across the lines that hardly differ by more than their noise: noise alone fits
    if speeds < 3.0 * noise:
        noise_s = np.inf
    share = (noise / speeds) ** 2 + _turn(parabolas) ** 2 * interval_s**2 / 6.0 if speeds > 0.0 else np.inf
    sigma_s = float(np.hypot(noise_s, share * abs(dt_s))) if np.isfinite(noise_s) else np.inf
    return ClockOffset(dt_s, sigma_s, float(noise_s), len(parabolas), interval_s)


def _between_pairs(gradients: Array, pair: Array, inverse: Array) -> float:
    """Standard deviation of dt from the gradients (n, 2) of the features, by how their sums over each pair
    scatter; 0: too few pairs for a scatter."""
    _, number = np.unique(pair, return_inverse=True)
    pairs = int(number.max()) + 1
    if pairs < 4:
        return 0.0
    sums = np.zeros((pairs, 2))
    np.add.at(sums, number, gradients)
    along = sums @ inverse[0]
    return float(np.sqrt(pairs / (pairs - 1.0) * (along**2).sum()))


def _turn(parabolas: Array) -> float:
    """Angular speed [rad/s] at which the features turn: what is higher is pulled back the more."""
    q, across = parabolas[:, 2], parabolas[:, 3]
    off = across - np.median(across)
    slope = float((off * 2.0 * (q - np.median(q))).sum() / max((off**2).sum(), 1e-12))
    return float(np.sqrt(max(-slope, 0.0)))
