"""Figures of the calibration's page, as plain data for plotly.js."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polhode.calibration.adjustment import CornerData, RigState
from polhode.calibration.calibrate import Views, view_rms
from polhode.calibration.epipolar import epipolar_errors
from polhode.calibration.image_pairs import SIDES
from polhode.geometry.lie import Array
from polhode.report.plot_style import (
    ACCENT,
    AXIS_COLORS,
    FAINT,
    Figure,
    Trace,
    axis,
    color_bar,
    layout,
    line,
    on,
    packed,
)
from polhode.runtime.errors import printable

COLORS = (AXIS_COLORS[2], AXIS_COLORS[0])


def page_sections(
    views: Views, state: RigState, data: tuple[CornerData, CornerData], residuals: Sequence[Array]
) -> dict[str, list[Figure]]:
    """The figures of a calibration or a verification, by the titles of their sections."""
    right_px, error = epipolar_errors(state, data)
    sizes = (views.size_px(0), views.size_px(1))
    return {
        "Residuals": [
            *(residual_figure(data[c], residuals[c], sizes[c], c) for c in (0, 1)),
            views_figure(views, residuals, data),
            radial_figure(state, data, residuals),
        ],
        "Epipolar error": [epipolar_figure(right_px, error, sizes[1]), epipolar_histogram(error)],
        "Coverage": [coverage_figure(data[c], sizes[c], c) for c in (0, 1)],
    }


def residual_figure(data: CornerData, residuals: Array, size_px: tuple[int, int], camera: int) -> Figure:
    """Residuals as arrows over the image; the usual one has 0.02 of the image's width."""
    usual = float(np.median(np.linalg.norm(residuals, axis=1)))
    scale = float(f"{0.02 * size_px[0] / max(usual, 1e-6):.1g}")
    gap = np.full(residuals.shape, np.nan)
    path = np.stack([data.uv_px, data.uv_px + scale * residuals, gap], axis=1).reshape(-1, 2)
    color = COLORS[camera]
    arrows = _trace("scattergl", *path.T, mode="lines", line={"color": color, "width": 1.1}, hoverinfo="skip")
    words = [f"{u:+.2f}, {v:+.2f} px" for u, v in residuals.tolist()]
    marker = {"color": color, "size": 3}
    heads = _trace("scattergl", *data.uv_px.T, mode="markers", marker=marker, text=words, hoverinfo="text")
    return _over_image(
        f"residuals-{camera}",
        f"Residuals of the {SIDES[camera]} camera",
        f"Measured minus projected corners of all used images, {scale:g} times enlarged. Arrows of "
        "all directions side by side are noise; arrows that agree with their neighbours are a lens that the "
        "model does not describe, or a board that is not flat.",
        [arrows, heads],
        size_px,
    )


def coverage_figure(data: CornerData, size_px: tuple[int, int], camera: int) -> Figure:
    """How many corners each part of the image has."""
    u, v = (np.linspace(0.0, side, 1 + max(1, round(16 * side / max(size_px)))) for side in size_px)
    count, *_ = np.histogram2d(data.uv_px[:, 0], data.uv_px[:, 1], (u, v))
    heat = _trace(
        "heatmap",
        0.5 * (u[1:] + u[:-1]),
        0.5 * (v[1:] + v[:-1]),
        z=packed(count.T, "i4"),
        colorscale=[[0.0, "#f7f9fb"], [0.15, "#cfe1f2"], [1.0, "#1f5a92"]],
        colorbar=color_bar("corners"),
        zmin=0,
    )
    return _over_image(
        f"coverage-{camera}",
        f"Coverage of the {SIDES[camera]} image",
        f"Corners in each part of the image; {100 * (count == 0).mean():.0f} % of the parts have none. Where "
        "there are none, the distortion is extrapolated.",
        [heat],
        size_px,
    )


def epipolar_figure(right_px: Array, error_px: Array, size_px: tuple[int, int]) -> Figure:
    """Epipolar errors over the right image."""
    rms = float(np.sqrt(np.nanmean(error_px**2)))
    limit = max(3.0 * rms, 1e-3)
    marker = {
        "color": packed(error_px),
        "colorscale": [[0.0, "#0072b2"], [0.5, "#e8ecf0"], [1.0, "#d55e00"]],
        "cmin": -limit,
        "cmax": limit,
        "size": 5,
        "line": {"color": FAINT, "width": 0.3},
        "colorbar": color_bar("px"),
    }
    return _over_image(
        "epipolar-map",
        "Epipolar error over the right image",
        f"Distance of each corner in the right image from the epipolar line of the same corner in the left "
        f"one; {rms:.3f} px rms. Stereo matching looks along these lines.",
        [_trace("scattergl", *right_px.T, mode="markers", marker=marker)],
        size_px,
    )


def epipolar_histogram(error_px: Array) -> Figure:
    """Their distribution."""
    known = error_px[np.isfinite(error_px)]
    limit = max(float(np.percentile(np.abs(known), 99.5)), 1e-3)
    count, edges = np.histogram(known, np.linspace(-limit, limit, 61))
    return Figure(
        "epipolar-histogram",
        "Distribution of the epipolar error",
        "Of the corners that both cameras see. A mean beside 0 would be a rotation or a displacement of the "
        "right camera that the adjustment did not remove.",
        [_trace("bar", 0.5 * (edges[1:] + edges[:-1]), count, marker={"color": ACCENT})],
        layout(xaxis=axis("epipolar error [px]"), yaxis=axis("corners"), bargap=0.05),
        height_px=460,
        wide=False,
    )


def views_figure(views: Views, residuals: Sequence[Array], data: Sequence[CornerData]) -> Figure:
    """Root mean square residual of each image."""
    bars = [
        _trace(
            "bar",
            np.arange(views.count),
            view_rms(residuals[camera], data[camera], views.count),
            name=SIDES[camera],
            marker={"color": COLORS[camera]},
            text=[printable(each or "") for each in views.pairs.names[0]],
            textposition="none",
            hovertemplate="%{text}: %{y:.3f} px",
            showlegend=True,
        )
        for camera in (0, 1)
    ]
    return Figure(
        "views",
        "Residuals by image",
        "Root mean square residual of each image that is used, left and right.",
        bars,
        layout(xaxis=axis("pair"), yaxis=axis("rms [px]", rangemode="tozero"), barmode="group"),
        height_px=320,
    )


def radial_figure(state: RigState, data: Sequence[CornerData], residuals: Sequence[Array]) -> Figure:
    """Radial part of the residuals against the distance from the principal point."""
    traces: list[Trace] = []
    for camera, (each, off) in enumerate(zip(data, residuals, strict=True)):
        from_centre = each.uv_px - state.lenses[camera].values[2:4]
        distance = np.linalg.norm(from_centre, axis=1)
        outward = (from_centre * off).sum(axis=1) / np.maximum(distance, 1e-9)
        marker = {"color": COLORS[camera], "size": 2.5, "opacity": 0.35}
        points = _trace("scattergl", distance, outward, mode="markers", marker=marker, hoverinfo="skip")
        edges = np.quantile(distance, np.linspace(0.0, 1.0, 17))
        place = np.clip(np.searchsorted(edges, distance, "right") - 1, 0, 15)
        mean = [float(outward[place == k].mean()) if (place == k).any() else np.nan for k in range(16)]
        style = {"color": COLORS[camera], "width": 2.5}
        middle = 0.5 * (edges[1:] + edges[:-1])
        traces += [
            points | on(1),
            line(middle, mean, f"{SIDES[camera]}, mean", COLORS[camera], line=style),
        ]
    return Figure(
        "radial",
        "Radial residuals",
        "Outward part of each residual against the distance from the principal point, and its mean. A mean "
        "that waves about 0 calls for a model with more coefficients, or for the fisheye.",
        traces,
        layout(xaxis=axis("distance from the principal point [px]"), yaxis=axis("outward residual [px]")),
        height_px=360,
    )


def _trace(kind: str, x: ArrayLike, y: ArrayLike, **more: Any) -> Trace:
    return {"type": kind, "x": packed(x), "y": packed(y), "showlegend": False, **more}


def _over_image(key: str, title: str, caption: str, traces: list[Trace], size_px: tuple[int, int]) -> Figure:
    width, height = size_px
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
    )
    return Figure(key, title, caption, traces, drawing, height_px=460, wide=False)
