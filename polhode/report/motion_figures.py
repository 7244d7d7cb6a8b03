"""Figures of the motion: centre of mass, attitude, angular velocity."""

from functools import partial

import numpy as np

from polhode.geometry.lie import Array
from polhode.report.plot_style import (
    AXIS_COLORS,
    INK,
    TIME_TITLE,
    Figure,
    Layout,
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
    path, seen = content.motion.trajectory, np.ones(len(content.motion.trajectory.time_s), dtype=bool)
    if content.tracks is not None:
        seen = np.isin(np.arange(content.tracks.n_frames), content.tracks.frame)
    time_s, shapes = path.time_s, partial(gap_shapes, path.time_s, seen)
    grey = " Grey: frames without measurements, bridged by the dynamics." if shapes() else ""
    off_line_mm = 1e3 * straight_line_residual(time_s, path.r_N, path.sigma_r)
    r_mm, v_mm_s = 1e3 * path.sigma_r, 1e3 * path.sigma_v
    w_deg_s, sigma_w, sigma_deg = map(np.rad2deg, (path.w_P, path.sigma_w, path.sigma_theta))

    columns = ((path.r_N, path.sigma_r), (off_line_mm, r_mm), (1e3 * path.v_N, v_mm_s))
    of_com, of_rate, of_attitude = [], [], []
    for k, (name, color) in enumerate(zip("xyz", AXIS_COLORS, strict=True)):
        for column, (value, sigma) in enumerate(columns, start=1):
            of_com += line_with_band(time_s, value[:, k], sigma[:, k], name, color, 3 * k + column)
        of_rate += line_with_band(time_s, w_deg_s[:, k], sigma_w[:, k], name, color, k + 1)
        of_attitude.append(line(time_s, 3 * sigma_deg[:, k], name, color, 2, mode="lines"))
    quaternion = zip(path.q_NP_wxyz.T, "wxyz", (INK, *AXIS_COLORS), strict=True)
    of_attitude = [*(line(time_s, q, name, color) for q, name, color in quaternion), *of_attitude]

    titles = [(f"r<sub>{a}</sub> [m]", f"Δr<sub>{a}</sub> [mm]", f"v<sub>{a}</sub> [mm/s]") for a in "xyz"]
    above = ("position in N", "position minus a straight line", "velocity in N")
    com_layout = panels(titles, TIME_TITLE, above, shapes=shapes(columns=3))
    rate_layout = panels([(f"ω<sub>{a}</sub> [deg/s]",) for a in "xyz"], TIME_TITLE, shapes=shapes())
    rows = [("quaternion q<sub>NP</sub>",), ("3σ of attitude [deg]",)]
    attitude_layout = panels(rows, TIME_TITLE, shapes=shapes())
    attitude_layout["yaxis2"]["rangemode"] = "tozero"
    com_caption = (
        "Position and velocity in the inertial frame N, with bands of three standard deviations. The "
        "middle column takes away the straight line at constant speed that fits best: what is left shows "
        "disturbances and errors at the scale of the bands. "
        f"{_median_sigma(r_mm, 'position', 'mm')} {_median_sigma(v_mm_s, 'velocity', 'mm/s')}{grey}"
    )
    rate_caption = (
        "Of the target relative to N, along its principal axes x, y, z (largest, middle and smallest "
        "moment), with bands of three standard deviations. "
        f"{_median_sigma(sigma_w, 'angular velocity', 'deg/s')}{grey}"
    )
    attitude_caption = (
        "Above: the attitude of the principal axes, Hamilton quaternion, scalar first. Below: three standard "
        "deviations of the attitude error about each principal axis. "
        f"{_median_sigma(sigma_deg, 'attitude', 'deg')}{grey}"
    )
    figure = partial(Figure, clock="time")
    narrow: Layout = {"height_px": 520, "wide": False}
    return [
        figure("centre-of-mass", "Centre of mass", com_caption, of_com, com_layout, height_px=560),
        figure("angular-velocity", "Angular velocity", rate_caption, of_rate, rate_layout, **narrow),
        figure("attitude", "Attitude", attitude_caption, of_attitude, attitude_layout, **narrow),
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


def _median_sigma(sigma: Array, what: str, unit: str) -> str:
    known = np.isfinite(sigma)
    lost = [name for name, some in zip("xyz", known.T, strict=True) if not some.any()]
    if lost:
        return f"The {what} along {', '.join(lost)} is not determined by the data: no band is drawn."
    values = ", ".join(f"{np.median(sigma[known[:, k], k]):.2g}" for k in range(3))
    return f"Median standard deviation of the {what}: {values} {unit} (x, y, z)."
