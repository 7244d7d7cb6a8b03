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
    key_of,
    line,
    panels,
)
from polhode.run_directory.stored_run import StoredRun
from polhode.run_directory.trajectory_file import standard_deviations

DEG = float(np.rad2deg(1.0))


def convergence_figures(content: StoredRun) -> list[Figure]:
    """Mass properties and states against the number of frames; nothing without online.npz."""
    motion, online, inertia = content.motion, content.online, content.summary.inertia
    if online is None or motion is None or inertia is None or len(online.timestamps_ns) < 2:
        return []
    n_frames = len(online.timestamps_ns)
    frames = np.arange(1.0, n_frames + 1.0)
    causal, smooth = standard_deviations(online.covariance), standard_deviations(motion.covariance.covariance)

    k_sigma = np.where(online.determined[:, :2], standard_deviations(online.cov_k), np.inf)
    com_sigma = np.where(online.determined[:, 2:3], standard_deviations(online.cov_com_G), np.inf)
    # the causal centre of mass along the final G
    in_final = np.linalg.inv(motion.X_NG) @ online.X_NG
    com_shift = transform_points(in_final, online.com_G[:, None])[:, 0] - motion.com_G
    axes_shift = log_so3(motion.R_GP.T @ online.R_GP)
    quantities = (
        (("k1",), online.k[:, :1], k_sigma[:, :1], inertia.k1),
        (("k2",), online.k[:, 1:], k_sigma[:, 1:], inertia.k2),
        ("xyz", 1e3 * com_shift, 1e3 * com_sigma, 0.0),
        ("xyz", DEG * axes_shift, DEG * standard_deviations(online.cov_R_GP), 0.0),
    )
    of_mass: list[Trace] = []
    titles = [
        ("k<sub>1</sub>", "k<sub>2</sub>", "com − final [mm]", "axes − final [deg]"),
        ("σ of k<sub>1</sub>", "σ of k<sub>2</sub>", "σ of com [mm]", "σ of axes [deg]"),
    ]
    mass_layout = panels(titles, "frames")
    for panel, (names, value, sigma, final) in enumerate(quantities, start=1):
        of_mass += _history(mass_layout, panel, value, sigma, names, final)
        colors, below = AXIS_COLORS if len(names) == 3 else (INK,), panel + 4
        of_mass += [line(frames, sigma[:, k], name, colors[k], below) for k, name in enumerate(names)]
        mass_layout[key_of("y", below)]["type"] = "log"

    shown = ("position [mm]", 1e3), ("velocity [mm/s]", 1e3), ("attitude [deg]", DEG), ("rate [deg/s]", DEG)
    of_states: list[Trace] = []
    names = [f"σ of {name}" for name, _ in shown]
    state_layout = panels([names[:2], names[2:]], "frames")
    for panel, (_, scale) in enumerate(shown, start=1):
        block = slice(3 * panel - 3, 3 * panel)
        for name, sigma, color in (("causal", causal, AXIS_COLORS[0]), ("smoothed", smooth, INK)):
            of_states.append(line(frames, scale * sigma[:, block].max(axis=1), name, color, panel))
        state_layout[key_of("y", panel)]["type"] = "log"
    state_layout["xaxis"]["range"] = [1, n_frames]
    mass_title = "Inertia, centre of mass and principal axes as the frames came"
    mass_caption = (
        "The causal estimate after each frame, with bands of three standard deviations; dashed: the final "
        "smoothed value. Centre of mass along G, axes as small rotations about x, y, z of P. Below, the "
        "standard deviations. Nothing is drawn while the motion seen so far does "
        f"not determine a quantity. {_describe_determined(online)}"
    )
    state_title = "The state when its frame came, and in the end"
    state_caption = (
        "Standard deviation along the worst axis: of the current state as each frame came, and of the same "
        "state after smoothing over the whole run."
    )
    return [
        Figure(f"convergence-{key}", title, caption, data, layout, height_px, clock="frames")
        for key, title, caption, data, layout, height_px in (
            ("mass", mass_title, mass_caption, of_mass, mass_layout, 520),
            ("states", state_title, state_caption, of_states, state_layout, 480),
        )
    ]


def _history(
    layout: Layout, panel: int, value: Array, sigma: Array, names: Sequence[str], final: float
) -> list[Trace]:
    """Columns of value (F, n) with the bands of sigma (F, n), gaps where that is infinite, and a final value.

    The panel shows what the later half of the determined estimates and their bands fill, and at least eight
    final standard deviations on both sides of the final value.
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
            reach = max(reach, float(filled), 8.0 * float(sigma[late[-1], k]))
    reach = 1.1 * reach or 1.0
    layout[key_of("y", panel)]["range"] = [final - reach, final + reach]
    return data


def _describe_determined(online: OnlineEstimate) -> str:
    """From which frame on each quantity was determined."""
    parts = []
    for name, known in zip(("k1", "k2", "the centre of mass", "the axes"), online.determined.T, strict=True):
        first = int(np.max(np.flatnonzero(~known), initial=-1)) + 2
        parts.append(f"{name} from frame {first} on" if known[-1] else f"{name} never")
    return f"Determined: {', '.join(parts)}."
