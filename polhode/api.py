"""The library: ``polhode.run``, ``load``, ``simulate``, ``evaluate``, and a finished run as an object.

Everything is what the command line does and reads the same files; a mistake of the caller raises
``polhode.runtime.errors.InputError`` with one line, a run without an answer ``RunFailure``.
``polhode.Session`` is the live estimate (``polhode/pipeline/live/session.py``), ``polhode.stages`` each
stage by itself. docs/api.md has examples.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from polhode.config import Config
from polhode.config.keys import suggestion
from polhode.config.loader import load_config
from polhode.geometry.lie import Array, Ints
from polhode.pipeline.run import run as run_pipeline
from polhode.planning.approach.surface_speed import velocity, velocity_covariance
from polhode.planning.edges.edge_model import CREASE_DEG
from polhode.planning.exports.export_run import export_run
from polhode.planning.exports.formats import Format
from polhode.planning.exports.options import ExportOptions, FrameName, Poses, Unit
from polhode.planning.keep_out.measured_body import Cover
from polhode.planning.keep_out.queries import KeepOut
from polhode.planning.keep_out.volumes import KeepOutOptions
from polhode.planning.observability.assess import (
    Assessment,
    CameraOptions,
    assess,
    subject_of,
    sun_direction,
)
from polhode.planning.plan import final_estimate, keep_out_of_run, surface_of
from polhode.planning.predict import predict_instants, require_instants
from polhode.planning.prediction import PredictedMotion, nominal_motion
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel
from polhode.records.tracks import RelativePoses, StereoTracks
from polhode.report import evaluate_and_report
from polhode.report.evaluation import Metrics
from polhode.run_directory.archives import (
    MeasurementResiduals,
    read_covariance,
    read_measurements,
    read_relative_poses,
    read_residuals,
    undetermined_as_inf,
)
from polhode.run_directory.data_frames import TableName, columns_of, kept_landmarks
from polhode.run_directory.point_cloud_file import read_landmarks
from polhode.run_directory.run_folder import REPORT, require_run_folder
from polhode.run_directory.stored_run import StoredMotion, read_motion
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_in_words import describe_summary
from polhode.run_directory.summary_schema import Identifiable, Intervals, Rotation, Summary, Verdict
from polhode.run_directory.trajectory_file import Trajectory, read_trajectory
from polhode.runtime.argument_names import errors_name_arguments
from polhode.runtime.console import choose_progress
from polhode.runtime.errors import InputError, RunFailure
from polhode.runtime.processes import start_server, worker_count
from polhode.runtime.progress import Progress, Silent
from polhode.runtime.threads import single_threaded

if TYPE_CHECKING:
    import pandas as pd

T = TypeVar("T")
EXPORT_OPTIONS = tuple(each.name for each in fields(ExportOptions) if each.name not in ("to", "output"))
EXPORT_WORDS = {word: word for each in (Format, FrameName, Unit, Poses, Cover) for word in get_args(each)}
"""What ``Run.export`` passes on, and the texts among their values"""

NO_ESTIMATE = "this run failed before it had an estimate"
Configuration = Config | str | Path | Mapping[str, Any] | None
"""A configuration, a file of one, settings that differ from the default ({"backend.inertia": "ratios_axes"},
or nested), or the default"""


@errors_name_arguments()
def run(
    data: str | Path,
    output: str | Path | None = None,
    config: Configuration = None,
    *,
    overwrite: bool = False,
    resume: bool = False,
    progress: Progress | bool = True,
) -> "Run":
    """Estimate motion, mass properties, map and mesh from a stereo sequence, as ``polhode run``.

    data: folder of the sequence; output: folder of the run, None: a temporary one, which is removed with the
    last reference to what is returned; resume: stages that an earlier run has finished there are used again.
    Raises InputError for bad input, which leaves nothing behind; RunFailure when no motion is found, and then
    ``output`` holds what was found before. A motion that cannot be trusted is returned, with its status.
    """
    values, shown = configuration(config), chosen_progress(progress)
    start_server((run_pipeline.__module__,), worker_count(values.runtime.workers))
    if output is not None:
        run_pipeline(values, Path(data), Path(output), shown, overwrite=overwrite, resume=resume)
        return Run(Path(output))
    temporary = tempfile.TemporaryDirectory(prefix="polhode-")
    folder = Path(temporary.name) / "run"
    try:
        run_pipeline(values, Path(data), folder, shown)
    except BaseException as error:
        temporary.cleanup()
        if not isinstance(error, RunFailure):
            raise
        raise RunFailure(f"{error} (a temporary folder, which is removed: give output to keep it)") from None
    return Run(folder, temporary)


def load(run: str | Path) -> "Run":
    """A finished run. Raises InputError if the folder holds none."""
    return Run(Path(run))


def load_study(study: str | Path) -> "pd.DataFrame":
    """The table of a study of ``polhode sweep`` as a data frame: a row for each point (docs/studies.md).

    Of a study that is not finished, it has the points that are. Needs pandas. Raises InputError: the folder
    is that of no study.
    """
    from polhode.studies.table import load_study as load_table

    return load_table(Path(study))


@errors_name_arguments()
@single_threaded
def simulate(
    config: Configuration,
    output: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress | bool = True,
) -> Path:
    """Render a sequence with truth from the scene of a configuration, as ``polhode simulate``.

    Returns the folder. Raises InputError: there is no scene, or ``output`` is taken.
    """
    from polhode.simulation.dataset.sequence import plan_sequence, require_free, write_sequence

    values = configuration(config)
    if values.scene is None:
        raise InputError("the configuration has no 'scene' to simulate; configs/scenes/ has examples")
    folder = Path(output)
    require_free(folder, overwrite)
    plan = plan_sequence(values.scene, values.seed)
    write_sequence(plan, folder, chosen_progress(progress), worker_count(values.runtime.workers), overwrite)
    return folder


@errors_name_arguments()
@single_threaded
def evaluate(run: "Run | str | Path", data: str | Path) -> Metrics:
    """Errors of a run against the truth of its sequence: the content of metrics.json, which is written, too.

    Values that cannot be computed are None. Raises InputError: no estimate, no truth, or another sequence's.
    """
    return evaluate_and_report(run.folder if isinstance(run, Run) else Path(run), Path(data))


def configuration(config: Configuration) -> Config:
    """The configuration that is meant. Raises InputError for an unknown key, a wrong type or value."""
    if isinstance(config, Config):
        return config
    if isinstance(config, Mapping):
        return load_config(None, config, "settings")
    return load_config(None if config is None else Path(config))


def chosen_progress(wanted: Progress | bool) -> Progress:
    if isinstance(wanted, bool):
        return choose_progress() if wanted else Silent()
    return wanted


@dataclass(frozen=True)
class MassEstimate:
    """How the mass is distributed, up to scale; variances are ``inf`` where the motion does not show it."""

    k: Array
    """(2,) k1 = ln(Jxx / Jyy), k2 = ln(Jyy / Jzz)"""
    cov_k: Array
    """(2, 2)"""
    moments: Array
    """(3,) Jxx >= Jyy >= Jzz, the middle one 1"""
    J_G: Array
    """(3, 3) about the centre of mass, axes of G"""
    com_G: Array
    """(3,) centre of mass [m]"""
    cov_com_G: Array
    """(3, 3) [m^2]"""
    R_GP: Array
    """(3, 3) principal axes, as columns in G"""
    cov_R_GP: Array
    """(3, 3) of theta in R_GP Exp(theta) [rad^2]"""
    identifiable: Identifiable
    """What the motion determines"""
    intervals: Intervals | None
    """Where the rest can lie, by other bounds"""
    mass_kg: float | None
    """None: no forces are known"""


class Run:
    """A finished run: what was estimated, how sure it is, and what follows from it.

    Its files are read when they are asked for.
    """

    def __init__(self, folder: Path, temporary: "tempfile.TemporaryDirectory[str] | None" = None) -> None:
        """``temporary`` holds the folder as long as this object lives. Raises InputError: there is no run."""
        require_run_folder(folder)
        self.folder, self._temporary = folder, temporary
        self.summary: Summary = read_summary(folder)
        """The content of summary.json"""

    def __repr__(self) -> str:
        return f"<polhode.Run {self.folder}: {describe_summary(self.summary)}>"

    @property
    def status(self) -> Literal["ok", "degraded", "failed"]:
        """Whether the answer can be trusted, in a word."""
        return self.summary.status

    @property
    def verdict(self) -> Verdict | None:
        """The same with reasons and every check; None: of an earlier version."""
        return self.summary.verdict

    @property
    def report(self) -> Path:
        """The page to open."""
        return self.folder / REPORT

    @cached_property
    def trajectory(self) -> Trajectory:
        """States of every pair, with standard deviations. Raises InputError."""
        return read_trajectory(self.folder / "trajectory.csv")

    @cached_property
    def online(self) -> Trajectory:
        """The same as it was known when each pair came. Raises InputError: the window was off."""
        return read_trajectory(self.folder / "trajectory_online.csv")

    @cached_property
    def covariance(self) -> Array:
        """(F, 12, 12) of r (N), v (N), theta (P), w (P); ``inf`` on the diagonal where undetermined."""
        return read_covariance(self.folder).covariance

    @cached_property
    def covariance_of_marks(self) -> Array:
        """(F, 12, 12) as ``covariance``, of the body itself: always finite (docs/run_directory.md).

        The estimated centre of mass and axes are exact marks on the body, as in a prediction. Raises
        InputError: the run is of an earlier version, which stored it for the last frame alone.
        """
        return _there(
            read_covariance(self.folder).covariance_of_marks,
            f"{self.folder / 'covariance.npz'}: an earlier version wrote it, without the covariance of "
            "marks in every frame; run it again, or take that of the last one from predict(0.0)",
        )

    @cached_property
    def mass(self) -> MassEstimate:
        """Inertia, centre of mass and axes. Raises InputError if the run ended before it had them."""
        found = self.summary
        if found.inertia is None or found.com_G is None or found.R_GP is None or found.identifiable is None:
            raise InputError(f"{self.folder}: {NO_ESTIMATE}")
        return MassEstimate(
            k=np.array([found.inertia.k1, found.inertia.k2]),
            cov_k=_variances(found.inertia.cov),
            moments=np.array(found.inertia.moments),
            J_G=np.array(found.inertia.J_G),
            com_G=np.array(found.com_G),
            cov_com_G=_variances(found.cov_com_G),
            R_GP=np.array(found.R_GP),
            cov_R_GP=_variances(found.cov_R_GP),
            identifiable=found.identifiable,
            intervals=found.intervals,
            mass_kg=found.inertia.mass_kg,
        )

    @property
    def rotation(self) -> Rotation:
        """Angular momentum and spin axis at the last pair (None: undetermined). Raises InputError."""
        words = f"{self.folder}: no estimate, or that of an earlier version, without rotation; run it again"
        return _there(self.summary.rotation, words)

    @cached_property
    def X_NG(self) -> Array:
        """(F, 4, 4) pose of the body frame G in N. Raises InputError without an estimate."""
        return self._motion.X_NG

    @cached_property
    def _motion(self) -> StoredMotion:
        return _there(read_motion(self.folder, self.summary), f"{self.folder}: {NO_ESTIMATE}")

    @cached_property
    def landmarks(self) -> Landmarks:
        """The sparse map in G. Raises InputError."""
        return read_landmarks(self.folder / "landmarks.ply")

    @cached_property
    def landmark_numbers(self) -> Ints:
        """(L,) the number of each landmark of the map in ``measurements.landmark``, ascending.

        A landmark with outliers only is in the measurements, but not in the map. Raises InputError.
        """
        return kept_landmarks(self.folder)

    @cached_property
    def surface(self) -> SurfaceModel:
        """The dense mesh in G, with the standard deviation of each vertex. Raises InputError: none."""
        return surface_of(self.folder)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The dense mesh in G [m]. Raises InputError: there is none."""
        return self.surface.mesh

    @cached_property
    def measurements(self) -> StereoTracks:
        """The tracks that a back end of one's own can start from. Raises InputError."""
        return read_measurements(self.folder)

    @cached_property
    def links(self) -> RelativePoses:
        """The relative poses of matched frames, for ``stages.first_motion``. Raises InputError."""
        words = f"{self.folder}: this run ended before it had matched frames"
        return _there(read_relative_poses(self.folder), words)

    @cached_property
    def residuals(self) -> MeasurementResiduals:
        """Residual (M, 3) [px] and weight (M,) of each measurement after the estimate. Raises InputError."""
        return _there(read_residuals(self.folder), f"{self.folder}: {NO_ESTIMATE}")

    @errors_name_arguments({"--horizon": "time_s"})
    def predict(self, time_s: ArrayLike) -> PredictedMotion:
        """The motion at times (T,), or one time, in seconds after the last pair, with its covariance.

        Raises InputError: no estimate, times that do not increase or are negative.
        """
        return predict_instants(self.folder, np.atleast_1d(_seconds(time_s)))

    @errors_name_arguments({"--horizon": "horizon_s"})
    def keep_out(
        self,
        horizon_s: float = 60.0,
        confidence: float = 0.99,
        *,
        members: int | None = None,
        cover: Cover = "auto",
    ) -> KeepOut:
        """The space that the target may sweep over the horizon, in N; ``signed_distance`` of points in it.

        Raises InputError: no mesh, no estimate, or too few members for the confidence.
        """
        options = KeepOutOptions(horizon_s, confidence, members=members, cover=cover)
        return keep_out_of_run(self.folder, options)

    @errors_name_arguments({"--horizon": "time_s"})
    def points_N(self, p_G: ArrayLike, time_s: ArrayLike = 0.0) -> Array:
        """Places in N [m] of points fixed to the target.

        p_G (n, 3) [m], or one point (3,), in the body frame G, as the vertices of ``mesh`` and the landmarks.
        time_s: seconds after the last pair. One time gives (n, 3), increasing times (T,) give (T, n, 3); one
        point leaves out n. Raises InputError: no estimate, points or times that do not fit.
        """
        points, time = _points(p_G), _seconds(time_s)
        return _of_times(predict_instants(self.folder, np.atleast_1d(time)).points_N(points), time)

    @errors_name_arguments({"--horizon": "time_s"})
    def points_covariance(self, p_G: ArrayLike, time_s: ArrayLike = 0.0) -> Array:
        """Covariance along N [m^2] of ``points_N``, whose shapes it has, and 3 x 3.

        To first order, from ``predict(time_s).covariance_of_marks``; so it includes the uncertain centre of
        mass, and is finite where the motion does not determine it. The points are exact in G: the standard
        deviation of a landmark or vertex is not part of it. Raises InputError as ``points_N``.
        """
        points, time = _points(p_G), _seconds(time_s)
        return _of_times(predict_instants(self.folder, np.atleast_1d(time)).points_covariance(points), time)

    @errors_name_arguments({"--horizon": "time_s"})
    def points_velocity(self, p_G: ArrayLike, time_s: ArrayLike = 0.0) -> Array:
        """Velocity along N [m/s] of points fixed to the target: as ``points_N``, in all but the unit."""
        points, time = _points(p_G), _seconds(time_s)
        estimate, _ = final_estimate(self.folder)
        require_instants(np.atleast_1d(time), estimate.last)
        found = velocity(nominal_motion(estimate, np.atleast_1d(time)), slice(None), np.atleast_2d(points))
        return _of_times(found[:, 0] if points.ndim == 1 else found, time)

    @errors_name_arguments({"--horizon": "time_s"})
    def points_velocity_covariance(self, p_G: ArrayLike, time_s: ArrayLike = 0.0) -> Array:
        """Covariance along N [(m/s)^2] of ``points_velocity``: as ``points_covariance``."""
        points, time = _points(p_G), _seconds(time_s)
        motion, lever_G = predict_instants(self.folder, np.atleast_1d(time)), points - self.mass.com_G
        found = velocity_covariance(motion, np.atleast_2d(lever_G) @ self.mass.R_GP)
        return _of_times(found[:, 0] if points.ndim == 1 else found, time)

    @errors_name_arguments({"--sun": "sun_N"}, words={"inertial": "N"})
    def observability(
        self,
        trajectory: str | Path | None = None,
        *,
        frame: Literal["G", "N"] = "G",
        sigma_px: float = 1.0,
        sun_N: Sequence[float] | None = None,
        edges: int | None = None,
    ) -> Assessment:
        """How well edges of the mesh determine the relative pose along a trajectory of the camera.

        trajectory: a TUM file in ``frame``, None: the run's own pairs. sigma_px: noise normal to an edge,
        every 10 px; sun_N: direction to the Sun; edges: also select the best of so many. Raises InputError
        for input that does not fit.
        """
        sun = sun_direction(sun_N)
        path = None if trajectory is None else Path(trajectory)
        subject = subject_of(self.folder, path, frame, CameraOptions(), None, sun, CREASE_DEG, 1.0)
        return assess(subject, sigma_px, edges, Silent())

    @errors_name_arguments(words=EXPORT_WORDS, further=EXPORT_OPTIONS)
    def export(self, to: Format, output: str | Path, **options: Any) -> list[Path]:
        """Write the run in another program's format, as ``polhode export``; options of that name.

        Returns the files, the one that was asked for last. Raises InputError.
        """
        unknown = next((name for name in options if name not in EXPORT_OPTIONS), None)
        if unknown is not None:
            raise InputError(
                f"export has no option '{unknown}';{suggestion(unknown, EXPORT_OPTIONS)} "
                f"options: {', '.join(EXPORT_OPTIONS)}"
            )
        return export_run(self.folder, ExportOptions(to, Path(output), **options), Silent()).files

    def to_pandas(self, table: TableName = "trajectory") -> "pd.DataFrame":
        """A table of the run, with the columns and units of docs/run_directory.md (needs pandas).

        table: "trajectory", "online", "landmarks", "observations" (with residuals) or "checks". Raises
        InputError: pandas is not installed, there is no such table, or the run has no such file.
        """
        columns = columns_of(table, self.folder, self.summary)
        try:
            import pandas as pd
        except ImportError:
            raise InputError("pandas is not installed: pip install 'polhode[pandas]'") from None
        return pd.DataFrame(columns)


def _there(found: T | None, words: str) -> T:
    """Raises InputError: it is not."""
    if found is None:
        raise InputError(words)
    return found


def _numbers(values: ArrayLike, what: str) -> Array:
    """Raises InputError."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(what) from None


def _seconds(time_s: ArrayLike) -> Array:
    """One time () or times (T,). Raises InputError: not numbers."""
    return _numbers(time_s, "times: give numbers, in seconds after the last pair")


def _of_times(found: Array, time: Array) -> Array:
    """What was found at the times (T, ...), or at the only one, where no row was asked for."""
    return found[0] if time.ndim == 0 else found


def _points(p_G: ArrayLike) -> Array:
    """These (n, 3) or one point (3,). Raises InputError."""
    points = _numbers(p_G, "points: give numbers, coordinates (n, 3) in G [m]")
    if points.ndim not in (1, 2) or points.shape[-1] != 3 or not np.isfinite(points).all():
        raise InputError(f"points of shape {np.shape(p_G)}: give finite coordinates (n, 3) in G [m]")
    return points


def _variances(rows: Sequence[Sequence[float | None]] | None) -> Array:
    """A covariance (n, n) of summary.json: null, as a variance, is inf."""
    if rows is None:
        return np.full((3, 3), np.nan)
    return undetermined_as_inf(np.array([[np.nan if each is None else each for each in row] for row in rows]))
