"""Figures of the causal estimate: what was known of mass and state as the frames came (thesis 6.7)."""

import numpy as np

from pipeline.report.content import Content, Motion
from pipeline.report.plot import AXIS_COLORS, FAINT, INK, Figure, Trace, band, line, panels
from pipeline.trajectory_file import standard_deviations
from polhode.lie import Array, transform_points
from polhode.records import Bools, OnlineEstimate

STATES = (
    ("position", 1e3, "mm"),
    ("velocity", 1e3, "mm/s"),
    ("attitude", 57.29578, "deg"),
    ("rate", 57.29578, "deg/s"),
)
RATIO_COLORS = ("#5b3f8c", "#b8860b")
WIDEST = 8.0
"""A panel shows so many final standard deviations around the final value, or half of what was determined."""


def convergence_figures(content: Content) -> list[Figure]:
    """Mass properties and standard deviations against the number of frames; nothing without online.npz."""
    if content.online is None or content.motion is None or len(content.online.timestamps_ns) < 2:
        return []
    return [_mass(content, content.online), _states(content.motion, content.online)]


def _mass(content: Content, online: OnlineEstimate) -> Figure:
    """Ratios and centre of mass with their bands, above; their standard deviations, below."""
    inertia = content.summary.inertia
    assert inertia is not None and content.motion is not None
    frames = np.arange(1.0, len(online.k) + 1.0)
    figure = panels(
        [
            ("k<sub>1</sub>", "k<sub>2</sub>", "com − final [mm]"),
            ("σ of k<sub>1</sub>", "σ of k<sub>2</sub>", "σ of com [mm]"),
        ],
        "frames",
        showlegend=False,
    )
    data: list[Trace] = []
    final = (inertia.k1, inertia.k2)
    for k in (0, 1):
        sigma = _sigma(online.cov_k[:, k, k], online.determined[:, k])
        data += _history(frames, online.k[:, k], sigma, final[k], RATIO_COLORS[k], f"k{k + 1}", k + 1)
        data.append(line(frames, sigma, f"k{k + 1}", RATIO_COLORS[k], k + 4))
        figure[_y(k + 1)]["range"] = _range(online.k[:, k], sigma, final[k])
    offset_mm, sigmas_mm = 1e3 * _offset_in_final_G(content.motion, online), []
    for axis, name in enumerate("xyz"):
        sigma = 1e3 * _sigma(online.cov_com_G[:, axis, axis], online.determined[:, 2])
        sigmas_mm.append(sigma)
        data += _history(frames, offset_mm[:, axis], sigma, 0.0, AXIS_COLORS[axis], name, 3)
        data.append(line(frames, sigma, name, AXIS_COLORS[axis], 6))
    ranges = [_range(offset_mm[:, axis], sigmas_mm[axis], 0.0) for axis in range(3)]
    figure[_y(3)]["range"] = [min(low for low, _ in ranges), max(high for _, high in ranges)]
    for panel in (4, 5, 6):
        figure[_y(panel)]["type"] = "log"
    return Figure(
        "convergence-mass",
        "Inertia and centre of mass as the frames came",
        "The causal estimate after each frame, with bands of three standard deviations; dashed: the final "
        "smoothed value. Below, the standard deviations. Nothing is drawn while the motion seen so far does "
        f"not determine a quantity. {_first_words(online)}",
        data,
        figure,
        height_px=520,
    )


def _states(motion: Motion, online: OnlineEstimate) -> Figure:
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
            more = {"legendgroup": name, "showlegend": n == 0}
            data.append(line(frames, known, name, color, n + 1, **more))
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
    )


def _history(
    frames: Array, value: Array, sigma: Array, final: float, color: str, name: str, panel: int
) -> list[Trace]:
    known = np.where(np.isfinite(sigma), value, np.nan)
    dashes = {"mode": "lines", "line": {"color": FAINT, "width": 1.2, "dash": "dash"}}
    return [
        *band(frames, value, 3 * sigma, color, panel),
        line(frames[[0, -1]], [final, final], "final", FAINT, panel, **dashes),
        line(frames, known, name, color, panel),
    ]


def _sigma(variance: Array, determined: Bools) -> Array:
    """Standard deviations (F,); infinite where undetermined."""
    known = determined & np.isfinite(variance) & (variance >= 0.0)
    return np.where(known, np.sqrt(np.where(known, variance, 0.0)), np.inf)


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


def _offset_in_final_G(motion: Motion, online: OnlineEstimate) -> Array:
    """Causal minus final centre of mass (F, 3) [m], along the final G: both are held at the first frame."""
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
