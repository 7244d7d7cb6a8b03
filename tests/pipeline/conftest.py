"""A run without images: torque-free motion of a solid box, its landmarks seen by one stereo camera.

And images of a target at rest, for runs that go wrong on purpose.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from polhode.cli.main import main
from polhode.config import Config
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_body import propagate
from polhode.pipeline.run import run
from polhode.records.estimate import (
    Identifiability,
    Landmarks,
    MassProperties,
    MotionEstimate,
    NoiseLevels,
    SolverOutcome,
)
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.runtime.progress import Silent
from polhode.simulation import simulate
from tests.conftest import MakeOnce
from tests.front_end_results import SharedFrontEnd
from tests.pipeline.stored_run import write_run
from tests.planning.bodies import BASIS

BOX_M = np.array([0.12, 0.20, 0.24])
RIG = RectifiedRig(467.0, 319.5, 239.5, 0.09, 640, 480)
N_FRAMES = 24
REST_FRAMES = 6
AT_REST = {
    "frames": REST_FRAMES,
    "interval_s": 0.5,
    "body": {"family": "free_flyer", "size_m": 0.22},
    "motion": {"position_m": [0.02, 0.0, 0.5], "spin_rpm": [0.0, 0.0, 0.0]},
    "rig": {"width_px": 240, "height_px": 180, "focal_px": 230.0, "baseline_m": 0.09},
    "render": {"products": []},
}
ONE_METHOD: dict[str, Any] = {
    "runtime": {"workers": 1},
    "frontend": {"features": {"second": None}, "depth": {"method": "sgbm"}},
    "mapping": {"voxel_mm": 6.0},
    "outputs": ["motion", "surface"],
}
"""One method of the front end, without networks and pictures, and a surface of few voxels"""
QUICK = (
    *("--outputs", "motion", "surface", "--runtime.workers", "1"),
    *("--frontend.depth.method", "sgbm", "--mapping.voxel-mm", "6"),
)
"""Where nothing is asked of pictures and surface"""
FAST = (*QUICK, "--frontend.features.second", "None")


@dataclass(frozen=True)
class Example:
    """Everything that a finished run hands to its writers."""

    tracks: StereoTracks
    relative: RelativePoses
    estimate: MotionEstimate
    surface: SurfaceModel


@pytest.fixture(scope="session")
def example() -> Example:
    return make_example()


def make_example() -> Example:
    """A box of uniform density, 10 RPM about its unstable axis, 0.6 m away; noise of 0.3 px."""
    random = np.random.default_rng(5)
    moments = (BOX_M**2).sum() - BOX_M**2
    moments = moments / moments[1]
    yes, com_G = np.ones(3, dtype=bool), np.array([0.003, -0.001, 0.002])
    mass = MassProperties(
        J_G=np.diag(moments),
        moments=moments,
        k1=float(np.log(moments[0] / moments[1])),
        k2=float(np.log(moments[1] / moments[2])),
        cov_k=np.array([[4e-6, -2e-6], [-2e-6, 3.6e-5]]),
        cov_J=np.eye(5) * 1e-5,
        R_GP=np.eye(3),
        cov_R_GP=np.eye(3) * 1e-5,
        com_G=com_G,
        cov_com_G=np.eye(3) * 1e-7,
        identifiable=Identifiability(True, True, True, True, {"k1": "well determined"}, yes, yes, np.ones(8)),
        J_by_xi=BASIS,
    )
    timestamps_ns = 1_000_000_000 + 500_000_000 * np.arange(N_FRAMES, dtype=np.int64)
    time_s = (timestamps_ns - timestamps_ns[0]) * 1e-9
    r_N, v_N, R_NP, w_P = propagate(
        time_s, [0.0, 0.0, 0.6], [0.003, 0.0, 0.0], np.eye(3), [0.05, 1.047, 0.05], np.diag(moments)
    )
    X_NG = make_pose(R_NP, r_N - R_NP @ com_G)
    box = trimesh.creation.box(BOX_M).subdivide().subdivide()
    points, _ = trimesh.sample.sample_surface(box, 150, seed=3)
    tracks, residuals = _tracks(points, X_NG, timestamps_ns, random)
    covariance = np.tile(np.diag([3e-4] * 3 + [6e-4] * 3 + [2e-3] * 3 + [2e-3] * 3) ** 2, (N_FRAMES, 1, 1))
    estimate = MotionEstimate(
        timestamps_ns=timestamps_ns,
        r_N=r_N,
        v_N=v_N,
        R_NP=R_NP,
        w_P=w_P,
        X_NG=X_NG,
        covariance=covariance,
        covariance_last_joint=np.eye(20) * 1e-6,
        covariance_last_body=np.eye(20) * 1e-6,
        covariance_of_marks=covariance / 4.0,
        mass=mass,
        landmarks=Landmarks(points, np.full(150, 4e-4), np.bincount(tracks.landmark, minlength=150)),
        residuals_px=residuals,
        inlier_weight=1.0 / (1.0 + np.sum((residuals / tracks.sigma_px) ** 2, axis=1) / 9.0),
        noise=NoiseLevels(0.3, 0.15, 1e-6, 1e-6, 0.5, 0.5),
        solver=SolverOutcome("ipopt", 7, 1234.5, True, 1.02, "Solve_Succeeded", {"sphere": 1234.5}),
    )
    count = len(box.vertices)
    box.visual.vertex_colors = random.integers(40, 220, (count, 4), dtype=np.uint8)
    surface = SurfaceModel(box, np.full(count, 8e-4), np.full(count, 9, dtype=np.int64))
    i = np.arange(N_FRAMES - 1, dtype=np.int64)
    relative = RelativePoses(i, i + 1, np.tile(np.eye(4), (len(i), 1, 1)), np.full(len(i), 20))
    return Example(tracks, relative, estimate, surface)


def _tracks(
    p_G: np.ndarray, X_NG: np.ndarray, timestamps_ns: np.ndarray, random: np.random.Generator
) -> tuple[StereoTracks, np.ndarray]:
    """Of the landmarks on the sides that face the camera; and their residuals."""
    sigma = np.array([0.3, 0.3, 0.15])
    outward = np.sign(p_G) * (np.abs(np.abs(p_G) - BOX_M / 2) < 1e-6)
    rows = []
    for k, X_NGk in enumerate(X_NG):
        p_N = transform_points(X_NGk, p_G)
        facing = np.sum((outward @ inverse_pose(X_NGk)[:3, :3]) * p_N, axis=1) < 0.0
        # One frame without measurements, as after a lost pair.
        seen = np.flatnonzero(facing) if k != 11 else np.array([], dtype=np.int64)
        noise = random.normal(size=(len(seen), 3)) * sigma
        rows.append((np.full(len(seen), k), seen, RIG.project(p_N[seen]) + noise, noise))
    frame, landmark, uvd_px, residuals = (np.concatenate(each) for each in zip(*rows, strict=True))
    tracks = StereoTracks(
        rig=RIG,
        timestamps_ns=timestamps_ns,
        X_NR=np.tile(np.eye(4), (len(X_NG), 1, 1)),
        frame=frame,
        landmark=landmark,
        uvd_px=uvd_px,
        sigma_px=np.tile(sigma, (len(frame), 1)),
        sigma_camera_p_m=0.001,
    )
    return tracks, residuals


@pytest.fixture(scope="session")
def undetermined(example: Example) -> Example:
    """The same run, had the body spun about one principal axis only."""
    inf3, flags = np.diag([1e-8, np.inf, 1e-8]), np.array([True, False, True])
    words = {"k1": "pure spin: no torque-free wobble to see"}
    lost: dict[str, Any] = {
        "cov_k": np.diag([np.inf] * 2),
        "cov_com_G": inf3,
        "cov_R_GP": inf3,
        "cov_J": np.full((5, 5), np.nan),
        "identifiable": Identifiability(False, False, False, False, words, flags, flags, np.full(8, np.inf)),
    }
    covariance = example.estimate.covariance.copy()
    covariance[:, 1, 1] = np.inf
    covariance[:, 7, :] = np.nan
    mass = replace(example.estimate.mass, **lost)
    return replace(example, estimate=replace(example.estimate, mass=mass, covariance=covariance))


@pytest.fixture(scope="session")
def at_rest(make_once: MakeOnce) -> Path:
    """A sequence of REST_FRAMES pairs of a target that does not move."""
    scene = Config.model_validate({"scene": AT_REST}).scene
    assert scene is not None
    return make_once("at_rest", lambda folder: simulate(scene, 3, folder, Silent(), 1, False))


@pytest.fixture(scope="session")
def run_at_rest(at_rest: Path, make_once: MakeOnce) -> Path:
    """The folder in which a run of this sequence with the options ``FAST`` is, R."""

    def fill(folder: Path) -> None:
        folder.mkdir()
        assert main(["run", "--data", str(at_rest), "-o", str(folder / "R"), *FAST]) == 0

    return make_once("run_at_rest", fill)


@pytest.fixture(scope="session")
def run_of_one_method(rendered_sequence: Path, make_once: MakeOnce, front_end_once: SharedFrontEnd) -> Path:
    """The run of the rendered sequence, all frames at once, as ``ONE_METHOD`` says."""
    config = Config.model_validate(ONE_METHOD)
    with front_end_once():
        return make_once("one_method", lambda folder: run(config, rendered_sequence, folder, Silent()))


def write_example(folder: Path, example: Example, pictures: Mapping[str, bytes] | None = None) -> None:
    """The run on disk; ``pictures``: PNG or JPEG by caption."""
    write_run(
        folder,
        config=Config(),
        tracks=example.tracks,
        estimate=example.estimate,
        surface=example.surface,
        timing_s={},
        relative=example.relative,
        pictures=pictures,
    )
