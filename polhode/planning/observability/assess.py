"""The assessment: edges, camera and trajectory of a run or a mesh, metric of every view, sets of edges."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polhode.files.tables import number_rows
from polhode.frontend.rectification import make_rectifier
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Ints, inverse_pose, make_pose, matrix_from_wxyz
from polhode.mapping.mesh_files import read_mesh
from polhode.planning.edges.edge_model import CREASE_DEG, EdgeModel, edge_model
from polhode.planning.edges.expected_tracking import ExpectedTracking, expected_tracking, lit_from
from polhode.planning.edges.information import (
    Contributions,
    EdgeView,
    FeatureInformation,
    by_feature,
    contributions,
    greedy,
    sigma_ratio,
    views_along,
)
from polhode.planning.edges.measured_edges import (
    PosedImage,
    RefinedEdges,
    measured_edge_model,
    refined_edges,
)
from polhode.planning.edges.profiles import as_levels
from polhode.planning.plan import final_estimate, surface_of
from polhode.planning.prediction import nominal_motion
from polhode.records.dataset import open_sequence
from polhode.run_directory.archives import read_measurements
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import read_trajectory, target_poses
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress


@dataclass(frozen=True)
class CameraOptions:
    """A pinhole camera without distortion; None: the run's, or for a mesh the default."""

    focal_px: float | None = None
    width_px: int | None = None
    height_px: int | None = None


@dataclass(frozen=True)
class Subject:
    """Edges, camera and trajectory, ready for the metric."""

    source: str
    model: EdgeModel
    rig: RectifiedRig
    time_s: Array
    """(k,) as in the trajectory's file; of a run's own trajectory, after its first pair"""
    X_RG: Array
    """(k, 4, 4)"""
    about: str
    o_G: Array
    """(3,) [m]"""
    sun_G: Array | None
    """(k, 3) towards the Sun; None: unknown"""
    notes: tuple[str, ...]


DEFAULT_RIG = RectifiedRig(800.0, 319.5, 239.5, 1.0, 640, 480)


def subject_of(
    path: Path,
    trajectory: Path | None,
    frame: str,
    camera: CameraOptions,
    about_G: Array | None,
    sun: Array | None,
    crease_deg: float,
    unit_m: float,
) -> Subject:
    """Raises InputError, one line, for unreadable or inconsistent input."""
    notes: list[str] = []
    if path.is_dir():
        if unit_m != 1.0:
            raise InputError("--unit is for a mesh; a run is in metres")
        if crease_deg != CREASE_DEG:
            raise InputError("--crease-deg is for a mesh; that of a run follows from its errors")
        summary, surface = read_summary(path), surface_of(path)
        model = measured_edge_model(surface.mesh, surface.sigma_m)
        notes.append(
            "what is expected of a tracker takes the edges of the mesh as exact; those of a measured mesh "
            "are not, and the errors of a tracker that uses them are larger, possibly by far"
        )
        if surface.coverage is not None:
            seen = float((surface.views > 0).mean())
            notes.append(
                f"{seen:.0%} of the mesh's vertices were measured: edges never seen are not in the model"
            )
        tracks = read_measurements(path / "measurements.npz")
        rig, R_NG = tracks.rig, None
        if trajectory is None:
            if frame != "G":
                raise InputError("--frame inertial: give --trajectory FILE with the camera's poses in N")
            time_s, X_RG, R_NG = _poses_of_run(path, summary, tracks.X_NR)
        else:
            time_s, X_FR = read_poses(trajectory)
            X_RG = inverse_pose(X_FR)
            if frame == "N":
                if time_s[0] < 0.0:
                    raise InputError(
                        f"{trajectory}: with --frame inertial times are seconds after the run's last pair; "
                        "one is negative"
                    )
                motion = nominal_motion(final_estimate(path)[0], time_s)
                X_RG, R_NG = X_RG @ motion.X_NG, motion.R_NG
        if sun is not None and R_NG is None:
            raise InputError(
                "--sun is in N, and poses in G do not give the attitude of the target in N: --frame inertial "
                "does"
            )
        sun_G = None if sun is None or R_NG is None else sun @ R_NG
        centre = summary.com_G if summary.com_G is not None and np.isfinite(summary.com_G).all() else None
    else:
        if not path.is_file():
            raise InputError(f"{path}: no such run or mesh")
        if trajectory is None:
            raise InputError(f"{path}: a mesh needs --trajectory FILE, the poses of the camera in its frame")
        if frame != "G":
            raise InputError(
                "--frame inertial is for a run, whose target tumbles; a mesh has only its own frame"
            )
        model, rig, centre = edge_model(read_mesh(path, unit_m), crease_deg), DEFAULT_RIG, None
        time_s, X_FR = read_poses(trajectory)
        X_RG = inverse_pose(X_FR)
        sun_G = None if sun is None else np.tile(sun, (len(X_RG), 1))
    if about_G is not None:
        o_G, about = about_G, "--about"
    elif centre is not None:
        o_G, about = np.array(centre), "the run's centre of mass"
    else:
        o_G, about = model.centre_G, "the centre of the bounding box"
    # the values that the user gives; the middle of an image of another size is its principal point
    for name, value in vars(camera).items():
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a number above 0")
    given = {name: value for name, value in vars(camera).items() if value is not None}
    given |= {
        middle: 0.5 * (given[size] - 1)
        for middle, size in (("cx_px", "width_px"), ("cy_px", "height_px"))
        if size in given
    }
    rig = replace(rig, disparity_offset_px=0.0, **given)
    notes = [*model.notes, *notes]
    return Subject(str(path), model, rig, time_s, X_RG, about, o_G, sun_G, tuple(notes))


def refined_edges_of_run(run: Path, sequence: Path) -> RefinedEdges:
    """The edges of the run's mesh in G, where the left images of its sequence have them.

    Edges that the images do not confirm are left out. Raises InputError for a run without motion, or for
    another sequence.
    """
    surface, tracks = surface_of(run), read_measurements(run / "measurements.npz")
    _, X_RG, _ = _poses_of_run(run, read_summary(run), tracks.X_NR)
    images = open_sequence(sequence)
    frames = np.searchsorted(images.timestamps_ns, tracks.timestamps_ns)
    if not np.isin(tracks.timestamps_ns, images.timestamps_ns).all():
        raise InputError(f"{sequence}: lacks images of {run}; give the sequence that the run was made from")
    rectifier = make_rectifier(images.calibration)
    posed = [
        PosedImage(as_levels(rectifier(images.read_left(int(frame))[0], 0)), pose)
        for frame, pose in zip(frames, X_RG, strict=True)
    ]
    model = measured_edge_model(surface.mesh, surface.sigma_m)
    return refined_edges(model, surface.mesh, surface.sigma_m, tracks.rig, posed)


def _poses_of_run(run: Path, summary: Summary, X_NR: Array) -> tuple[Array, Array, Array]:
    """Times (k,), poses X_RG (k, 4, 4) and attitudes R_NG (k, 3, 3) of the run's own pairs."""
    if summary.R_GP is None or summary.com_G is None:
        raise InputError(f"{run}: this run has no motion, hence no camera poses; give --trajectory FILE")
    table = read_trajectory(run)
    X_NG = target_poses(table, np.array(summary.R_GP), np.array(summary.com_G))
    return table.time_s, inverse_pose(X_NR) @ X_NG, X_NG[:, :3, :3]


def sun_direction(sun: Sequence[float] | None) -> Array | None:
    """Unit vector (3,) towards the Sun. Raises InputError for what is no direction."""
    if sun is None:
        return None
    direction = np.asarray(sun, dtype=np.float64)
    if direction.shape != (3,) or not np.isfinite(direction).all():
        raise InputError("--sun: give three finite numbers")
    # hypot does not overflow
    length = math.hypot(*direction)
    if not 1e-100 < length < 1e100:
        raise InputError("--sun: give a direction whose length is neither 0 nor above 1e100")
    return np.asarray(direction / length)


def check_numbers(sigma_px: float, edges: int | None) -> None:
    """Raises InputError for numbers out of their range."""
    if not 1e-6 <= sigma_px <= 1e6:
        raise InputError(f"--sigma-px {sigma_px:g}: give a number from 1e-06 to 1e6")
    if edges is not None and not 1 <= edges <= 1_000_000:
        raise InputError(f"--edges {str(edges)[:20]}: give a number from 1 to 1000000")


MAX_COORDINATE_M = 1e12


def read_poses(path: Path) -> tuple[Array, Array]:
    """Increasing times (k,) and poses (k, 4, 4) of a TUM file. Raises InputError for other content."""
    rows = [row for _, row in number_rows(path, 8, "timestamp tx ty tz qx qy qz qw", 100_000)]
    if not rows:
        raise InputError(f"{path}: contains no pose; a line is: timestamp tx ty tz qx qy qz qw")
    table = np.array(rows)
    if not (np.diff(table[:, 0]) > 0.0).all():
        late = 1 + int(np.argmax(np.diff(table[:, 0]) <= 0.0))
        raise InputError(f"{path}: pose {late + 1} is not later than its predecessor")
    if (np.abs(table[:, 1:]) > MAX_COORDINATE_M).any():
        raise InputError(f"{path}: has a coordinate or quaternion above {MAX_COORDINATE_M:g}")
    length = np.linalg.norm(table[:, 4:], axis=1)
    bad = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[bad] - 1.0) > 1e-2:
        raise InputError(f"{path}: the quaternion of pose {bad + 1} has length {length[bad]:.3g}, not 1")
    wxyz = table[:, [7, 4, 5, 6]] / length[:, None]
    return table[:, 0], make_pose(matrix_from_wxyz(wxyz), table[:, 1:4])


@dataclass(frozen=True)
class Choice:
    """The best set of edges for a trajectory."""

    wanted: int
    """requested number of edges"""
    edges: Ints
    """(k,) in the order in which they were chosen; fewer than wanted where the others are not seen"""
    ratio: Array
    """(6,) their sigma over that of all edges; inf where the set does not determine it, NaN where not even
    all edges do"""


@dataclass(frozen=True)
class Assessment:
    """The metric along a trajectory, for a noise of sigma_px normal to the edges."""

    subject: Subject
    views: list[EdgeView]
    expected: list[ExpectedTracking]
    """of a tracker of these edges, at each view"""
    edges: Contributions
    choice: Choice | None
    """None: not requested"""
    sigma_px: float

    @property
    def sigma(self) -> Array:
        """(k, 6) standard deviations [m, rad], inf where a view does not determine them."""
        return self.sigma_px * np.stack([view.metric.sigma for view in self.views])

    @property
    def expected_sigma(self) -> Array:
        """(k, 6) standard deviations [m, rad] that a tracker should have; inf as ``sigma``."""
        return np.stack([each.sigma for each in self.expected])


def assess(subject: Subject, sigma_px: float, few: int | None, progress: Progress) -> Assessment:
    """Evaluate all views; select the best ``few`` edges, if that is a number.

    Raises InputError for numbers out of their range, and when the matrices would not fit into memory.
    """
    check_numbers(sigma_px, few)
    size_mib = len(subject.X_RG) * subject.model.size * 36 * 8 / 2**20
    if size_mib > 1024.0:
        fewer_edges = "" if Path(subject.source).is_dir() else ", or a larger --crease-deg"
        raise InputError(
            f"{len(subject.X_RG)} poses of {subject.model.size} edges take {size_mib:.0f} MiB: "
            f"give fewer poses{fewer_edges}"
        )
    model, views, C = subject.model, list[EdgeView](), []
    expected: list[ExpectedTracking] = []
    with progress.stage("evaluating views", len(subject.X_RG)) as advance:
        for view in views_along(model, subject.rig, subject.X_RG, subject.o_G):
            # under the Sun that the user gives, or under some around the camera
            sun_G = subject.sun_G
            light = None if sun_G is None else lit_from(view.X_RG[:3, :3] @ sun_G[len(views)])
            at = model, subject.rig, view.X_RG, light
            expected.append(expected_tracking(*at, about_G=subject.o_G, points=view.points))
            views.append(view)
            C.append(by_feature(view.points, view.f, model.size))
            advance()
    information, choice = FeatureInformation(np.stack(C), model.radius_m), None
    if few is not None:
        with progress.stage("selecting edges", 1) as advance:
            # 20 views, evenly spread over the trajectory: more barely change the result
            chosen = np.unique(np.linspace(0, len(C) - 1, min(len(C), 20)).round().astype(int))
            some = FeatureInformation(information.C[chosen], model.radius_m)
            edges = greedy(some, few)
            choice = Choice(few, edges, sigma_ratio(some, edges))
            advance()
    return Assessment(subject, views, expected, contributions(information), choice, sigma_px)
