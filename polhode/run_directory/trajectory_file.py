"""trajectory.csv, trajectory_online.csv: one row per stereo pair, 26 numeric columns (docs/run_directory.md).

Numbers are written with the shortest text that reads back to the same float64, so the file is exact
and its bytes depend on the estimate alone. Undetermined quantities have sigma ``inf``.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.files.atomic import write_text
from polhode.files.tables import header_of, read_table
from polhode.geometry.lie import Array, Ints, continuous_wxyz, make_pose, matrix_from_wxyz, wxyz_from_matrix
from polhode.records.estimate import MotionEstimate, OnlineEstimate, Prediction
from polhode.records.metrics import States
from polhode.runtime.errors import InputError, RunFailure

TRAJECTORY_COLUMNS: tuple[str, ...] = (
    "timestamp_ns",
    *(f"r_N_{axis}" for axis in "xyz"),
    *(f"v_N_{axis}" for axis in "xyz"),
    *(f"q_NP_{part}" for part in "wxyz"),
    *(f"w_P_{axis}" for axis in "xyz"),
    *(f"sigma_{name}_{axis}" for name in ("r", "v", "theta", "w") for axis in "xyz"),
)
"""The header line. SI units; sigma_r and sigma_v along N, sigma_theta and sigma_w in P."""

MAX_RATE = 300.0
"""[rad/s]: 3000 revolutions in a minute, which no images follow."""
MAX_SIGMA = 1e100
MAX_STATE = 1e15
"""[m, m/s, rad/s]"""


@dataclass(frozen=True)
class Trajectory:
    """Content of trajectory.csv, batch first."""

    timestamps_ns: Ints
    """(F,)"""
    r_N: Array
    """(F, 3) centre of mass [m]"""
    v_N: Array
    """(F, 3) [m/s]"""
    q_NP_wxyz: Array
    """(F, 4) the sign is continuous along the run"""
    w_P: Array
    """(F, 3) [rad/s]"""
    sigma_r: Array
    """(F, 3) along N [m]"""
    sigma_v: Array
    """(F, 3) along N [m/s]"""
    sigma_theta: Array
    """(F, 3) of theta in R_NP Exp(theta) [rad]"""
    sigma_w: Array
    """(F, 3) in P [rad/s]"""

    @property
    def time_s(self) -> Array:
        """(F,) seconds since the first frame."""
        return np.asarray((self.timestamps_ns - self.timestamps_ns[0]) * 1e-9)

    @property
    def R_NP(self) -> Array:
        """(F, 3, 3)"""
        return matrix_from_wxyz(self.q_NP_wxyz)


def target_poses(states: States | Trajectory | Prediction, R_GP: Array, com_G: Array) -> Array:
    """X_NG (F, 4, 4) from the states of the principal frame: p_N = r_N + R_NP R_GP^T (p_G - com_G)."""
    R_NG = states.R_NP @ R_GP.T
    return make_pose(R_NG, states.r_N - R_NG @ com_G)


def standard_deviations(covariance: Array) -> Array:
    """Roots of the diagonals (..., n, n) -> (..., n); ``inf`` where undetermined: not finite or negative."""
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    known = np.isfinite(variance) & (variance >= 0.0)
    return np.where(known, np.sqrt(np.where(known, variance, 0.0)), np.inf)


def trajectory_of(estimate: MotionEstimate | OnlineEstimate) -> Trajectory:
    """The table of the smoothed estimate, or of the causal one."""
    sigma = standard_deviations(estimate.covariance)
    return Trajectory(
        timestamps_ns=estimate.timestamps_ns,
        r_N=estimate.r_N,
        v_N=estimate.v_N,
        q_NP_wxyz=continuous_wxyz(wxyz_from_matrix(estimate.R_NP)),
        w_P=estimate.w_P,
        sigma_r=sigma[:, 0:3],
        sigma_v=sigma[:, 3:6],
        sigma_theta=sigma[:, 6:9],
        sigma_w=sigma[:, 9:12],
    )


def write_trajectory(trajectory: Trajectory, path: Path) -> None:
    """Write the table.

    Raises ValueError when a state is not finite or a sigma is NaN; RunFailure when a state is beyond what is
    read again, as with timestamps in another unit.
    """
    states = np.hstack([trajectory.r_N, trajectory.v_N, trajectory.q_NP_wxyz, trajectory.w_P])
    sigmas = np.hstack([trajectory.sigma_r, trajectory.sigma_v, trajectory.sigma_theta, trajectory.sigma_w])
    if not np.all(np.isfinite(states)) or np.any(np.isnan(sigmas)):
        raise ValueError("the trajectory has a state that is not finite or a sigma that is NaN")
    fastest = float(np.abs(trajectory.w_P).max(initial=0.0))
    if fastest > MAX_RATE or float(np.abs(states).max(initial=0.0)) > MAX_STATE:
        raise RunFailure(
            f"the target would rotate at {fastest * 30.0 / np.pi:.3g} RPM, which no images can follow: check "
            "that the timestamps in data.csv are nanoseconds"
        )
    write_text(path, _text(np.hstack([states, sigmas]), trajectory.timestamps_ns))


def is_as_written(trajectory: Trajectory, path: Path) -> bool:
    """Whether a file that was read is, to the byte, what ``write_trajectory`` writes."""
    values = [value for name, value in vars(trajectory).items() if name != "timestamps_ns"]
    return path.read_bytes() == _text(np.hstack(values), trajectory.timestamps_ns).encode()


def _text(values: Array, timestamps_ns: Ints) -> str:
    lines = [",".join(TRAJECTORY_COLUMNS)]
    for timestamp_ns, row in zip(timestamps_ns.tolist(), values.tolist(), strict=True):
        lines.append(",".join([str(timestamp_ns), *map(repr, row)]))
    return "\n".join(lines) + "\n"


def read_trajectory(path: Path) -> Trajectory:
    """Read trajectory.csv (the file, or its run folder). Raises InputError, one line."""
    file = path / "trajectory.csv" if path.is_dir() else path
    if not file.is_file():
        raise InputError(f"{file}: no such file; give the folder of a run that reached an estimate")
    if tuple(header_of(file)) != TRAJECTORY_COLUMNS:
        raise InputError(
            f"{file}: line 1 is not the header of a trajectory; it must begin with timestamp_ns,r_N_x"
        )
    table = read_table(file, len(TRAJECTORY_COLUMNS) - 1, finite=False, docs="docs/run_directory.md")
    states, sigmas, q_wxyz = table.values[:, :13], table.values[:, 13:], table.values[:, 6:10]
    with np.errstate(invalid="ignore", over="ignore"):
        too_large = np.isfinite(sigmas) & (sigmas > MAX_SIGMA)
        checks = {
            "a state that is NaN or infinite": ~np.isfinite(states).all(axis=1),
            f"a state above {MAX_STATE:g}": (abs(states) > MAX_STATE).any(axis=1),
            f"an angular velocity above {MAX_RATE:g} rad/s": (abs(states[:, 10:]) > MAX_RATE).any(axis=1),
            "a standard deviation that is NaN or negative": ~(sigmas >= 0.0).all(axis=1),
            f"a finite standard deviation above {MAX_SIGMA:g}": too_large.any(axis=1),
            "a quaternion that is not of unit length": abs(np.linalg.norm(q_wxyz, axis=1) - 1.0) > 1e-2,
        }
    for what, bad in checks.items():
        if bad.any():
            line = table.lines[int(np.argmax(bad))]
            raise InputError(f"{table.path} line {line}: {what}; run 'polhode run' again")
    parts = np.split(table.values, [3, 6, 10, 13, 16, 19, 22], axis=1)
    return Trajectory(table.timestamps_ns, *parts)


def require_same_frames(
    folder: Path, trajectory: Trajectory | States, timestamps_ns: Ints, other: str
) -> None:
    """Raise InputError unless the rows of the trajectory are those of another file of the run."""
    if not np.array_equal(trajectory.timestamps_ns, timestamps_ns):
        raise InputError(
            f"{folder / 'trajectory.csv'} and {other} have different frames, so they are not of one run; "
            "run 'polhode run' again"
        )
