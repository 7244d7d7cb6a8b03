"""Figures of the causal estimate: what was known of mass and state as the frames came (thesis 6.7)."""

from collections.abc import Sequence

import numpy as np

from polhode.geometry.lie import Array, log_so3, transform_points
from polhode.records.estimate import OnlineEstimate
from polhode.report.plot_style import (
    AXIS_COLORS,
    INK,
    Figure,
    Layout,
    Trace,
    band,
    dashed,
    line,
    on,
    panels,
)
from polhode.run_directory.stored_run import StoredMotion, StoredRun
from polhode.run_directory.trajectory_file import standard_deviations

DEG = float(np.rad2deg(1.0))
STATES = (
    ("position", 1e3, "mm"),
    ("velocity", 1e3, "mm/s"),
    ("attitude", DEG, "deg"),
    ("rate", DEG, "deg/s"),
)
"""Blocks of the state's covariance: name, scale from SI units, unit."""
MIN_PANEL_SIGMAS = 8.0
"""A panel shows at least this many final standard deviations on both sides of the final value."""


def convergence_figures(content: StoredRun) -> list[Figure]:
    """Mass properties and states against the number of frames; nothing without online.npz."""
    if content.online is None or content.motion is None or len(content.online.timestamps_ns) < 2:
        return []
    motion, online = content.motion, content.online
    return [_mass(content, motion, online), _states(motion, online), _differences(motion, online)]


def _mass(content: StoredRun, motion: StoredMotion, online: OnlineEstimate) -> Figure:
    """Ratios, centre of mass and axes with their bands, above; their standard deviations, below."""
    inertia = content.summary.inertia
    assert inertia is not None
    layout = panels(
        [
            ("k<sub>1</sub>", "k<sub>2</sub>", "com − final [mm]", "axes − final [deg]"),
            ("σ of k<sub>1</sub>", "σ of k<sub>2</sub>", "σ of com [mm]", "σ of axes [deg]"),
        ],
        "frames",
    )
    k_sigma, com_sigma = (
        np.where(determined, standard_deviations(covariance), np.inf)
        for covariance, determined in (
            (online.cov_k, online.determined[:, :2]),
            (online.cov_com_G, online.determined[:, 2:3]),
        )
    )
    turn = log_so3(motion.R_GP.T @ online.R_GP)
    rows = (
        (("k1",), online.k[:, :1], k_sigma[:, :1], inertia.k1),
        (("k2",), online.k[:, 1:], k_sigma[:, 1:], inertia.k2),
        ("xyz", 1e3 * _offset_in_final_G(motion, online), 1e3 * com_sigma, 0.0),
        ("xyz", DEG * turn, DEG * standard_deviations(online.cov_R_GP), 0.0),
    )
    data: list[Trace] = []
    for panel, (names, value, sigma, final) in enumerate(rows, start=1):
        colors = AXIS_COLORS if len(names) == 3 else (INK,)
        data += _history(layout, panel, value, sigma, names, final)
        below, frames = panel + 4, np.arange(1.0, len(value) + 1.0)
        data += [line(frames, sigma[:, k], name, colors[k], below) for k, name in enumerate(names)]
        layout[_y(below)]["type"] = "log"
    return Figure(
        "convergence-mass",
        "Inertia, centre of mass and principal axes as the frames came",
        "The causal estimate after each frame, with bands of three standard deviations; dashed: the final "
        "smoothed value. Centre of mass along G, axes as small rotations about x, y, z of P. Below, the "
        "standard deviations. Nothing is drawn while the motion seen so far does "
        f"not determine a quantity. {_describe_determined(online)}",
        data,
        layout,
        height_px=520,
        clock="frames",
    )


def _states(motion: StoredMotion, online: OnlineEstimate) -> Figure:
    """Standard deviations of the state, worst axis: when its frame came, and after smoothing."""
    causal, smooth = standard_deviations(online.covariance), standard_deviations(motion.covariance.covariance)
    frames = np.arange(1.0, len(causal) + 1.0)
    layout = _state_panels("σ of ", len(causal))
    data = []
    for n, (_, scale, _) in enumerate(STATES):
        for name, sigma, color in (("causal", causal, AXIS_COLORS[0]), ("smoothed", smooth, INK)):
            data.append(line(frames, scale * sigma[:, 3 * n : 3 * n + 3].max(axis=1), name, color, n + 1))
        layout[_y(n + 1)]["type"] = "log"
    return Figure(
        "convergence-states",
        "The state when its frame came, and in the end",
        "Standard deviation along the worst axis: of the current state as each frame came, and of the same "
        "state after smoothing over the whole run.",
        data,
        layout,
        height_px=480,
        clock="frames",
    )


def _differences(motion: StoredMotion, online: OnlineEstimate) -> Figure:
    """The causal state minus the smoothed one of the same frame, with the bands of the causal one."""
    causal, path = standard_deviations(online.covariance), motion.trajectory
    layout = _state_panels("", len(causal))
    differences = (
        online.r_N - path.r_N,
        online.v_N - path.v_N,
        log_so3(np.swapaxes(path.R_NP, 1, 2) @ online.R_NP),
        online.w_P - path.w_P,
    )
    data: list[Trace] = []
    for n, (difference, (_, scale, _)) in enumerate(zip(differences, STATES, strict=True)):
        sigma = scale * causal[:, 3 * n : 3 * n + 3]
        data += _history(layout, n + 1, scale * difference, sigma, "xyz", 0.0)
    return Figure(
        "convergence-differences",
        "The state when its frame came, minus the smoothed one",
        "Components x, y, z, with three standard deviations of the causal estimate: position and velocity "
        "along N, attitude and angular velocity along P.",
        data,
        layout,
        height_px=480,
        clock="frames",
    )


def _state_panels(before: str, n_frames: int) -> Layout:
    titles = [f"{before}{name} [{unit}]" for name, _, unit in STATES]
    layout = panels([titles[:2], titles[2:]], "frames")
    layout["xaxis"]["range"] = [1, n_frames]
    return layout


def _history(
    layout: Layout, panel: int, value: Array, sigma: Array, names: Sequence[str], final: float
) -> list[Trace]:
    """Columns of value (F, n) with the bands of sigma (F, n), gaps where that is infinite, and a final value.

    The panel shows what the later half of the determined estimates and their bands fill.
    """
    frames = np.arange(1.0, len(value) + 1.0)
    data: list[Trace] = []
    reach = 0.0
    for k, name in enumerate(names):
        color = AXIS_COLORS[k] if len(names) == 3 else INK
        known = np.isfinite(sigma[:, k])
        data += [
            *band(frames, value[:, k], 3 * sigma[:, k], color, panel),
            dashed(frames[[0, -1]], [final, final], "final value", panel),
            line(frames, np.where(known, value[:, k], np.nan), name, color, panel),
        ]
        if known.any():
            late = np.flatnonzero(known)[int(known.sum()) // 2 :]
            filled = np.max(np.abs(value[late, k] - final) + 3.0 * sigma[late, k])
            reach = max(reach, float(filled), MIN_PANEL_SIGMAS * float(sigma[late[-1], k]))
    reach = 1.1 * reach or 1.0
    layout[_y(panel)]["range"] = [final - reach, final + reach]
    return data


def _offset_in_final_G(motion: StoredMotion, online: OnlineEstimate) -> Array:
    """Causal minus final centre of mass (F, 3) [m], along the final G."""
    in_final = np.linalg.inv(motion.X_NG) @ online.X_NG
    return transform_points(in_final, online.com_G[:, None])[:, 0] - motion.com_G


def _describe_determined(online: OnlineEstimate) -> str:
    """From which frame on each quantity was determined."""
    parts = []
    for name, known in zip(("k1", "k2", "the centre of mass", "the axes"), online.determined.T, strict=True):
        first = int(np.max(np.flatnonzero(~known), initial=-1)) + 2
        parts.append(f"{name} from frame {first} on" if known[-1] else f"{name} never")
    return f"Determined: {', '.join(parts)}."


def _y(panel: int) -> str:
    return on(panel)["yaxis"].replace("y", "yaxis", 1)
