"""The predicted motion of a run's target: the last state propagated, as a table, an archive and text."""

import math
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from polhode.backend.problem.inertia import FORMS, inertia_by_parameters
from polhode.config.loader import load_stored_config
from polhode.files.output.single_file import make_parent, output_file
from polhode.geometry.lie import Array, Bools, Ints, continuous_wxyz, wxyz_from_matrix
from polhode.planning.prediction import (
    ROWS_AT_ONCE,
    FinalEstimate,
    FinalState,
    PredictedMotion,
    predict,
)
from polhode.records.estimate import Prediction
from polhode.run_directory.archives import (
    STATE_ORDER,
    load_archive,
    read_covariance,
    read_hypotheses,
    undetermined_as_inf,
    write_arrays,
)
from polhode.run_directory.run_folder import require_run_folder
from polhode.run_directory.summary import read_summary
from polhode.run_directory.summary_in_words import describe_intervals
from polhode.run_directory.summary_schema import Summary
from polhode.run_directory.trajectory_file import (
    Trajectory,
    is_as_written,
    read_trajectory,
    require_same_frames,
    standard_deviations,
    write_trajectory,
)
from polhode.runtime.errors import InputError
from polhode.runtime.progress import Progress, Silent

MAX_ROWS = 100_000
LONG_ROWS = 2_000
"""A prediction with more rows than these takes seconds and shows its progress."""
MIN_HORIZON_S, MAX_HORIZON_S = 1e-6, 1e8
ARRAYS = (
    "timestamps_ns", "r_N", "v_N", "q_NP_wxyz", "w_P", "covariance", "covariance_of_marks", "order",
    "sigma_parts", "parts", "region_sigmas",
)  # fmt: skip
"""Names in the archive of a prediction; earlier versions had not the last three."""
PARTS = ("last state", "inertia", "disturbances")
QUANTITIES = ("position", "velocity", "attitude", "rate")


def predict_run(
    run_folder: Path,
    horizon_s: float,
    step_s: float | None = None,
    from_last: bool = False,
    progress: Progress | None = None,
    hypothesis: int = 1,
) -> PredictedMotion:
    """Predict to ``horizon_s`` after the last pair, every ``step_s`` (the run's own interval unless given).

    The last row is at the horizon; ``from_last``: the first one is the last pair's. The covariance is as in
    covariance.npz, ``inf`` on the diagonal where undetermined. ``hypothesis``: which of the run's hypotheses
    of the rotation, 1 that of trajectory.csv. Raises InputError when the run has no estimate, the times are
    invalid, or there is no such hypothesis.
    """
    _, summary = last_body(run_folder)
    ends = final_estimates(run_folder)
    if not 1 <= hypothesis <= len(ends):
        raise InputError(f"hypothesis {hypothesis}: {run_folder} has {len(ends)}; give 1 to {len(ends)}")
    time_s, timestamps_ns = prediction_instants(run_folder, horizon_s, step_s, from_last)
    return _predict_motion(run_folder, ends[hypothesis - 1], summary, time_s, timestamps_ns, progress)


def predict_instants(run_folder: Path, time_s: Array) -> PredictedMotion:
    """Predict to times (T,) [s] after the last pair. Raises InputError: no estimate, or not increasing."""
    last, summary = last_body(run_folder)
    require_instants(time_s, last)
    stamps = read_trajectory(run_folder).timestamps_ns[-1] + np.round(time_s * 1e9).astype(np.int64)
    return _predict_motion(run_folder, final_estimates(run_folder)[0], summary, time_s, stamps, None)


def _predict_motion(
    run_folder: Path,
    estimate: FinalEstimate,
    summary: Summary,
    time_s: Array,
    timestamps_ns: Ints,
    progress: Progress | None,
) -> PredictedMotion:
    assert summary.identifiable_components is not None
    shown = Silent() if progress is None or len(time_s) <= LONG_ROWS else progress
    with shown.stage("prediction", math.ceil(len(time_s) / ROWS_AT_ONCE)) as advance:
        psd = estimate.accel_psd, estimate.torque_psd
        states = predict(estimate.last, time_s, *psd, estimate.level_decades, advance)
    joint, parts = read_covariance(run_folder).last_joint[:12, :12], summary.identifiable_components
    lost = undetermined_components(joint, ~np.array(parts.com_P), ~np.array(parts.axes_P), states)
    covariance, diagonal = states.covariance, np.arange(12)
    covariance[:, diagonal, diagonal] = np.where(lost, np.inf, covariance[:, diagonal, diagonal])
    for start in range(0, len(time_s), LONG_ROWS):
        rows = slice(start, start + LONG_ROWS)
        covariance[rows] = undetermined_as_inf(covariance[rows])
    return PredictedMotion(
        **vars(states),
        timestamps_ns=timestamps_ns,
        undetermined=undetermined_names(summary),
        R_GP=estimate.last.R_GP,
        com_G=estimate.com_G,
        ranges=tuple(describe_intervals(summary)),
    )


def prediction_instants(
    run_folder: Path, horizon_s: float, step_s: float | None, from_last: bool
) -> tuple[Array, Ints]:
    """Seconds after the last pair (T,) and timestamps (T,) of a prediction."""
    table = read_trajectory(run_folder)
    stamps = table.timestamps_ns
    require_horizon(horizon_s, float(np.linalg.norm(table.w_P[-1])))
    if step_s is None and len(stamps) < 2:
        raise InputError(f"{run_folder}: one row has no interval; give --step-s")
    step_s = float(np.median(np.diff(stamps))) * 1e-9 if step_s is None else step_s
    time_s = prediction_times(horizon_s, step_s)
    if from_last:
        time_s = np.concatenate([[0.0], time_s])
    return time_s, stamps[-1] + np.round(time_s * 1e9).astype(np.int64)


def undetermined_names(summary: Summary) -> tuple[str, ...]:
    """Names of the quantities that the run's motion does not determine."""
    return tuple(name for name, words in summary.identifiable_detail.items() if words.startswith("not"))


def require_instants(time_s: Array, last: FinalState) -> None:
    """Raise InputError unless these are times (T,) [s] after the last pair that can be predicted."""
    if time_s.ndim != 1 or not 1 <= len(time_s) <= MAX_ROWS:
        raise InputError(f"times of shape {time_s.shape}: give one, or a row of up to {MAX_ROWS}")
    if not (np.isfinite(time_s).all() and time_s[0] >= 0.0 and (np.diff(time_s) > 0.0).all()):
        raise InputError("times: give increasing seconds after the last pair, none below 0")
    if time_s[-1] > 0.0:
        require_horizon(float(time_s[-1]), float(np.linalg.norm(last.w_G)))


def require_horizon(horizon_s: float, rate_rad_s: float) -> None:
    """Raise InputError for a horizon that is no time above 0, or has too many revolutions to predict."""
    if not (np.isfinite(horizon_s) and horizon_s > 0.0):
        raise InputError(f"--horizon {horizon_s:g}: give the seconds to look ahead, a number above 0")
    turns = horizon_s * rate_rad_s / (2.0 * np.pi)
    if turns > 1e4:
        raise InputError(
            f"--horizon {horizon_s:g}: {turns:.3g} revolutions of the target; at most 10000 can be"
        )
    if not MIN_HORIZON_S <= horizon_s <= MAX_HORIZON_S:
        raise InputError(f"--horizon {horizon_s:g}: give seconds from {MIN_HORIZON_S:g} to {MAX_HORIZON_S:g}")


def prediction_times(horizon_s: float, step_s: float) -> Array:
    """Seconds after the last pair: multiples of the step, and the horizon > 0. Raises InputError."""
    require_step(step_s)
    if horizon_s / step_s > MAX_ROWS:
        raise InputError(
            f"--horizon {horizon_s:g} s in steps of {step_s:g} s makes more than {MAX_ROWS} rows: "
            "give a larger --step-s"
        )
    steps = step_s * np.arange(1, int(horizon_s / step_s + 1e-9) + 1)
    # a last step that all but reaches the horizon, or has its timestamp, is the horizon
    before = (steps < horizon_s - 1e-6 * step_s) & (np.round(steps * 1e9) < np.round(horizon_s * 1e9))
    return np.concatenate([steps[before], [horizon_s]])


def require_step(step_s: float) -> None:
    """Raise InputError for a step that is no time above 0, or too short for timestamps in nanoseconds."""
    if not 0.0 < step_s <= MAX_HORIZON_S:
        raise InputError(f"--step-s {step_s:g}: give the seconds between two rows, a number above 0")
    if step_s < 1e-9:
        raise InputError(f"--step-s {step_s:g}: timestamps are whole nanoseconds; give 1e-09 or more")


def last_body(run_folder: Path) -> tuple[FinalState, Summary]:
    """The end of a run, ready for ``planning.prediction.predict``.

    Raises InputError when there is none.
    """
    require_run_folder(run_folder)
    summary = read_summary(run_folder)
    if summary.inertia is None or summary.R_GP is None:
        raise InputError(f"{run_folder}: this run failed before it had an estimate; nothing can be predicted")
    stored = read_covariance(run_folder)
    covariance = stored.last_body
    if covariance is None:
        raise InputError(f"{run_folder / 'covariance.npz'}: the array last_body is missing; run it again")
    table, R_GP = read_trajectory(run_folder), np.array(summary.R_GP)
    require_same_frames(run_folder, table, stored.timestamps_ns, "covariance.npz")
    form = FORMS[load_stored_config(run_folder / "config.yaml").backend.inertia]
    J, by_parameters = inertia_by_parameters(np.array(summary.inertia.J_G), form)
    known = summary.identifiable
    past: tuple[Array, ...] = ()
    if known is not None and not (known.k1 and known.k2 and known.axes):
        # twenty frames bound an inertia that is not determined
        before = np.unique(np.linspace(0, len(table.time_s) - 2, 20).astype(int))[::-1]
        past = table.time_s[before] - table.time_s[-1], table.R_NP[before] @ R_GP.T
    r_N, v_N, R_NG, w_G = table.r_N[-1], table.v_N[-1], table.R_NP[-1] @ R_GP.T, R_GP @ table.w_P[-1]
    shifts = summary.intervals.com_shift_P if summary.intervals is not None else None
    covariance = as_wide_as_bounds(covariance, R_GP, shifts or ())
    return FinalState(r_N, v_N, R_NG, w_G, J, R_GP, by_parameters, covariance, *past), summary


def as_wide_as_bounds(
    covariance: Array, R_GP: Array, shifts_P: Sequence[tuple[float, float] | None]
) -> Array:
    """Covariance (20, 20) of a ``FinalState``, with bounds of the centre of mass where it is not determined.

    shifts_P (3): least and largest along each axis of P from the estimate; None: determined. Else the weak
    prior's variance grows to the second moment about the estimate of what is anywhere between the bounds, and
    what hangs on it follows.
    """
    out = covariance.copy()
    for axis_G, ends in zip(R_GP.T, shifts_P, strict=False):
        if ends is None:
            continue
        with_it = out[:, 17:20] @ axis_G
        variance = float(axis_G @ with_it[17:20])
        low, high = ends
        wider = (low**2 + low * high + high**2) / 3.0 - variance
        if wider > 0.0 and variance > 0.0:
            follows = with_it / variance
            out += wider * np.outer(follows, follows)
    return out


def final_estimates(run: Path) -> tuple[FinalEstimate, ...]:
    """The end of a run, of each hypothesis of the rotation, that of trajectory.csv first.

    Raises InputError when the run has no estimate.
    """
    last, summary = last_body(run)
    assert summary.com_G is not None and summary.noise is not None
    bounded = summary.intervals.com_G if summary.intervals is not None else None
    com_range_G = None if bounded is None else (np.array(bounded[0]), np.array(bounded[1]))
    noise, com_G = summary.noise, np.array(summary.com_G)
    decades = noise.accel_psd_decades or 0.0, noise.torque_psd_decades or 0.0
    found = [FinalEstimate(last, com_G, noise.accel_psd, noise.torque_psd, com_range_G, decades)]
    form = FORMS[load_stored_config(run / "config.yaml").backend.inertia]
    for each in read_hypotheses(run)[1:]:
        J, by_parameters = inertia_by_parameters(each.J_G, form)
        end = FinalState(
            each.r_N, each.v_N, each.R_NG, each.w_G, J, each.R_GP, by_parameters, each.covariance
        )
        levels = each.accel_psd, each.torque_psd
        found.append(FinalEstimate(end, each.com_G, *levels, com_range_G, each.level_decades))
    return tuple(found)


def undetermined_components(last: Array, com_lost: Bools, axes_lost: Bools, states: Prediction) -> Bools:
    """Components (T, 12) that depend on what the run does not determine.

    last (12, 12) covariance of the last state, ``inf`` where undetermined; com_lost, axes_lost (3,) along P.
    """
    lost = np.tile(~np.isfinite(np.diagonal(last)), (len(states.time_s), 1))
    # undetermined directions of the body rotate with it: a tenth of a component is enough
    lost[:, 0:3] = lost[:, 3:6] | (np.abs(states.R_NP[:, :, com_lost]) > 0.1).any(axis=2)
    if axes_lost.sum() >= 2:
        # the axes may even be exchanged: nothing expressed in them is determined
        lost[:, 6:] = True
    elif axes_lost.any():
        rate = np.linalg.norm(states.w_P, axis=1, keepdims=True)
        lost[:, 6:9] |= axes_lost
        # an unknown turn about this axis mixes the rates about the other two
        across = np.linalg.norm(states.w_P[:, ~axes_lost], axis=1, keepdims=True) > 0.002 * rate
        lost[:, 9:12] |= across & ~axes_lost
    return np.asarray(lost)


def files_of_hypotheses(path: Path, run_folder: Path) -> list[Path]:
    """A file for each hypothesis of the run's rotation: PATH, PATH_2 and so on."""
    count = max(len(read_hypotheses(run_folder)), 1)
    return [path, *(path.with_stem(f"{path.stem}_{number}") for number in range(2, count + 1))]


def prediction_file(path: Path, run_folder: Path) -> Path:
    """Where a prediction goes, links followed; checked before the work. Raises InputError."""
    return output_file(path, "predict", "prediction.csv", lambda file: _is_prediction(file, run_folder))


def _is_prediction(path: Path, run_folder: Path) -> bool:
    """Whether a file is one of ``write_prediction``: an archive with its arrays, or a table as it is written,
    to the byte, of a free motion at a constant step that does not begin with a frame of the run.

    One row alone shows no motion, so it must follow from the last state of this run. What remains is a table
    that is all of this: of two rows or more of another run that nothing disturbed, or of another prediction.
    """
    try:
        if path.suffix == ".npz":
            return set(ARRAYS[:-3]) <= set(load_archive(path, path.name).arrays) <= set(ARRAYS)
        found, own = read_trajectory(path), read_trajectory(run_folder)
        if found.timestamps_ns[0] in own.timestamps_ns or not is_as_written(found, path):
            return False
    except (InputError, ValueError, OSError):
        return False
    stamps, r_N, v_N = found.timestamps_ns, found.r_N, found.v_N
    if len(stamps) == 1:
        if stamps[0] <= own.timestamps_ns[-1]:
            return False
        stamps = np.append(own.timestamps_ns[-1:], stamps)
        r_N, v_N = np.vstack([own.r_N[-1:], r_N]), np.vstack([own.v_N[-1:], v_N])
    # one velocity, positions that follow from it, and one step, but the last one, which ends at the horizon
    steps_ns, time_s = np.diff(stamps), (stamps - stamps[0]) * 1e-9
    travelled = v_N[0] * time_s[:, None]
    scale = np.abs(r_N).max() + np.abs(travelled).max()
    # timestamps are rounded to nanoseconds
    in_step = (np.abs(steps_ns[:-1] - steps_ns[0]) <= 1).all() and steps_ns[-1] <= 1.000001 * steps_ns[0] + 1
    is_straight = np.abs(r_N[0] + travelled - r_N).max() <= 1e-9 * (scale + np.abs(v_N[0]).max())
    return bool(in_step and is_straight and (v_N == v_N[0]).all())


def write_prediction(prediction: PredictedMotion, path: Path, marks: bool) -> None:
    """The columns of trajectory.csv, or with the suffix .npz all arrays with full covariances.

    ``marks``: the table has the standard deviations of the body itself. Raises RunFailure when the file
    cannot be written there.
    """
    make_parent(path, path)
    states: dict[str, Any] = {
        "timestamps_ns": prediction.timestamps_ns,
        "r_N": prediction.r_N,
        "v_N": prediction.v_N,
        "q_NP_wxyz": continuous_wxyz(wxyz_from_matrix(prediction.R_NP)),
        "w_P": prediction.w_P,
    }
    if path.suffix == ".npz":
        names = "covariance", "covariance_of_marks", "sigma_parts", "region_sigmas"
        spread = {name: getattr(prediction, name) for name in names}
        write_arrays(path, states | spread | {"order": np.array(STATE_ORDER), "parts": np.array(PARTS)})
        return
    sigma = standard_deviations(prediction.covariance_of_marks if marks else prediction.covariance)
    write_trajectory(Trajectory(*states.values(), *np.split(sigma, 4, axis=1)), path)


def format_prediction(prediction: PredictedMotion, is_written: bool, marks: bool) -> str:
    """A few rows as text: the predicted states, each with the standard deviation of its worst axis.

    ``is_written``: there is a file as well; ``marks``: the standard deviations are those of the body itself,
    as they are in the file.
    """
    sigma = standard_deviations(prediction.covariance_of_marks if marks else prediction.covariance)
    q = continuous_wxyz(wxyz_from_matrix(prediction.R_NP))
    deg = np.rad2deg(1.0)
    console = Console(width=120, file=StringIO(), force_terminal=False)
    with console.capture() as capture:
        for title, columns, first, second, scale, parts in (
            (
                "Centre of mass",
                ("r_N x y z [m]", "± [mm]", "v_N x y z [mm/s]", "± [mm/s]"),
                *(prediction.r_N, 1e3 * prediction.v_N, 1e3, (slice(0, 3), slice(3, 6))),
            ),
            (
                "Rotation",
                ("q_NP w x y z", "± [deg]", "w_P x y z [deg/s]", "± [deg/s]"),
                *(q, np.rad2deg(prediction.w_P), deg, (slice(6, 9), slice(9, 12))),
            ),
        ):
            table = Table(title=title)
            for name in ("time [s]", *columns):
                table.add_column(escape(name), justify="right", no_wrap=True)
            for k in shown_rows(prediction.time_s):
                cells = [f"{prediction.time_s[k]:.6g}"]
                for values, digits, part in zip((first, second), (4, 3), parts, strict=True):
                    cells.append(" ".join(f"{x:.{digits}f}" for x in values[k]))
                    cells.append(f"{(scale * sigma[k, part]).max():.2g}")
                table.add_row(*cells)
            console.print(table)
        console.print(_parts_at_horizon(prediction))
    sigmas_of = "the body itself (--marks)" if marks else "the centre of mass and the principal axes"
    words = f"Seconds after the last pair; ±: one standard deviation, worst axis, of {sigmas_of}.\n"
    if prediction.undetermined:
        shown = "the sigmas are those of the body itself"
        if not marks:
            where = " in the file" if is_written else ""
            shown = f"sigmas that depend on it are inf{where}; --marks gives those of the body itself"
        words += f"The run does not determine {', '.join(prediction.undetermined)}: {shown}.\n"
    if prediction.ranges:
        words += f"By the hull of the body: {'; '.join(prediction.ranges)}.\n"
    return capture.get() + words


def _parts_at_horizon(prediction: PredictedMotion) -> Table:
    """What the sigmas of the last row are made of, and how many of them hold 99 %."""
    table = Table(title="Parts of the variance at the horizon")
    for name in ("", *PARTS, "99 % region [sigma]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    variances = np.square(prediction.sigma_parts[-1]).reshape(len(PARTS), 4, 3).sum(axis=2)
    shares = variances / np.maximum(variances.sum(axis=0), 1e-300)
    for name, share, radius in zip(QUANTITIES, shares.T, prediction.region_sigmas[-1], strict=True):
        table.add_row(name, *(f"{each:.0%}" for each in share), f"{radius:.2f}")
    return table


def shown_rows(time_s: Array) -> Ints:
    """Which of the rows (T,) are printed: about six at even steps, the last one at the horizon.

    The steps are even where a number of rows from 4 to 8 divides T. Elsewhere the last one is shorter.
    """
    count = len(time_s)
    fitting = [shown for shown in range(4, 9) if count % shown == 0]
    step = -(-count // min(fitting, key=lambda shown: abs(shown - 6), default=6))
    return np.unique(np.append(np.arange(step - 1, count, step), count - 1)).astype(np.int64)
