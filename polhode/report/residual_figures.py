"""Figures of the measurements: residuals against their noise, per frame, and who was seen when."""

import numpy as np

from polhode.geometry.lie import Array
from polhode.records.tracks import StereoTracks
from polhode.report.plot_style import (
    ACCENT,
    AXIS_COLORS,
    FAINT,
    INK,
    PAPER,
    TIME_TITLE,
    Figure,
    Trace,
    axis,
    layout,
    line,
    on,
    panels,
)
from polhode.run_directory.archives import MeasurementResiduals
from polhode.run_directory.stored_run import StoredRun
from polhode.run_directory.summary_schema import Noise

NAMES = ("u", "v", "disparity")
ONE_SIGMA = 0.6827
"""Share of a Gaussian within one standard deviation"""
CORE_TOLERANCE = 0.05
INLIER_WEIGHT = 0.5
"""A measurement with less weight in the robust kernel counts as an outlier here."""


def measurement_figures(content: StoredRun) -> list[Figure]:
    """Residuals (histogram, history), observations per frame, landmarks over time: those that exist."""
    if content.tracks is None or len(content.tracks.frame) == 0:
        return []
    figures = []
    if content.residuals is not None and len(content.residuals.residuals_px) == len(content.tracks.frame):
        figures = [
            _histogram(content, content.tracks, content.residuals),
            _rms_per_frame(content.tracks, content.residuals, content.summary.noise),
        ]
    return [*figures, _observations(content.tracks), _landmarks_over_time(content.tracks)]


def rms_per_frame(tracks: StereoTracks, residuals: MeasurementResiduals) -> Array:
    """Root mean square of the inliers' residuals (F, 3) [px]; NaN for a frame without inliers."""
    inlier = residuals.inlier_weight >= INLIER_WEIGHT
    frame, squared = tracks.frame[inlier], residuals.residuals_px[inlier] ** 2
    count = np.bincount(frame, minlength=tracks.n_frames).astype(np.float64)
    sums = [np.bincount(frame, weights=squared[:, k], minlength=tracks.n_frames) for k in range(3)]
    with np.errstate(invalid="ignore"):
        return np.sqrt(np.stack(sums, axis=1) / np.where(count > 0, count, np.nan)[:, None])


def sigma_found(tracks: StereoTracks, noise: Noise | None) -> Array:
    """Standard deviations (M, 3) [px] that the estimate used: those stated, times what it found of the noise.

    Their medians are the noise of u, v and of the disparity in the tables.
    """
    if noise is None or len(tracks.sigma_px) == 0:
        return tracks.sigma_px
    u, v, disparity = np.median(tracks.sigma_px, axis=0)
    uv = noise.pixel_sigma_px / (0.5 * (u + v))
    return np.asarray(tracks.sigma_px * [uv, uv, noise.disparity_sigma_px / disparity])


def _histogram(content: StoredRun, tracks: StereoTracks, residuals: MeasurementResiduals) -> Figure:
    noise = content.summary.noise
    normalised = residuals.residuals_px / sigma_found(tracks, noise)
    edges = np.linspace(-5, 5, 1 + int(np.clip(np.sqrt(len(normalised)), 20, 80)))
    centres, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
    figure = layout(
        xaxis=axis("residual / standard deviation of the noise", range=[-5, 5]),
        yaxis=axis("density", rangemode="tozero"),
    )
    data: list[Trace] = []
    for k, name in enumerate(NAMES):
        density = np.histogram(normalised[:, k], edges)[0] / (len(normalised) * width)
        style = {"color": AXIS_COLORS[k], "width": 1.6, "shape": "hvh"}
        data.append(line(centres, density, name, AXIS_COLORS[k], mode="lines", line=style))
    gauss = np.exp(-0.5 * centres**2) / np.sqrt(2 * np.pi)
    style = {"color": INK, "width": 1.5, "dash": "dot"}
    data.append(line(centres, gauss, "Gaussian", INK, mode="lines", line=style))
    beyond = float(np.mean(np.any(np.abs(normalised) > 5, axis=1)))
    outliers = float(np.mean(residuals.inlier_weight < INLIER_WEIGHT))
    solver = content.summary.solver
    chi2 = solver.reduced_chi2 if solver else None
    counted = "" if chi2 is None else f" Reduced chi-squared, which counts the unknowns, is {chi2:.3g}."
    levels = f" ({_describe(noise)})" if noise else ""
    core = _core(normalised[residuals.inlier_weight > 0.0], tracks)
    return Figure(
        "residual-histogram",
        "Residuals against their noise",
        f"Measured minus predicted, over the noise that the estimate found{levels}; dotted: a "
        f"Gaussian of that noise. {core}{counted} {100 * outliers:.1f} % of the "
        " measurements have less than half their weight in the robust kernel; "
        f"{100 * beyond:.1f} % lie outside the drawing.",
        data,
        figure,
        height_px=380,
        wide=False,
    )


def _describe(noise: Noise) -> str:
    return f"{noise.pixel_sigma_px:.3f} px of u and v, {noise.disparity_sigma_px:.3f} px of the disparity"


def _core(kept: Array, tracks: StereoTracks) -> str:
    """In words: how wide the middle of the normalised residuals (K, 3) is, and why it may be narrower."""
    if len(kept) == 0:
        return ""
    width, tails = float(np.quantile(np.abs(kept), ONE_SIGMA)), float(np.mean(np.abs(kept) > 3.0))
    words = f"68 % of the residuals lie within {width:.2f} of it"
    if width > 1.0 + CORE_TOLERANCE:
        return f"{words}, more than the noise explains: heavy tails, or a noise that varies."
    if width >= 1.0 - CORE_TOLERANCE:
        return f"{words}, as they should."
    unknowns = 3 * len(np.unique(tracks.landmark)) + 6 * len(np.unique(tracks.frame))
    return (
        f"{words}: the middle is narrower than the Gaussian. A residual is smaller than the error behind it, "
        f"because the fit follows part of the errors (some {unknowns} unknowns of landmarks and poses from "
        f"{3 * len(tracks.frame)} measured numbers); the noise is that of the errors, and it counts the "
        f"tails too ({100 * tails:.1f} % beyond three, 0.3 % of a Gaussian)."
    )


def _rms_per_frame(tracks: StereoTracks, residuals: MeasurementResiduals, noise: Noise | None) -> Figure:
    rms = rms_per_frame(tracks, residuals)
    figure = layout(
        xaxis=axis(TIME_TITLE),
        yaxis=axis("residual, root mean square [px]", rangemode="tozero"),
    )
    data = [line(tracks.time_s, rms[:, k], name, AXIS_COLORS[k]) for k, name in enumerate(NAMES)]
    larger = (
        f" They are smaller than the noise ({_describe(noise)}), which is corrected for what the fit follows "
        "and counts larger residuals too."
        if noise
        else ""
    )
    return Figure(
        "residual-rms",
        "Residuals per frame",
        "Root mean square of the residuals as they are, of the inliers only. A frame that stands out points "
        f"at light, blur or a wrong association.{larger}",
        data,
        figure,
        height_px=380,
        wide=False,
        clock="time",
    )


def _observations(tracks: StereoTracks) -> Figure:
    count = np.bincount(tracks.frame, minlength=tracks.n_frames)
    length = np.bincount(tracks.landmark, minlength=tracks.n_landmarks)
    lengths = np.bincount(length)[1:]
    figure = panels([("landmarks seen",)], TIME_TITLE)
    figure["xaxis"] |= {"domain": [0, 0.52]}
    figure["xaxis2"] = axis("observations of a landmark", domain=[0.69, 1], anchor="y2")
    figure["yaxis2"] = axis("landmarks", anchor="x2")
    spacing_s = float(np.median(np.diff(tracks.time_s))) if tracks.n_frames > 1 else 1.0
    per_frame = {"name": "per frame", "x": tracks.time_s, "y": count, "width": 0.8 * spacing_s}
    by_number = {"name": "by number of observations", "x": np.arange(1, len(lengths) + 1), "y": lengths}
    data: list[Trace] = [
        {"type": "bar", "marker": {"color": ACCENT}, **per_frame, **on(1)},
        {"type": "bar", "marker": {"color": FAINT}, **by_number, **on(2)},
    ]
    unseen = int(np.sum(count == 0))
    return Figure(
        "observations",
        "Observations",
        f"Left: measurements per frame (median {np.median(count):.0f}"
        + (f"; {unseen} without any, bridged by the dynamics" if unseen else "")
        + f"). Right: how often each of the {tracks.n_landmarks} landmarks was seen (median "
        f"{np.median(length):.0f}).",
        data,
        figure,
        height_px=380,
        wide=False,
        clock="time",
    )


def _landmarks_over_time(tracks: StereoTracks) -> Figure:
    first = np.full(tracks.n_landmarks, tracks.n_frames)
    np.minimum.at(first, tracks.landmark, tracks.frame)
    rank = np.empty(tracks.n_landmarks, dtype=np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(tracks.n_landmarks)
    rows = min(tracks.n_landmarks, 600)
    seen = np.zeros((rows, tracks.n_frames), dtype=np.uint8)
    seen[rank[tracks.landmark] * rows // tracks.n_landmarks, tracks.frame] = 1
    figure = layout(
        xaxis=axis(TIME_TITLE, showgrid=False),
        yaxis=axis("landmarks, by first observation", showgrid=False, autorange="reversed"),
    )
    marks = {"x": tracks.time_s, "y": (np.arange(rows) + 0.5) * tracks.n_landmarks / rows, "z": seen}
    style = {"colorscale": [[0, PAPER], [1, ACCENT]], "showscale": False, "hoverinfo": "skip"}
    # A heat map has no entry of its own in a legend: that of a trace without points.
    entry = {"name": "seen in this frame", "marker": {"symbol": "square", "color": ACCENT}}
    data: list[Trace] = [
        {"type": "heatmap", **marks, **style, **on(1)},
        {"type": "scatter", "mode": "markers", "x": [None], "y": [None], **entry, **on(1)},
    ]
    return Figure(
        "landmarks-over-time",
        "Landmarks over time",
        "Each row is a landmark (or a few), each dark cell a frame that saw it. Rows that go dark again "
        "after a gap are landmarks recognised when the body had turned around: this loop closure is what "
        "fixes the inertia.",
        data,
        figure,
        height_px=380,
        wide=False,
        clock="time",
    )
