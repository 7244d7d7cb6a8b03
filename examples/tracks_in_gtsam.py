"""A run's measurements in GTSAM: bundle adjustment of its tracks, beside the poses that the run found.

    python -m examples.tracks_in_gtsam RUN

Unknown are the poses of the rectified left camera in the target's frame G, and the landmarks in G. There is
no dynamics here, so that centre of mass and inertia do not appear:
``polhode/compare/solvers/gtsam_lm.py`` has the whole problem in GTSAM. The landmarks start where one
stereo pair puts them, the poses at the run's.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

import polhode
from polhode.geometry.lie import Array, inverse_pose, log_so3, transform_points
from polhode.records.tracks import StereoTracks
from polhode.runtime.errors import InputError

KERNEL = 3.0
"""Scale of Cauchy's kernel, in standard deviations"""
GAUGE_SIGMA = 1e-6
"""Of the first pose [rad, m], which is held: G may move together with all of it"""


def main(arguments: list[str] | None = None) -> int:
    """Adjust and compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a run")
    try:
        run = polhode.load(parser.parse_args(arguments).run)
        tracks, X_GR = run.measurements, camera_poses(run.measurements, run.X_NG)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return InputError.exit_code
    graph, values = graph_of(tracks, X_GR[0]), start(tracks, X_GR)
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    shift_m, turn_deg = differences(found, X_GR)
    print(f"{graph.size()} factors, {tracks.n_frames} poses, {tracks.n_landmarks} landmarks")
    print(f"cost {graph.error(values):.6g} -> {graph.error(found):.6g}")
    print(f"poses against the run's: median {1e3 * np.median(shift_m):.2f} mm, {np.median(turn_deg):.3f} deg")
    return 0


def camera_poses(tracks: StereoTracks, X_NG: Array) -> Array:
    """X_GR (F, 4, 4): the rectified left camera in G at every frame."""
    return np.asarray(inverse_pose(X_NG) @ tracks.X_NR)


def graph_of(tracks: StereoTracks, X_GR: Array) -> Any:
    """A stereo factor for every observation, and the first pose."""
    rig = tracks.rig
    camera = gtsam.Cal3_S2Stereo(rig.focal_px, rig.focal_px, 0.0, rig.cx_px, rig.cy_px, rig.baseline_m)
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(KERNEL)
    # GTSAM measures (u left, u right, v), polhode (u left, v, disparity)
    T = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    graph = gtsam.NonlinearFactorGraph()
    for frame, landmark, uvd, sigma in zip(
        tracks.frame, tracks.landmark, tracks.uvd_px, tracks.sigma_px, strict=True
    ):
        u, v, disparity = uvd
        noise = gtsam.noiseModel.Gaussian.Covariance(T @ np.diag(sigma**2) @ T.T)
        measured = gtsam.StereoPoint2(u, u - (disparity - rig.disparity_offset_px), v)
        robust = gtsam.noiseModel.Robust.Create(kernel, noise)
        keys = X(int(frame)), L(int(landmark))
        graph.add(gtsam.GenericStereoFactor3D(measured, robust, *keys, camera, False, False))
    held = gtsam.noiseModel.Isotropic.Sigma(6, GAUGE_SIGMA)
    graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(X_GR), held))
    return graph


def start(tracks: StereoTracks, X_GR: Array) -> Any:
    """The run's poses, and each landmark where its first stereo pair puts it."""
    values = gtsam.Values()
    for k, pose in enumerate(X_GR):
        values.insert(X(k), gtsam.Pose3(pose))
    landmarks, first = np.unique(tracks.landmark, return_index=True)
    p_R = tracks.rig.triangulate(tracks.uvd_px[first])
    p_G = transform_points(X_GR[tracks.frame[first]], p_R[:, None, :])[:, 0]
    for landmark, point in zip(landmarks, p_G, strict=True):
        values.insert(L(int(landmark)), point)
    return values


def differences(values: Any, X_GR: Array) -> tuple[Array, Array]:
    """Distances [m] and angles [deg] (F,) of the camera's poses from given ones (F, 4, 4)."""
    found = np.array([values.atPose3(X(k)).matrix() for k in range(len(X_GR))])
    between = inverse_pose(X_GR) @ found
    turn = np.linalg.norm(log_so3(between[:, :3, :3]), axis=1)
    return np.linalg.norm(between[:, :3, 3], axis=1), np.rad2deg(turn)


if __name__ == "__main__":
    sys.exit(main())
