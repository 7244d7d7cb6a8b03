"""Which of several motions between the same two frames is that of the body, where light hides it.

Where the light is stronger than the texture, most matches of two frames agree on no motion at all: shading,
highlights and outlines stand still while the body turns beneath them. The motion of the body is then a weaker
hypothesis of the same pair of frames. One pair cannot tell which is which; a sequence can:

1. A body turns smoothly: hypotheses of successive pairs that continue each other form a course of rates.
2. After a revolution the same side is seen again, and matches better than all the others. What stands still
   matches equally well at all times, so a motion is judged by its contrast: the inliers of frames that should
   show the same side, over those of frames that should not.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polhode.backend.initialization.pose_graph import AROUND, NEAR, average_poses, connect
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, log_so3, make_pose
from polhode.records.tracks import RelativePoses

STATIC_RAD = np.deg2rad(5.0)
"""Links of smaller rotation in N may be those of light."""
NOISE_RAD = np.deg2rad(5.0)
CHANGE_RAD = np.deg2rad(2.0)
"""Errors of a link's rotation, and change of the rotation from frame to frame."""
SAME_RATE_RAD = np.deg2rad(3.0)
"""Rates whose rotations between frames differ by less are one [rad per frame]."""
MAX_RATES = 20
"""Rates that are considered in an interval."""
MAX_STEP_RAD = np.deg2rad(5.0)
"""Largest change of the rotation between two frames, from one interval to the next."""
MAX_GAP = 3
"""Intervals without a fitting rate that a course may pass over."""
GAP_COST = 5.0
STEP_COST = 2.0 / np.deg2rad(1.0)
"""Costs of a course, in square roots of inliers: of an interval in a gap; of a change beyond a degree."""
FREE_STEP_RAD = np.deg2rad(1.0)
BAND = 1.2
"""Speeds of a course lie within this factor of one speed, which a body without torque nearly keeps."""
MIN_COURSE = 10
"""Intervals of the shortest course."""
RETURNS = 1.7
"""Inliers of a link between frames that show the same side again, over the median of these frames' links."""
TOLERANCES_DEG = (25.0, 20.0, 15.0, 12.0, 10.0, 8.0)
"""Largest disagreement of the links that are averaged, in successive rounds."""
SAME_SIDE_RAD = np.deg2rad(15.0)
OTHER_SIDE_RAD = np.deg2rad(40.0)
"""Frames whose directions of view differ by less show the same side; by more, another one."""
MIN_PAIRS = 5
FLOOR = 8.0
"""Inliers that any two frames may have."""
MIN_CONTRAST = 2.0
"""Contrast of an accepted course."""
MIN_GAIN = 1.3
"""Contrast of an accepted course, over that of the poses without it."""


@dataclass(frozen=True)
class Rates:
    """Rates that the links around an interval between frames show."""

    turn: Array
    """(m, 3) rotation vectors of the target in N from one frame to the next [rad]"""
    support: Array
    """(m,) square roots of inliers of the links that agree, times their share of the pairs"""


def contrast(X_RG: Array, connected: Bools, inliers: Array) -> float | None:
    """Inliers of frames that show the same side, over those of frames that show another one; medians.

    X_RG (F, 4, 4), connected (F,); inliers (F, F) of the best link of each pair, symmetric, 0 without a link.
    Near frames are left out: they match in any case. None if there are too few pairs of either kind. The side
    is that towards the camera's optical axis: where G's origin is does not matter.
    """
    view_G = X_RG[:, 2, :3]
    angle = np.arccos(np.clip(view_G @ view_G.T, -1.0, 1.0))
    frames = np.arange(len(X_RG))
    later = (frames[None, :] - frames[:, None] > NEAR) & connected[:, None] & connected[None, :]
    same, other = later & (angle < SAME_SIDE_RAD), later & (angle > OTHER_SIDE_RAD)
    if min(same.sum(), other.sum()) < MIN_PAIRS:
        return None
    return float(np.median(inliers[same]) / max(float(np.median(inliers[other])), FLOOR))


def contrast_of_links(links: RelativePoses, time_s: Array, R_NR: Array) -> float | None:
    """Contrast of the poses that the links lead to; time_s (F,) [s], R_NR (F, 3, 3) of the camera."""
    X_RG, connected, _ = connect(links, time_s, R_NR)
    return contrast(X_RG, connected, best_inliers(links, len(time_s)))


def best_inliers(links: RelativePoses, n_frames: int) -> Array:
    """Inliers (F, F) of the best link of each pair of frames, symmetric."""
    best = np.zeros((n_frames, n_frames))
    np.maximum.at(best, (links.i, links.j), links.inliers)
    return np.maximum(best, best.T)


def links_of_the_body(
    links: RelativePoses, time_s: Array, R_NR: Array, present: float | None
) -> Bools | None:
    """Which links (E,), of several for each pair of frames, belong to the course of most contrast.

    time_s (F,) [s], R_NR (F, 3, 3) attitudes of the camera; ``present``: contrast of the known poses.
    None: no course has enough contrast, or not clearly more than there is.
    """
    inliers = best_inliers(links, len(time_s))
    turn_N = R_NR[links.j] @ np.swapaxes(links.X_RiRj[:, :3, :3], 1, 2) @ np.swapaxes(R_NR[links.i], 1, 2)
    best, most = None, max(MIN_CONTRAST, MIN_GAIN * (present or 0.0))
    everywhere = np.ones(len(time_s), dtype=bool)
    returns = _returns(links, inliers)
    for turns in _courses(_rates(links, turn_N, time_s), time_s):
        X_RG, selected = _averaged(links, turns, R_NR, returns)
        found = contrast(X_RG, everywhere, inliers)
        if found is not None and found > most:
            best, most = selected, found
    return best


def _rates(links: RelativePoses, turn_N: Array, time_s: Array) -> list[Rates]:
    """Rates around each of the F - 1 intervals, those of most support first; without those of light."""
    step_s = float(np.median(np.diff(time_s)))
    span_s = time_s[links.j] - time_s[links.i]
    near = np.flatnonzero((links.j - links.i <= NEAR) & (_angle(turn_N) > STATIC_RAD))
    middle, frames = 0.5 * (links.i + links.j)[near], span_s[near] / step_s
    vector, pair = log_so3(turn_N[near]), links.i[near] * len(time_s) + links.j[near]
    root = np.sqrt(links.inliers[near].astype(np.float64))
    found = []
    for k in range(len(time_s) - 1):
        around = np.flatnonzero(np.abs(middle - (k + 0.5)) <= AROUND)
        seeds = around[(links.i[near[around]] <= k) & (links.j[near[around]] > k) & (frames[around] < 2.5)]
        of = near[around]
        rates = [
            _supported(vector[seed] / frames[seed], turn_N[of], frames[around], pair[around], root[around])
            for seed in seeds
        ]
        found.append(_distinct(rates))
    return found


def _supported(turn: Array, turns_N: Array, frames: Array, pair: Ints, root: Array) -> tuple[Array, float]:
    """A rate (3,) [rad per frame] as the mean of the links that agree with it, and its support."""
    pairs, support = len(np.unique(pair)), 0.0
    for last in (False, True):
        off = _angle(np.swapaxes(exp_so3(turn * frames[:, None]), 1, 2) @ turns_N)
        agree = np.flatnonzero(off < NOISE_RAD + CHANGE_RAD * frames)
        if len(agree) == 0:
            return turn, 0.0
        # of two links of one pair, that of more inliers
        strongest = agree[np.argsort(-root[agree], kind="stable")]
        chosen = strongest[np.unique(pair[strongest], return_index=True)[1]]
        support = float(root[chosen].sum()) * len(chosen) / pairs
        if not last:
            weight = root[chosen] * frames[chosen]
            each = log_so3(turns_N[chosen]) / frames[chosen, None]
            turn = np.asarray(weight @ each / weight.sum())
    return turn, support


def _distinct(rates: list[tuple[Array, float]]) -> Rates:
    """The rates of most support, each different from those before it."""
    kept: list[tuple[Array, float]] = []
    for turn, support in sorted(rates, key=lambda rate: -rate[1]):
        if support > 0.0 and all(np.linalg.norm(turn - other) > SAME_RATE_RAD for other, _ in kept):
            kept.append((turn, support))
        if len(kept) == MAX_RATES:
            break
    return Rates(np.array([t for t, _ in kept]).reshape(-1, 3), np.array([s for _, s in kept]))


def _courses(rates: list[Rates], time_s: Array) -> Iterator[Array]:
    """Turns (F - 1, 3) from frame to frame in N of the best course at each speed [rad per frame]."""
    speeds = [np.linalg.norm(r.turn, axis=1) for r in rates]
    every = np.concatenate(speeds) if speeds else np.zeros(0)
    if len(every) == 0:
        return
    share = np.diff(time_s) / float(np.median(np.diff(time_s)))
    known: set[tuple[tuple[int, int], ...]] = set()
    for speed in np.geomspace(
        every.min(), every.max(), 1 + int(np.log(every.max() / every.min()) / np.log(BAND))
    ):
        allowed = [(s > speed / BAND) & (s < speed * BAND) for s in speeds]
        course = _best_course(rates, allowed)
        if len(course) >= min(MIN_COURSE, len(rates)) and course not in known:
            known.add(course)
            at = np.array([k for k, _ in course])
            turn = np.array([rates[k].turn[m] for k, m in course])
            nearest = np.abs(at[None, :] - np.arange(len(rates))[:, None]).argmin(axis=1)
            yield turn[nearest] * share[:, None]


def _best_course(rates: list[Rates], allowed: list[Bools]) -> tuple[tuple[int, int], ...]:
    """The intervals and their rates with most support that continue each other (Viterbi 1967)."""
    total: list[Array] = []
    before: list[list[tuple[int, int]]] = []
    for k, here in enumerate(rates):
        value = np.where(allowed[k], here.support, -np.inf)
        origin = [(-1, -1)] * len(value)
        for m in np.flatnonzero(allowed[k]).tolist():
            most = 0.0
            for gap in range(1, min(MAX_GAP + 1, k) + 1):
                step = np.linalg.norm(rates[k - gap].turn - here.turn[m], axis=1)
                reached = (
                    total[k - gap] - STEP_COST * np.maximum(step - FREE_STEP_RAD, 0.0) - GAP_COST * (gap - 1)
                )
                reached = np.where(step < MAX_STEP_RAD * (1.0 + 0.3 * (gap - 1)), reached, -np.inf)
                if len(reached) and reached.max() > most:
                    most, origin[m] = float(reached.max()), (k - gap, int(reached.argmax()))
            value[m] += most
        total.append(value)
        before.append(origin)
    ends = [(float(value.max(initial=-np.inf)), k) for k, value in enumerate(total)]
    score, k = max(ends)
    if not np.isfinite(score):
        return ()
    m, course = int(total[k].argmax()), []
    while k >= 0:
        course.append((k, m))
        k, m = before[k][m]
    return tuple(reversed(course))


def _returns(links: RelativePoses, inliers: Array) -> Bools:
    """Links (E,) between frames far apart in time that have many more inliers than others of these frames."""
    frames = np.arange(len(inliers))
    far = (np.abs(frames[:, None] - frames[None, :]) > NEAR) & (inliers > 0)
    usual = np.array(
        [np.median(row[at]) if at.any() else np.inf for row, at in zip(inliers, far, strict=True)]
    )
    more = links.inliers > RETURNS * np.maximum(usual[links.i], usual[links.j])
    return np.asarray(more & (links.j - links.i > NEAR))


def _averaged(links: RelativePoses, turns: Array, R_NR: Array, returns: Bools) -> tuple[Array, Bools]:
    """Poses X_RG (F, 4, 4) of a course, corrected by links that agree with it, and which these are (E,)."""
    R_NG = [np.eye(3)]
    for turn in exp_so3(turns):
        R_NG.append(turn @ R_NG[-1])
    X_RG = make_pose(np.swapaxes(R_NR, 1, 2) @ np.array(R_NG), np.zeros((len(R_NG), 3)))
    everywhere = np.ones(len(X_RG), dtype=bool)
    off = rotation_errors(links, X_RG)
    near = links.j - links.i <= NEAR
    selected = _one_a_pair(
        links, off, (near & (off < np.deg2rad(10.0))) | (returns & (off < np.deg2rad(70.0)))
    )
    X_RG = average_poses(X_RG, everywhere, links, selected)
    for tolerance_deg in TOLERANCES_DEG:
        off = rotation_errors(links, X_RG)
        selected = _one_a_pair(links, off, off < np.deg2rad(tolerance_deg))
        X_RG = average_poses(X_RG, everywhere, links, selected)
    return X_RG, selected


def rotation_errors(links: RelativePoses, X_RG: Array) -> Array:
    """Angle (E,) [rad] between the rotation of each link and that of the poses X_RG (F, 4, 4)."""
    R_ij = X_RG[links.i, :3, :3] @ np.swapaxes(X_RG[links.j, :3, :3], 1, 2)
    return _angle(np.swapaxes(R_ij, 1, 2) @ links.X_RiRj[:, :3, :3])


def _one_a_pair(links: RelativePoses, off: Array, good: Bools) -> Bools:
    """Of the good links (E,) of each pair of frames, the one that is off by least."""
    index = np.flatnonzero(good)
    order = index[np.argsort(off[index], kind="stable")]
    pair = links.i[order] * (int(links.j.max(initial=0)) + 1) + links.j[order]
    chosen = np.zeros(len(good), dtype=bool)
    chosen[order[np.unique(pair, return_index=True)[1]]] = True
    return chosen


def _angle(R: Array) -> Array:
    """Angles (...) of rotations (..., 3, 3) [rad]."""
    return np.asarray(np.arccos(np.clip(0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0)))
