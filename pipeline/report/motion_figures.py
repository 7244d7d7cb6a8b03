"""Figures of the motion: centre of mass, attitude, angular velocity."""

import numpy as np

from polhode.lie import Array
from polhode.pipeline.report.plot_style import (
    AXIS_COLORS,
    INK,
    TIME_TITLE,
    Figure,
    Layout,
    band,
    gap_shapes,
    line,
    panels,
)
from polhode.pipeline.run_directory.stored_run import StoredMotion, StoredRun


def motion_figures(content: StoredRun) -> list[Figure]:
    """Position and velocity, attitude, angular velocity; nothing without an estimate."""
    if content.motion is None:
        return []
    shapes = _bridged(content)
    return [
        _centre_of_mass(content.motion, _bridged(content, columns=3)),
        _angular_velocity(content.motion, shapes),
        _attitude(content.motion, shapes),
    ]


def straight_line_residual(time_s: Array, p: Array, sigma: Array) -> Array:
    """Points (F, 3) minus the straight line at constant speed that fits them best, per axis."""
    if len(time_s) < 3:
        return np.zeros_like(p)
    out = np.empty_like(p)
    for k in range(3):
        known = np.isfinite(sigma[:, k]) & (sigma[:, k] > 0)
        weight = 1.0 / sigma[:, k] if np.all(known) else np.ones(len(time_s))
        out[:, k] = p[:, k] - np.polyval(np.polyfit(time_s, p[:, k], 1, w=weight), time_s)
    return out


def _bridged(content: StoredRun, columns: int = 1) -> list[Layout]:
    if content.tracks is None or content.motion is None:
        return []
    seen = np.zeros(content.tracks.n_frames, dtype=np.bool_)
    seen[content.tracks.frame] = True
    return gap_shapes(content.motion.trajectory.time_s, seen, columns)


def _centre_of_mass(motion: StoredMotion, shapes: list[Layout]) -> Figure:
    path = motion.trajectory
    line_off_mm = 1e3 * straight_line_residual(path.time_s, path.r_N, path.sigma_r)
    columns = (
        (path.r_N, path.sigma_r),
        (line_off_mm, 1e3 * path.sigma_r),
        (1e3 * path.v_N, 1e3 * path.sigma_v),
    )
    titles = [(f"r<sub>{a}</sub> [m]", f"Δr<sub>{a}</sub> [mm]", f"v<sub>{a}</sub> [mm/s]") for a in "xyz"]
    figure = panels(
        titles,
        TIME_TITLE,
        ("position in N", "position minus a straight line", "velocity in N"),
        shapes=shapes,
    )
    data = []
    for row, name in enumerate("xyz"):
        for column, (value, sigma) in enumerate(columns):
            panel, color = 3 * row + column + 1, AXIS_COLORS[row]
            data += band(path.time_s, value[:, row], 3 * sigma[:, row], color, panel)
            data.append(line(path.time_s, value[:, row], name, color, panel))
    return Figure(
        "centre-of-mass",
        "Centre of mass",
        "Position and velocity in the inertial frame N, with bands of three standard deviations. The "
        "middle column takes away the straight line at constant speed that fits best: what is left shows "
        "disturbances and errors at the scale of the bands. "
        f"{_median_sigma(1e3 * path.sigma_r, 'position', 'mm')} "
        f"{_median_sigma(1e3 * path.sigma_v, 'velocity', 'mm/s')}{_grey(shapes)}",
        data,
        figure,
        height_px=560,
        clock="time",
    )


def _angular_velocity(motion: StoredMotion, shapes: list[Layout]) -> Figure:
    path = motion.trajectory
    w_deg_s, sigma_deg_s = np.rad2deg(path.w_P), np.rad2deg(path.sigma_w)
    figure = panels(
        [(f"ω<sub>{a}</sub> [deg/s]",) for a in "xyz"],
        TIME_TITLE,
        shapes=shapes,
    )
    data = []
    for k, name in enumerate("xyz"):
        data += band(path.time_s, w_deg_s[:, k], 3 * sigma_deg_s[:, k], AXIS_COLORS[k], k + 1)
        data.append(line(path.time_s, w_deg_s[:, k], name, AXIS_COLORS[k], k + 1))
    return Figure(
        "angular-velocity",
        "Angular velocity",
        "Of the target relative to N, along its principal axes x, y, z (largest, middle and smallest "
        "moment), with bands of three standard deviations. "
        f"{_median_sigma(sigma_deg_s, 'angular velocity', 'deg/s')}{_grey(shapes)}",
        data,
        figure,
        height_px=520,
        wide=False,
        clock="time",
    )


def _attitude(motion: StoredMotion, shapes: list[Layout]) -> Figure:
    path = motion.trajectory
    sigma_deg = np.rad2deg(path.sigma_theta)
    figure = panels(
        [("quaternion q<sub>NP</sub>",), ("3σ of attitude [deg]",)],
        TIME_TITLE,
        shapes=shapes,
    )
    colors = (INK, *AXIS_COLORS)
    data = [
        line(path.time_s, path.q_NP_wxyz[:, k], name, colors[k], 1)
        for k, name in enumerate(("w", "x", "y", "z"))
    ]
    for k, name in enumerate("xyz"):
        data.append(line(path.time_s, 3 * sigma_deg[:, k], name, AXIS_COLORS[k], 2, mode="lines"))
    figure["yaxis2"]["rangemode"] = "tozero"
    return Figure(
        "attitude",
        "Attitude",
        "Above: the attitude of the principal axes, Hamilton quaternion, scalar first. Below: three standard "
        "deviations of the attitude error about each principal axis. "
        f"{_median_sigma(sigma_deg, 'attitude', 'deg')}{_grey(shapes)}",
        data,
        figure,
        height_px=520,
        wide=False,
        clock="time",
    )


def _median_sigma(sigma: Array, what: str, unit: str) -> str:
    known = np.isfinite(sigma)
    if not np.all(np.any(known, axis=0)):
        axes = ", ".join(
            name for name, any_known in zip("xyz", np.any(known, axis=0), strict=True) if not any_known
        )
        return f"The {what} along {axes} is not determined by the data: no band is drawn."
    values = ", ".join(f"{np.median(sigma[known[:, k], k]):.2g}" for k in range(3))
    return f"Median standard deviation of the {what}: {values} {unit} (x, y, z)."


def _grey(shapes: list[Layout]) -> str:
    return " Grey: frames without measurements, bridged by the dynamics." if shapes else ""
