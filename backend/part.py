"""A part of the measurements solved by itself, from the motion that all of them gave.

Checks compare parts with one another and with the whole: where errors are what the sigmas say, they agree
within these. Few Gauss-Newton iterations suffice, as the start is the whole's solution and its outliers are
left out.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.outliers_and_noise.outliers import NoiseScales, PrunedProblem, whitened_residuals
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data, nodes_of
from polhode.backend.result import assemble
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.robust_kernel import most_efficient_scale
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.lie import Array, inverse_pose
from polhode.records import Bools, InitialMotion, Ints, MotionEstimate, StereoTracks

ITERATIONS = 20
MIN_OBSERVATIONS = 60


def estimate_part(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, rows: Bools, frames: Ints
) -> MotionEstimate | None:
    """The estimate of some observations (M,) of ``tracks``, its states in some frames (n,), ascending.

    Frames without chosen observations are bridged by the dynamics, with the covariance that this gives.
    Noise, unknown disturbances and outliers are the whole's. Errors that all landmarks share are not in the
    covariance, as parts that are compared have the same ones. None: too few observations, or no solution.
    """
    problem = _problem(tracks, whole, config, rows, frames)
    if problem is None:
        return None
    X_RG = inverse_pose(problem.tracks.X_NR) @ whole.X_NG[frames]
    data = problem.data
    everything = PrunedProblem(
        data, np.ones(len(data.frame), dtype=np.bool_), np.ones(data.n_landmarks, dtype=np.bool_)
    )
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            known = InitialMotion(X_RG, np.ones(len(frames), dtype=np.bool_))
            found, _ = problem.solved()
            own = "drift" if config.correlated_errors == "slide" else config.correlated_errors
            return assemble(problem.tracks, data, everything, found, problem.scales, known, own, 0.0)
    except LinAlgError:
        return None


def solved_again(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, frames: Ints
) -> tuple[MotionData, Iterate] | None:
    """The problem of all observations in some frames (n,), ascending, and its solution.

    Noise, unknown disturbances and outliers are the whole's. None: too few observations, or no convergence.
    """
    problem = _problem(tracks, whole, config, np.ones(len(tracks.frame), dtype=np.bool_), frames)
    if problem is None:
        return None
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            found, converged = problem.solved()
    except LinAlgError:
        return None
    return (problem.data, found) if converged else None


@dataclass(frozen=True)
class _Problem:
    """A part's problem and where its solution starts."""

    tracks: StereoTracks
    data: MotionData
    scales: NoiseScales
    start: Iterate

    def solved(self) -> tuple[Iterate, bool]:
        """The solution, and whether it converged. Raises LinAlgError if there is none."""
        solver = GaussNewton(self.data, line_search=True)
        found, solution, _ = refine(solver, self.data, self.start, ITERATIONS)
        return found, solution.converged


def _problem(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, rows: Bools, frames: Ints
) -> _Problem | None:
    """None: too few observations."""
    rows = rows & (whole.inlier_weight > 0.0) & np.isin(tracks.frame, frames)
    if rows.sum() < MIN_OBSERVATIONS or len(np.unique(tracks.frame[rows])) < 3:
        return None
    part, p_G = _part_of(tracks, whole, rows, frames)
    data, scales = data_of_part(part, whole, config)
    start = iterate_of(data, whole, frames, p_G)
    scale = most_efficient_scale(np.sum(whitened_residuals(data, start) ** 2, axis=1), data.robust_scale)
    return _Problem(part, replace(data, robust_scale=scale), scales, start)


def _part_of(
    tracks: StereoTracks, whole: MotionEstimate, rows: Bools, frames: Ints
) -> tuple[StereoTracks, Array]:
    """The measurements ``rows`` (M,), frames and landmarks numbered anew, and the landmarks (L, 3) in G."""
    frame = tracks.frame[rows]
    first, landmark = np.unique(tracks.landmark[rows], return_index=True, return_inverse=True)[1:]
    # the estimate's landmark is where its prediction of any observation lies
    k = frame[first]
    p_R = tracks.rig.triangulate(tracks.uvd_px[rows][first] - whole.residuals_px[rows][first])
    X_GR = (inverse_pose(whole.X_NG) @ tracks.X_NR)[k]
    p_G = np.einsum("nij,nj->ni", X_GR[:, :3, :3], p_R) + X_GR[:, :3, 3]
    part = replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[frames],
        X_NR=tracks.X_NR[frames],
        frame=np.searchsorted(frames, frame),
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows],
    )
    return part, p_G


def data_of_part(
    part: StereoTracks, whole: MotionEstimate, config: Backend
) -> tuple[MotionData, NoiseScales]:
    """The problem of the part, with the whole's noise and disturbances."""
    noise, stated = whole.noise, np.median(part.sigma_px, axis=0)
    scales = NoiseScales(
        2.0 * noise.pixel_sigma_px / float(stated[0] + stated[1]),
        noise.disparity_sigma_px / float(stated[2]),
    )
    data = motion_data(part, config).rescaled(scales.factors)
    nodes = data.nodes
    if whole.disturbances is not None:
        acting = zip(whole.disturbances.start_ns, whole.disturbances.end_ns, strict=True)
        first_ns = part.timestamps_ns[0]
        windows = tuple((1e-9 * float(a - first_ns), 1e-9 * float(b - first_ns)) for a, b in acting)
        nodes = nodes | nodes_of(windows, False, data.dt_s)
    return replace(data, nodes=nodes, accel_psd=noise.accel_psd, torque_psd=noise.torque_psd), scales


def iterate_of(data: MotionData, whole: MotionEstimate, frames: Ints, p_G: Array) -> Iterate:
    """The whole's estimate as a value of the part's unknowns; a known wrench's steps are left free."""
    xi, R_inertia = data.form.coordinates(second_moments_from_inertia(whole.mass.J_G, 0.0))
    n = len(frames)
    return Iterate(
        p_NG=whole.X_NG[frames, :3, 3].copy(),
        R_NG=whole.X_NG[frames, :3, :3].copy(),
        v_N=whole.v_N[frames].copy(),
        w_G=whole.w_P[frames] @ whole.mass.R_GP.T,
        com_G=whole.mass.com_G.copy(),
        xi=xi,
        R_inertia=R_inertia,
        p_G=p_G,
        camera=np.zeros((n, 6)) if data.camera_is_noisy else None,
    )
