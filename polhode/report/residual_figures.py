"""Figures of the measurements: residuals against their noise, per frame, and who was seen when."""

from functools import partial

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
INLIER_WEIGHT = 0.5
"""A measurement with less weight in the robust kernel counts as an outlier here."""

_figure = partial(Figure, height_px=380, wide=False)


def measurement_figures(content: StoredRun) -> list[Figure]:
    """Residuals (histogram, history), observations per frame, landmarks over time: those that exist."""
    tracks, residuals = content.tracks, content.residuals
    if tracks is None or len(tracks.frame) == 0:
        return []
    figures = []
    if residuals is not None and len(residuals.residuals_px) == len(tracks.frame):
        noise = content.summary.noise
        stated, larger = "", ""
        if noise is not None:
            stated = (
                f" ({noise.pixel_sigma_px:.3f} px of u and v, "
                f"{noise.disparity_sigma_px:.3f} px of the disparity)"
            )
            larger = (
                f" They are smaller than the noise{stated}, which is corrected for what the fit follows and "
                "counts larger residuals too."
            )
        caption = (
            "Root mean square of the residuals as they are, of the inliers only. A frame that stands out "
            f"points at light, blur or a wrong association.{larger}"
        )
        rms = rms_per_frame(tracks, residuals)
        data = [line(tracks.time_s, rms[:, k], name, AXIS_COLORS[k]) for k, name in enumerate(NAMES)]
        y = axis("residual, root mean square [px]", rangemode="tozero")
        rms_layout = layout(xaxis=axis(TIME_TITLE), yaxis=y)
        figures = [
            _histogram(content, tracks, residuals, stated),
            _figure("residual-rms", "Residuals per frame", caption, data, rms_layout, clock="time"),
        ]
    return [*figures, _observations(tracks), _landmarks_over_time(tracks)]


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


def _histogram(
    content: StoredRun, tracks: StereoTracks, residuals: MeasurementResiduals, stated: str
) -> Figure:
    normalised = residuals.residuals_px / sigma_found(tracks, content.summary.noise)
    edges = np.linspace(-5, 5, 1 + int(np.clip(np.sqrt(len(normalised)), 20, 80)))
    centres, width = 0.5 * (edges[1:] + edges[:-1]), edges[1] - edges[0]
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
    caption = (
        f"Measured minus predicted, over the noise that the estimate found{stated}; dotted: a Gaussian of "
        f"that noise.{counted} "
        f"{100 * outliers:.1f} % of the measurements have less than half their weight in the robust kernel; "
        f"{100 * beyond:.1f} % lie outside the drawing."
    )
    x = axis("residual / standard deviation of the noise", range=[-5, 5])
    drawing = layout(xaxis=x, yaxis=axis("density", rangemode="tozero"))
    return _figure("residual-histogram", "Residuals against their noise", caption, data, drawing)


def _observations(tracks: StereoTracks) -> Figure:
    count = np.bincount(tracks.frame, minlength=tracks.n_frames)
    length = np.bincount(tracks.landmark, minlength=tracks.n_landmarks)
    lengths = np.bincount(length)[1:]
    drawing = panels([("landmarks seen",)], TIME_TITLE)
    drawing["xaxis"] |= {"domain": [0, 0.52]}
    drawing["xaxis2"] = axis("observations of a landmark", domain=[0.69, 1], anchor="y2")
    drawing["yaxis2"] = axis("landmarks", anchor="x2")
    spacing_s = float(np.median(np.diff(tracks.time_s))) if tracks.n_frames > 1 else 1.0
    per_frame = {"name": "per frame", "x": tracks.time_s, "y": count, "width": 0.8 * spacing_s}
    by_number = {"name": "by number of observations", "x": np.arange(1, len(lengths) + 1), "y": lengths}
    data: list[Trace] = [
        {"type": "bar", "marker": {"color": ACCENT}, **per_frame, **on(1)},
        {"type": "bar", "marker": {"color": FAINT}, **by_number, **on(2)},
    ]
    unseen = int(np.sum(count == 0))
    bridged = f"; {unseen} without any, bridged by the dynamics" if unseen else ""
    caption = (
        f"Left: measurements per frame (median {np.median(count):.0f}{bridged}). Right: how often each of "
        f"the {tracks.n_landmarks} landmarks was seen (median {np.median(length):.0f})."
    )
    return _figure("observations", "Observations", caption, data, drawing, clock="time")


def _landmarks_over_time(tracks: StereoTracks) -> Figure:
    first = np.full(tracks.n_landmarks, tracks.n_frames)
    np.minimum.at(first, tracks.landmark, tracks.frame)
    rank = np.argsort(np.argsort(first, kind="stable"))
    rows = min(tracks.n_landmarks, 600)
    seen = np.zeros((rows, tracks.n_frames), dtype=np.uint8)
    seen[rank[tracks.landmark] * rows // tracks.n_landmarks, tracks.frame] = 1
    y = axis("landmarks, by first observation", showgrid=False, autorange="reversed")
    drawing = layout(xaxis=axis(TIME_TITLE, showgrid=False), yaxis=y)
    marks = {"x": tracks.time_s, "y": (np.arange(rows) + 0.5) * tracks.n_landmarks / rows, "z": seen}
    style = {"colorscale": [[0, PAPER], [1, ACCENT]], "showscale": False, "hoverinfo": "skip"}
    # A heat map has no entry of its own in a legend: that of a trace without points.
    entry = {"name": "seen in this frame", "marker": {"symbol": "square", "color": ACCENT}}
    data: list[Trace] = [
        {"type": "heatmap", **marks, **style, **on(1)},
        {"type": "scatter", "mode": "markers", "x": [None], "y": [None], **entry, **on(1)},
    ]
    caption = (
        "Each row is a landmark (or a few), each dark cell a frame that saw it. Rows that go dark again "
        "after a gap are landmarks recognised when the body had turned around: this loop closure is what "
        "fixes the inertia."
    )
    return _figure("landmarks-over-time", "Landmarks over time", caption, data, drawing, clock="time")
