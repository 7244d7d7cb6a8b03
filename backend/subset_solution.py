"""A part of the measurements solved by itself, from the motion that all of them gave.

Checks compare parts with one another and with the whole: where errors are what the sigmas say, they agree
within these. Few Gauss-Newton iterations suffice, as the start is the whole's solution and its outliers are
left out.
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.outliers_and_noise.noise_and_outliers import (
    PrunedFit,
    PrunedProblem,
    whitened_residuals,
)
from polhode.backend.problem.inertia import second_moments_from_inertia
from polhode.backend.problem.iterate import N_CAMERA, Iterate
from polhode.backend.problem.motion_data import MotionData, motion_data, steps_with_nodes
from polhode.backend.result import assemble
from polhode.backend.solvers.gauss_newton import GaussNewton
from polhode.backend.solvers.linearization_point import MotionFit
from polhode.backend.solvers.robust_kernel import most_efficient_scale
from polhode.backend.solvers.solve import refine
from polhode.config.backend_settings import Backend
from polhode.geometry.lie import Array, Bools, Ints, inverse_pose
from polhode.records.estimate import InitialMotion, MotionEstimate
from polhode.records.tracks import StereoTracks

MIN_OBSERVATIONS = 60


def estimate_part(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, rows: Bools, frames: Ints
) -> MotionEstimate | None:
    """The estimate of some observations (M,) of ``tracks``, its states in some frames (n,), ascending.

    Frames without chosen observations are bridged by the dynamics, with the covariance that this gives.
    Noise, unknown disturbances and outliers are the whole's. Errors that all landmarks share, and those of
    the calibration, are not in the covariance, as parts that are compared have the same ones. None: too few
    observations, or no solution.
    """
    posed = _posed(tracks, whole, config, rows, frames)
    if posed is None:
        return None
    part, scales, start = posed
    data = start.data
    known = InitialMotion(inverse_pose(part.X_NR) @ whole.X_NG[frames], np.ones(len(frames), dtype=np.bool_))
    every = np.ones(len(data.frame), dtype=np.bool_), np.ones(data.n_landmarks, dtype=np.bool_)
    own = "drift" if config.correlated_errors == "slide" else config.correlated_errors
    unshared = config.model_copy(update={"correlated_errors": own, "light_px": 0.0})
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            solved = refine(GaussNewton(data, line_search=True), start.iterate, 20)[0]
            whole_part = PrunedFit(data, PrunedProblem(data, *every), solved, scales)
            return assemble(part, whole_part, known, unshared)
    except LinAlgError:
        return None


def solved_again(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, frames: Ints
) -> MotionFit | None:
    """The problem of all observations in some frames (n,), ascending, and its solution.

    Noise, unknown disturbances and outliers are the whole's. None: too few observations, or no convergence.
    """
    posed = _posed(tracks, whole, config, np.ones(len(tracks.frame), dtype=np.bool_), frames)
    if posed is None:
        return None
    start = posed[2]
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            found, solution, _ = refine(GaussNewton(start.data, line_search=True), start.iterate, 20)
    except LinAlgError:
        return None
    return MotionFit(start.data, found) if solution.converged else None


def _posed(
    tracks: StereoTracks, whole: MotionEstimate, config: Backend, rows: Bools, frames: Ints
) -> tuple[StereoTracks, Array, MotionFit] | None:
    """The part's tracks, its noise, and its problem where the solution starts. None: too few observations."""
    rows = rows & (whole.inlier_weight > 0.0) & np.isin(tracks.frame, frames)
    if rows.sum() < MIN_OBSERVATIONS or len(np.unique(tracks.frame[rows])) < 3:
        return None
    frame = tracks.frame[rows]
    first, landmark = np.unique(tracks.landmark[rows], return_index=True, return_inverse=True)[1:]
    X_GR = (inverse_pose(whole.X_NG) @ tracks.X_NR)[frame[first]]
    # the estimate's landmark is where its prediction of any observation lies
    p_R = tracks.rig.triangulate(tracks.uvd_px[rows][first] - whole.residuals_px[rows][first])
    p_G = np.einsum("nij,nj->ni", X_GR[:, :3, :3], p_R) + X_GR[:, :3, 3]
    part = replace(
        tracks,
        timestamps_ns=tracks.timestamps_ns[frames],
        X_NR=tracks.X_NR[frames],
        frame=np.searchsorted(frames, frame),
        landmark=landmark.astype(np.int64),
        uvd_px=tracks.uvd_px[rows],
        sigma_px=tracks.sigma_px[rows],
        calibration=None,
    )
    data, scales = data_of_part(part, whole, config)
    xi, R_inertia = data.form.coordinates(second_moments_from_inertia(whole.mass.J_G, 0.0))
    X_NG, w_G = whole.X_NG[frames], whole.w_P[frames] @ whole.mass.R_GP.T
    camera = np.zeros((len(frames), N_CAMERA)) if data.camera_is_noisy else None
    states = X_NG[:, :3, 3].copy(), X_NG[:, :3, :3].copy(), whole.v_N[frames].copy(), w_G
    start = MotionFit(data, Iterate(*states, whole.mass.com_G.copy(), xi, R_inertia, p_G, camera))
    scale = most_efficient_scale(np.sum(whitened_residuals(start) ** 2, axis=1), data.robust_scale)
    return part, scales, start.with_data(robust_scale=scale)


def data_of_part(part: StereoTracks, whole: MotionEstimate, config: Backend) -> tuple[MotionData, Array]:
    """The problem of the part, with the whole's noise and disturbances."""
    noise, stated = whole.noise, np.median(part.sigma_px, axis=0)
    uv = 2.0 * noise.pixel_sigma_px / float(stated[0] + stated[1])
    scales = np.array([uv, uv, noise.disparity_sigma_px / float(stated[2])])
    data = motion_data(part, config).rescaled(scales)
    nodes = data.nodes
    if whole.disturbances is not None:
        acting = zip(whole.disturbances.start_ns, whole.disturbances.end_ns, strict=True)
        first_ns = part.timestamps_ns[0]
        windows = tuple((1e-9 * float(a - first_ns), 1e-9 * float(b - first_ns)) for a, b in acting)
        nodes = nodes | steps_with_nodes(windows, False, data.dt_s)
    return replace(data, nodes=nodes, accel_psd=noise.accel_psd, torque_psd=noise.torque_psd), scales
