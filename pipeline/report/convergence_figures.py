"""Figures of the causal estimate: what was known of mass and state as the frames came (thesis 6.7)."""

import numpy as np

from polhode.lie import Array, log_so3, transform_points
from polhode.pipeline.report.plot_style import (
    AXIS_COLORS,
    INK,
    Figure,
    Layout,
    Trace,
    band,
    dashed,
    line,
    panels,
)
from polhode.pipeline.run_directory.stored_run import StoredMotion, StoredRun
from polhode.pipeline.run_directory.trajectory_file import standard_deviations
from polhode.records import Bools, OnlineEstimate

DEG = float(np.rad2deg(1.0))
STATES = (
    ("position", 1e3, "mm"),
    ("velocity", 1e3, "mm/s"),
    ("attitude", DEG, "deg"),
    ("rate", DEG, "deg/s"),
)
RATIO_COLORS = (INK, INK)
WIDEST = 8.0
"""A panel shows so many final standard deviations around the final value, or half of what was determined."""


def convergence_figures(content: StoredRun) -> list[Figure]:
    """Mass properties and states against the number of frames; nothing without online.npz."""
    if content.online is None or content.motion is None or len(content.online.timestamps_ns) < 2:
        return []
    motion, online = content.motion, content.online
    return [_mass(content, online), _states(motion, online), _differences(motion, online)]


def _mass(content: StoredRun, online: OnlineEstimate) -> Figure:
    """Ratios, centre of mass and axes with their bands, above; their standard deviations, below."""
    inertia = content.summary.inertia
    assert inertia is not None and content.motion is not None
    frames = np.arange(1.0, len(online.k) + 1.0)
    figure = panels(
        [
            ("k<sub>1</sub>", "k<sub>2</sub>", "com − final [mm]", "axes − final [deg]"),
            ("σ of k<sub>1</sub>", "σ of k<sub>2</sub>", "σ of com [mm]", "σ of axes [deg]"),
        ],
        "frames",
    )
    data: list[Trace] = []
    final = (inertia.k1, inertia.k2)
    ratio_sigma = _known_sigma(online.cov_k, online.determined[:, :2])
    for k in (0, 1):
        sigma = ratio_sigma[:, k]
        data += _history(frames, online.k[:, k], sigma, final[k], RATIO_COLORS[k], f"k{k + 1}", k + 1)
        data.append(line(frames, sigma, f"k{k + 1}", RATIO_COLORS[k], k + 5))
        figure[_y(k + 1)]["range"] = _range(online.k[:, k], sigma, final[k])
    com_sigma = _known_sigma(online.cov_com_G, online.determined[:, 2:3])
    offset = _offset_in_final_G(content.motion, online)
    data += _vector_history(frames, 1e3 * offset, 1e3 * com_sigma, (3, 7), figure)
    turn = log_so3(content.motion.R_GP.T @ online.R_GP)
    axes_sigma = standard_deviations(online.cov_R_GP)
    data += _vector_history(frames, DEG * turn, DEG * axes_sigma, (4, 8), figure)
    for panel in (5, 6, 7, 8):
        figure[_y(panel)]["type"] = "log"
    return Figure(
        "convergence-mass",
        "Inertia, centre of mass and principal axes as the frames came",
        "The causal estimate after each frame, with bands of three standard deviations; dashed: the final "
        "smoothed value. Centre of mass along G, axes as small rotations about x, y, z of P. Below, the "
        "standard deviations. Nothing is drawn while the motion seen so far does "
        f"not determine a quantity. {_first_words(online)}",
        data,
        figure,
        height_px=520,
        clock="frames",
    )


def _vector_history(
    frames: Array, difference: Array, sigma: Array, panel: tuple[int, int], figure: Layout
) -> list[Trace]:
    """Differences (F, 3) from the final value with their bands, and their sigmas (F, 3), in two panels."""
    data: list[Trace] = []
    for axis, name in enumerate("xyz"):
        data += _history(frames, difference[:, axis], sigma[:, axis], 0.0, AXIS_COLORS[axis], name, panel[0])
        data.append(line(frames, sigma[:, axis], name, AXIS_COLORS[axis], panel[1]))
    figure[_y(panel[0])]["range"] = _common_range(difference, sigma)
    return data


def _states(motion: StoredMotion, online: OnlineEstimate) -> Figure:
    """Standard deviations of the state, worst axis: when its frame came, and after smoothing."""
    causal, smooth = standard_deviations(online.covariance), standard_deviations(motion.covariance.covariance)
    frames = np.arange(1.0, len(causal) + 1.0)
    titles = [f"σ of {name} [{unit}]" for name, _, unit in STATES]
    figure = panels([titles[:2], titles[2:]], "frames")
    data = []
    for n, (_, scale, _) in enumerate(STATES):
        for name, sigma, color in (("causal", causal, AXIS_COLORS[0]), ("smoothed", smooth, INK)):
            worst = scale * sigma[:, 3 * n : 3 * n + 3].max(axis=1)
            known = np.where(np.isfinite(worst), worst, np.nan)
            data.append(line(frames, known, name, color, n + 1))
        figure[_y(n + 1)]["type"] = "log"
    figure["xaxis"]["range"] = [1, int(frames[-1])]
    return Figure(
        "convergence-states",
        "The state when its frame came, and in the end",
        "Standard deviation along the worst axis: of the current state as each frame came, and of the same "
        "state after smoothing over the whole run.",
        data,
        figure,
        height_px=480,
        clock="frames",
    )


def _differences(motion: StoredMotion, online: OnlineEstimate) -> Figure:
    """The causal state minus the smoothed one of the same frame, with the bands of the causal one."""
    causal, path = standard_deviations(online.covariance), motion.trajectory
    frames = np.arange(1.0, len(causal) + 1.0)
    titles = [f"{name} [{unit}]" for name, _, unit in STATES]
    figure = panels([titles[:2], titles[2:]], "frames")
    differences = (
        online.r_N - path.r_N,
        online.v_N - path.v_N,
        log_so3(np.swapaxes(path.R_NP, 1, 2) @ online.R_NP),
        online.w_P - path.w_P,
    )
    data: list[Trace] = []
    for n, (difference, (_, scale, _)) in enumerate(zip(differences, STATES, strict=True)):
        sigma, values = scale * causal[:, 3 * n : 3 * n + 3], scale * difference
        for axis, name in enumerate("xyz"):
            data += _history(frames, values[:, axis], sigma[:, axis], 0.0, AXIS_COLORS[axis], name, n + 1)
        figure[_y(n + 1)]["range"] = _common_range(values, sigma)
    figure["xaxis"]["range"] = [1, int(frames[-1])]
    return Figure(
        "convergence-differences",
        "The state when its frame came, minus the smoothed one",
        "Components x, y, z, with three standard deviations of the causal estimate: position and velocity "
        "along N, attitude and angular velocity along P.",
        data,
        figure,
        height_px=480,
        clock="frames",
    )


def _history(
    frames: Array, value: Array, sigma: Array, final: float, color: str, name: str, panel: int
) -> list[Trace]:
    known = np.where(np.isfinite(sigma), value, np.nan)
    return [
        *band(frames, value, 3 * sigma, color, panel),
        dashed(frames[[0, -1]], [final, final], "final value", panel),
        line(frames, known, name, color, panel),
    ]


def _known_sigma(covariance: Array, determined: Bools) -> Array:
    """Standard deviations (F, n) of covariances (F, n, n); infinite where undetermined."""
    return np.where(determined, standard_deviations(covariance), np.inf)


def _range(value: Array, sigma: Array, final: float) -> list[float]:
    """Of a panel: what the later half of the determined estimates and their bands fill."""
    known = np.flatnonzero(np.isfinite(sigma))
    if len(known) == 0:
        return [final - 1.0, final + 1.0]
    late = known[len(known) // 2 :]
    reach = max(
        float(np.max(np.abs(value[late] - final) + 3.0 * sigma[late])), WIDEST * float(sigma[known[-1]])
    )
    return [final - 1.1 * reach, final + 1.1 * reach]


def _common_range(values: Array, sigma: Array) -> list[float]:
    """Of a panel with three components (F, 3) about 0."""
    ranges = [_range(values[:, axis], sigma[:, axis], 0.0) for axis in range(3)]
    return [min(low for low, _ in ranges), max(high for _, high in ranges)]


def _offset_in_final_G(motion: StoredMotion, online: OnlineEstimate) -> Array:
    """Causal minus final centre of mass (F, 3) [m], along the final G."""
    X_NG = motion.X_NG
    # where the causal centre of mass lies in the final G, frame by frame
    in_final = np.linalg.inv(X_NG) @ online.X_NG
    return transform_points(in_final, online.com_G[:, None])[:, 0] - motion.com_G


def _first_words(online: OnlineEstimate) -> str:
    """From which frame on each quantity was determined."""
    parts = []
    for name, known in zip(("k1", "k2", "the centre of mass", "the axes"), online.determined.T, strict=True):
        if not known[-1]:
            parts.append(f"{name} never")
        else:
            lost = np.flatnonzero(~known)
            parts.append(f"{name} from frame {int(lost[-1]) + 2 if len(lost) else 1} on")
    return f"Determined: {', '.join(parts)}."


def _y(panel: int) -> str:
    return "yaxis" if panel == 1 else f"yaxis{panel}"
