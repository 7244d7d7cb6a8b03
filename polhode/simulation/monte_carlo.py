"""Monte Carlo measurements without images: a rigid body tumbles, a stereo camera sees its landmarks.

Deterministic by seed. For tests and benchmarks of the back end: the records are those of the front end.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_fit import nearest_rotation
from polhode.records.tracks import RelativePoses, StereoTracks, Wrench
from polhode.records.truth import Truth
from polhode.runtime.compiled import compiled
from polhode.simulation.motion.inspector import limit_cycle

Vector = tuple[float, float, float]
RPM = 2.0 * np.pi / 60.0
J_SPHERES = np.array(
    [[2.41e-2, -1.3e-4, -1.42e-4], [-1.3e-4, 2.34e-2, 5.74e-5], [-1.42e-4, 5.74e-5, 2.01e-2]]
)
"""Inertia of the thesis's satellite (eq. 6.1) [kg m^2]: nearly equal upper moments."""
RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)
NO_LINKS = RelativePoses(
    np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4)), np.zeros(0, dtype=np.int64)
)


@dataclass(frozen=True)
class SyntheticScene:
    """A body, its motion and the camera. Lengths [m], rates [rad/s]."""

    frames: int = 115
    dt_s: float = 0.5
    jitter: float = 0.0
    """Share of the interval by which a frame comes early or late, at most."""
    landmarks: int = 2430
    detection: float = 0.21
    """Probability that a visible landmark is measured in a frame."""
    shape: Literal["sphere", "box"] = "sphere"
    radius_m: float = 0.11
    J_G: Array | None = None
    """(3, 3) inertia about the centre of mass, axes of G; ``J_SPHERES`` when absent."""
    com_G: tuple[float, float, float] = (3.88e-3, -1.49e-3, 1.92e-3)
    w_G: tuple[float, float, float] = (0.5 * RPM, 10.0 * RPM, 0.5 * RPM)
    r_N: tuple[float, float, float] = (-0.03, -0.02, 0.6)
    v_N: tuple[float, float, float] = (2e-3, 1e-3, 2e-3)
    sigma_uv_px: float = 1.0
    sigma_d_px: float = 1.0
    outliers: float = 0.0
    """Share of gross errors: uniform within 40 px."""
    dropped: tuple[int, ...] = ()
    """Frames without measurements."""
    accel_psd: float = 1e-6
    torque_psd: float = 1e-6
    """Process noise as in the back end's config; 0: none."""
    loop_closure: bool = True
    """False: a landmark that returns into view is a new one."""
    camera_moves: bool = False
    station_keeping: bool = False
    """The camera follows the target's drift, so that the view stays the same throughout."""
    deadband_m: tuple[float, float] = (0.0, 0.0)
    """Dead band of the camera along each axis of N: half width [m], drift [m/s]; zeros: no jitter."""
    deadband_rad: tuple[float, float] = (0.0, 0.0)
    """The same of its attitude about its own axes: half width [rad], drift [rad/s]."""
    sigma_camera_p_m: float = 0.0
    """Noise of the reported camera position, independent from frame to frame [m]."""
    sigma_camera_theta_rad: float = 0.0
    """The same of its attitude [rad]."""
    mass_kg: float = 4.487
    """Of the thesis's satellite; with ``J_G`` in kg m^2."""
    pushes: tuple[tuple[float, float, Vector, Vector], ...] = ()
    """Known: start [s], duration [s], force along N [N], torque along the principal axes [N m]."""
    wrong_pairs: float = 0.0
    """Share of the relative poses that are wrong, with few inliers."""
    min_inliers: int = 8
    """Pairs of frames with fewer common landmarks have no relative pose."""
    links: bool = True
    """False: no relative poses, of which a long sequence has too many."""


@dataclass(frozen=True)
class SyntheticSequence:
    """Measurements with the truth behind them."""

    tracks: StereoTracks
    relative: RelativePoses
    truth: Truth
    X_NG: Array
    """(F, 4, 4)"""
    p_G: Array
    """(L, 3) landmarks as numbered in the tracks [m]"""
    outlier: Bools
    """(M,)"""
    X_NR: Array
    """(F, 4, 4) true poses of the camera; those of the tracks are as reported by the inspector"""


def random_scene(seed: int, **changes: Any) -> SyntheticScene:
    """A random physical body (positive second moments) with a random spin of 3 to 12 RPM."""
    rng = np.random.default_rng([seed, 77])
    second = np.exp(rng.uniform(-0.5, 0.5, 3))
    R = Rotation.random(rng=rng).as_matrix()
    J = R @ np.diag(second.sum() - second) @ R.T
    spin = rng.normal(size=3)
    w = spin / np.linalg.norm(spin) * rng.uniform(3.0, 12.0) * RPM
    com = rng.normal(0.0, 4e-3, 3)
    scene = SyntheticScene(J_G=J, w_G=tuple(w.tolist()), com_G=tuple(com.tolist()))
    return replace(scene, **changes)


def generate(scene: SyntheticScene, seed: int) -> SyntheticSequence:
    """Simulate the motion and the stereo measurements of one sequence."""
    rng = np.random.default_rng(seed)
    J = J_SPHERES if scene.J_G is None else np.asarray(scene.J_G)
    com = np.asarray(scene.com_G)
    h, at = _frame_steps(scene, seed)
    time_s: Array = np.asarray(h * at if scene.jitter else scene.dt_s * np.arange(scene.frames))
    r, v, R_NG, w_G = _motion(scene, J, h, at, rng)
    X_NG = make_pose(R_NG, r - R_NG @ com)
    X_NR = _camera_path(scene, time_s, r, seed)
    X_RG = inverse_pose(X_NR) @ X_NG
    points, normals = _surface(scene, rng)
    frame, point, uvd = _observe(scene, X_RG, points, normals, rng)
    noise = np.array([scene.sigma_uv_px, scene.sigma_uv_px, scene.sigma_d_px])
    measured = uvd + rng.normal(size=uvd.shape) * noise
    outlier = rng.random(len(uvd)) < scene.outliers
    measured[outlier] += rng.uniform(-40.0, 40.0, (int(outlier.sum()), 3))
    measured[:, 2] = np.maximum(measured[:, 2], 5.0)
    relative = NO_LINKS
    if scene.links:
        # Absolute orientation of common landmarks, as RANSAC would give it (outliers excluded by truth).
        i, j, X, count = pair_poses(frame, point, RIG.triangulate(measured), X_RG, 0.03, scene.min_inliers)
        wrong = rng.random(len(X)) < scene.wrong_pairs
        X[wrong, :3, :3] = Rotation.random(int(wrong.sum()), rng=rng).as_matrix()
        count[wrong] = rng.integers(6, 12, int(wrong.sum()))
        relative = RelativePoses(i, j, X, count)
    identity = point
    if not scene.loop_closure:
        # Each passage of a landmark through view has a number of its own.
        seen = np.stack([_visible(X, points, normals)[0] for X in X_RG])
        entered = seen & ~np.vstack([np.zeros((1, seen.shape[1]), bool), seen[:-1]])
        identity = point + len(points) * np.cumsum(entered, axis=0)[frame, point]
    used, landmark = np.unique(identity, return_inverse=True)
    # The camera's poses as the inspector reports them.
    reported = np.random.default_rng([seed, 78]).normal(size=(2, len(X_NR), 3))
    R_reported = X_NR[:, :3, :3] @ exp_so3(scene.sigma_camera_theta_rad * reported[0])
    tracks = StereoTracks(
        RIG,
        np.round(time_s * 1e9).astype(np.int64),
        make_pose(R_reported, X_NR[:, :3, 3] + scene.sigma_camera_p_m * reported[1]),
        frame,
        landmark.astype(np.int64),
        measured,
        np.broadcast_to(noise, uvd.shape).copy(),
        scene.sigma_camera_p_m,
        scene.sigma_camera_theta_rad,
        wrench=_wrench(scene),
    )
    moments, R_GP = principal_axes(J)
    k1, k2 = np.log(moments[0] / moments[1]), np.log(moments[1] / moments[2])
    truth = Truth(
        tracks.timestamps_ns, r, R_NG @ R_GP, v, w_G @ R_GP, moments, float(k1), float(k2), com, R_GP, None
    )
    return SyntheticSequence(tracks, relative, truth, X_NG, points[used % len(points)], outlier, X_NR)


def _frame_steps(scene: SyntheticScene, seed: int) -> tuple[float, Ints]:
    """Step of the integration [s], and the steps (F,) at which frames are taken."""
    steps = max(4, int(np.ceil(np.linalg.norm(scene.w_G) * scene.dt_s / 0.03)))
    off = scene.jitter * steps * np.random.default_rng([seed, 80]).uniform(-1.0, 1.0, scene.frames - 1)
    later = steps * np.arange(1, scene.frames) + np.round(off).astype(np.int64)
    return scene.dt_s / steps, np.concatenate([[0], later])


def _motion(
    scene: SyntheticScene, J: Array, h: float, at: Ints, rng: np.random.Generator
) -> tuple[Array, Array, Array, Array]:
    """States of the centre of mass and of G at the steps ``at`` (F,) of h [s], under white disturbances."""
    n = int(at[-1])
    middle, R_GP = np.linalg.eigvalsh(J)[1], principal_axes(J)[1]
    R = np.asarray(Rotation.random(rng=rng).as_matrix())
    noise = rng.normal(size=(n, 2, 3))
    known = np.array([_push(scene.pushes, (k + 0.5) * h) for k in range(n)] if scene.pushes else [])
    force_N, torque_P = np.moveaxis(known.reshape(-1, 2, 3), 1, 0) if scene.pushes else np.zeros((2, 1, 3))
    accel = noise[:, 0] * np.sqrt(scene.accel_psd / h) + force_N / scene.mass_kg
    torque = noise[:, 1] * np.sqrt(scene.torque_psd / h) * middle + torque_P @ R_GP.T
    start = (np.array(scene.r_N), np.array(scene.v_N), R, np.array(scene.w_G))
    r, v, R_all, w = disturbed_motion(start, J, h, accel, torque)
    return r[at], v[at], R_all[at], w[at]


def _camera_path(scene: SyntheticScene, time_s: Array, r_N: Array, seed: int) -> Array:
    """Camera at rest at N, drifting with the target, or on a slow arc about it with a swaying attitude; with
    the limit cycles of the inspector's control, from random numbers of their own."""
    X = np.tile(np.eye(4), (len(time_s), 1, 1))
    if scene.station_keeping:
        X[:, :3, 3] = r_N - r_N[0]
    if scene.camera_moves:
        centre = np.array([0.0, 0.0, scene.r_N[2]])
        angle = 0.6 * (1.0 - np.cos(2.0 * np.pi * time_s / max(time_s[-1], 1.0) * 0.5))
        sway = 0.03 * np.sin(0.4 * time_s)[:, None] * np.array([1.0, 0.0, 0.5])
        turn = exp_so3(angle[:, None] * np.array([0.0, 1.0, 0.0]))
        X = make_pose(turn @ exp_so3(sway), centre - turn @ centre)
    bands = [scene.deadband_m] * 3 + [scene.deadband_rad] * 3
    if not np.any(bands):
        return X
    cycles = [limit_cycle(*band, time_s[-1], np.random.default_rng([seed, 79, axis]))
              for axis, band in enumerate(bands)]  # fmt: skip
    off = np.stack([cycle.value(time_s) for cycle in cycles], axis=1)
    return make_pose(X[:, :3, :3] @ exp_so3(off[:, 3:]), X[:, :3, 3] + off[:, :3])


def _surface(scene: SyntheticScene, rng: np.random.Generator) -> tuple[Array, Array]:
    """Random points on the surface with outward normals, (n, 3) each, in G."""
    direction = rng.normal(size=(scene.landmarks, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    if scene.shape == "sphere":
        return direction * scene.radius_m, direction
    face = np.argmax(np.abs(direction), axis=1)
    normals = np.zeros_like(direction)
    rows = np.arange(scene.landmarks)
    normals[rows, face] = np.sign(direction[rows, face])
    half = scene.radius_m * np.array([1.0, 0.7, 0.5])
    points = rng.uniform(-1.0, 1.0, direction.shape) * half
    points[rows, face] = normals[rows, face] * half[face]
    return points, normals


def _visible(X_RG: Array, points: Array, normals: Array) -> tuple[Bools, Array]:
    """Which points (n, 3) face the camera and lie in both images, and where (n, 3) all of them do."""
    p_R = transform_points(X_RG, points)
    toward = -p_R / np.linalg.norm(p_R, axis=1, keepdims=True)
    facing = np.sum((normals @ X_RG[:3, :3].T) * toward, axis=1) > np.cos(np.deg2rad(70.0))
    uvd = RIG.project(p_R)
    u, v, d = uvd.T
    inside = (u > d) & (u < RIG.width_px) & (v > 0) & (v < RIG.height_px)
    return facing & inside & (p_R[:, 2] > 0.05), uvd


def _observe(
    scene: SyntheticScene, X_RG: Array, points: Array, normals: Array, rng: np.random.Generator
) -> tuple[Ints, Ints, Array]:
    frames, marks, pixels = [], [], []
    for k, X in enumerate(X_RG):
        visible, uvd = _visible(X, points, normals)
        chosen = np.flatnonzero(visible & (rng.random(len(points)) < scene.detection))
        if k not in scene.dropped:
            frames.append(np.full(len(chosen), k))
            marks.append(chosen)
            pixels.append(uvd[chosen])
    return np.concatenate(frames), np.concatenate(marks), np.concatenate(pixels)


def principal_axes(J: Array) -> tuple[Array, Array]:
    """Moments (3,) descending, the middle one 1, and R_GP (3, 3), right-handed."""
    values, vectors = np.linalg.eigh(J)
    R_GP = vectors[:, ::-1] * np.array([1.0, 1.0, np.linalg.det(vectors[:, ::-1])])
    return values[::-1] / values[1], R_GP


def _push(pushes: tuple[tuple[float, float, Vector, Vector], ...], time_s: float) -> tuple[Array, Array]:
    """Force along N [N] and torque along P [N m] at a time."""
    total = np.zeros((2, 3))
    for start_s, duration_s, force_N, torque_P in pushes:
        if start_s <= time_s < start_s + duration_s:
            total += np.array([force_N, torque_P])
    return total[0], total[1]


def _wrench(scene: SyntheticScene) -> Wrench | None:
    """The known pushes as rows, each constant until the next; None without any."""
    if not scene.pushes:
        return None
    edges_s = {0.0, *(edge for start, length, _, _ in scene.pushes for edge in (start, start + length))}
    time_s = np.array(sorted(edges_s))
    rows = np.array([_push(scene.pushes, float(t) + 1e-9) for t in time_s])
    return Wrench(np.round(time_s * 1e9).astype(np.int64), rows[:, 0], rows[:, 1])


def disturbed_motion(
    start: tuple[Array, Array, Array, Array], J: Array, h: float, accel_N: Array, torque_G: Array
) -> tuple[Array, Array, Array, Array]:
    """r_N, v_N (n + 1, 3), R_NG (n + 1, 3, 3), w_G (n + 1, 3): the start, and after each of n steps of h [s].

    start: r_N, v_N, R_NG, w_G of the centre of mass. J (3, 3) inertia; accel_N (n, 3) [m/s^2],
    torque_G (n, 3) in units of J over s^2. Euler's equation by classical Runge-Kutta, the attitude by the
    Magnus expansion of fourth order: mean rate and the commutator of its slope.
    """
    r, v, R, w = start
    v_N = v + np.concatenate([np.zeros((1, 3)), np.cumsum(h * accel_N, axis=0)])
    r_N = r + np.concatenate([np.zeros((1, 3)), np.cumsum(h * v_N[:-1] + 0.5 * h * h * accel_N, axis=0)])
    w_G, turn = _rates(
        np.asarray(w, dtype=np.float64), J, np.asarray(np.linalg.inv(J), dtype=np.float64), torque_G, h
    )
    return r_N, v_N, _turned(np.ascontiguousarray(R), exp_so3(turn)), w_G


@compiled
def _acceleration(J: Array, J_inv: Array, w: Array, torque: Array) -> Array:
    h, moment, out = np.zeros(3), np.empty(3), np.zeros(3)
    for a in range(3):
        for b in range(3):
            h[a] += J[a, b] * w[b]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        moment[a] = torque[a] - w[b] * h[c] + w[c] * h[b]
    for a in range(3):
        for b in range(3):
            out[a] += J_inv[a, b] * moment[b]
    return out


@compiled
def _rates(w: Array, J: Array, J_inv: Array, torque: Array, h: float) -> tuple[Array, Array]:
    """Rates (n + 1, 3), and the rotation vectors (n, 3) of the steps."""
    n = len(torque)
    rates, turn = np.empty((n + 1, 3)), np.empty((n, 3))
    rates[0] = w
    for k in range(n):
        w = rates[k]
        a1 = _acceleration(J, J_inv, w, torque[k])
        a2 = _acceleration(J, J_inv, w + 0.5 * h * a1, torque[k])
        a3 = _acceleration(J, J_inv, w + 0.5 * h * a2, torque[k])
        a4 = _acceleration(J, J_inv, w + h * a3, torque[k])
        after = w + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        turn[k] = h * (w + h * (a1 + a2 + a3) / 6.0) + h * h / 12.0 * np.cross(w, after)
        rates[k + 1] = after
    return rates, turn


@compiled
def _turned(R: Array, steps: Array) -> Array:
    """R (3, 3) and its products with the steps (n, 3, 3), one after the other: (n + 1, 3, 3)."""
    out = np.zeros((len(steps) + 1, 3, 3))
    out[0] = R
    for k in range(len(steps)):
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    out[k + 1, a, b] += out[k, a, c] * steps[k, c, b]
    return out


def pair_poses(
    frame: Ints, point: Ints, p_R: Array, X_RG: Array, gate_m: float, least: int
) -> tuple[Ints, Ints, Array, Ints]:
    """i, j (E,), X_RiRj (E, 4, 4), landmarks used (E,): of all pairs with at least ``least`` landmarks.

    Observations (M,) of points p_R (M, 3) [m], at most one of each point per frame; X_RG (F, 4, 4) true
    poses. Observations farther than the gate from their true position are left out. X by least squares
    (Kabsch 1976).
    """
    index = np.full((len(X_RG), int(point.max(initial=0)) + 1), -1, dtype=np.int64)
    index[frame, point] = np.arange(len(frame))
    i, j = np.triu_indices(len(X_RG), 1)
    centres, spread, count = _sums(index, i, j, np.ascontiguousarray(p_R), X_RG, gate_m)
    use = count >= least
    i, j, centres, count = i[use], j[use], centres[use], count[use]
    R = nearest_rotation(spread[use])
    return i, j, make_pose(R, centres[:, 0] - np.einsum("eab,eb->ea", R, centres[:, 1])), count


@compiled
def _sums(index: Ints, i: Ints, j: Ints, p_R: Array, X_RG: Array, gate_m: float) -> tuple[Array, Array, Ints]:
    """Centres (E, 2, 3) in both frames, products about them (E, 3, 3), numbers (E,) of good landmarks."""
    n = len(i)
    centres, spread, count = np.zeros((n, 2, 3)), np.zeros((n, 3, 3)), np.zeros(n, dtype=np.int64)
    chosen, q = np.empty((index.shape[1], 2), dtype=np.int64), np.empty(3)
    for e in range(n):
        A, B, found = X_RG[i[e]], X_RG[j[e]], 0
        for mark in range(index.shape[1]):
            a, b = index[i[e], mark], index[j[e], mark]
            if a < 0 or b < 0:
                continue
            # p_i against A B^-1 p_j
            for c in range(3):
                q[c] = 0.0
                for r in range(3):
                    q[c] += B[r, c] * (p_R[b, r] - B[r, 3])
            square = 0.0
            for r in range(3):
                square += (p_R[a, r] - A[r, 0] * q[0] - A[r, 1] * q[1] - A[r, 2] * q[2] - A[r, 3]) ** 2
            if square < gate_m**2:
                chosen[found, 0], chosen[found, 1] = a, b
                found += 1
        count[e] = found
        for m in range(found):
            for r in range(3):
                centres[e, 0, r] += p_R[chosen[m, 0], r] / found
                centres[e, 1, r] += p_R[chosen[m, 1], r] / found
        for m in range(found):
            for r in range(3):
                for c in range(3):
                    spread[e, r, c] += (p_R[chosen[m, 0], r] - centres[e, 0, r]) * (
                        p_R[chosen[m, 1], c] - centres[e, 1, c]
                    )
    return centres, spread, count
