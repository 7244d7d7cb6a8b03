"""Figures of the motion: centre of mass, attitude, angular velocity."""

from functools import partial

import numpy as np

from polhode.geometry.lie import Array
from polhode.report.plot_style import (
    AXIS_COLORS,
    INK,
    TIME_TITLE,
    Figure,
    Trace,
    gap_shapes,
    line,
    line_with_band,
    panels,
)
from polhode.run_directory.stored_run import StoredRun


def motion_figures(content: StoredRun) -> list[Figure]:
    """Position and velocity, attitude, angular velocity; nothing without an estimate."""
    if content.motion is None:
        return []
    path, seen = content.motion.trajectory, None
    if content.tracks is not None:
        seen = np.isin(np.arange(content.tracks.n_frames), content.tracks.frame)
    shapes = partial(gap_shapes, path.time_s, np.ones(len(path.time_s), dtype=bool) if seen is None else seen)
    grey = " Grey: frames without measurements, bridged by the dynamics." if shapes() else ""
    figure = partial(Figure, clock="time")
    off_line_mm = 1e3 * straight_line_residual(path.time_s, path.r_N, path.sigma_r)
    sigma_r_mm, sigma_v_mm_s = 1e3 * path.sigma_r, 1e3 * path.sigma_v
    columns = ((path.r_N, path.sigma_r), (off_line_mm, sigma_r_mm), (1e3 * path.v_N, sigma_v_mm_s))
    data: list[Trace] = []
    for k, name in enumerate("xyz"):
        for column, (value, sigma) in enumerate(columns):
            data += line_with_band(
                path.time_s, value[:, k], sigma[:, k], name, AXIS_COLORS[k], 3 * k + column + 1
            )
    titles = [(f"r<sub>{a}</sub> [m]", f"Δr<sub>{a}</sub> [mm]", f"v<sub>{a}</sub> [mm/s]") for a in "xyz"]
    above = ("position in N", "position minus a straight line", "velocity in N")
    centre_of_mass = figure(
        "centre-of-mass",
        "Centre of mass",
        "Position and velocity in the inertial frame N, with bands of three standard deviations. The "
        "middle column takes away the straight line at constant speed that fits best: what is left shows "
        "disturbances and errors at the scale of the bands. "
        f"{_median_sigma(sigma_r_mm, 'position', 'mm')} "
        f"{_median_sigma(sigma_v_mm_s, 'velocity', 'mm/s')}{grey}",
        data,
        panels(titles, TIME_TITLE, above, shapes=shapes(columns=3)),
        height_px=560,
    )

    w_deg_s, sigma_w_deg_s = np.rad2deg(path.w_P), np.rad2deg(path.sigma_w)
    data = []
    for k, name in enumerate("xyz"):
        data += line_with_band(path.time_s, w_deg_s[:, k], sigma_w_deg_s[:, k], name, AXIS_COLORS[k], k + 1)
    angular_velocity = figure(
        "angular-velocity",
        "Angular velocity",
        "Of the target relative to N, along its principal axes x, y, z (largest, middle and smallest "
        "moment), with bands of three standard deviations. "
        f"{_median_sigma(sigma_w_deg_s, 'angular velocity', 'deg/s')}{grey}",
        data,
        panels([(f"ω<sub>{a}</sub> [deg/s]",) for a in "xyz"], TIME_TITLE, shapes=shapes()),
        height_px=520,
        wide=False,
    )

    sigma_deg = np.rad2deg(path.sigma_theta)
    colors = (INK, *AXIS_COLORS)
    data = [line(path.time_s, path.q_NP_wxyz[:, k], name, colors[k]) for k, name in enumerate("wxyz")]
    for k, name in enumerate("xyz"):
        data.append(line(path.time_s, 3 * sigma_deg[:, k], name, AXIS_COLORS[k], 2, mode="lines"))
    layout = panels([("quaternion q<sub>NP</sub>",), ("3σ of attitude [deg]",)], TIME_TITLE, shapes=shapes())
    layout["yaxis2"]["rangemode"] = "tozero"
    attitude = figure(
        "attitude",
        "Attitude",
        "Above: the attitude of the principal axes, Hamilton quaternion, scalar first. Below: three standard "
        "deviations of the attitude error about each principal axis. "
        f"{_median_sigma(sigma_deg, 'attitude', 'deg')}{grey}",
        data,
        layout,
        height_px=520,
        wide=False,
    )
    return [centre_of_mass, angular_velocity, attitude]


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


def _median_sigma(sigma: Array, what: str, unit: str) -> str:
    known = np.isfinite(sigma)
    lost = [name for k, name in enumerate("xyz") if not known[:, k].any()]
    if lost:
        return f"The {what} along {', '.join(lost)} is not determined by the data: no band is drawn."
    values = ", ".join(f"{np.median(sigma[known[:, k], k]):.2g}" for k in range(3))
    return f"Median standard deviation of the {what}: {values} {unit} (x, y, z)."
