"""Figures of the calibration's page, as plain data for plotly.js."""

from collections.abc import Sequence

import numpy as np

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
DIVERGING = [[0.0, "#0072b2"], [0.5, "#e8ecf0"], [1.0, "#d55e00"]]
COVERAGE = [[0.0, "#f7f9fb"], [0.15, "#cfe1f2"], [1.0, "#1f5a92"]]


def residual_figure(data: CornerData, residuals: Array, size_px: tuple[int, int], camera: int) -> Figure:
    """Residuals as arrows over the image."""
    usual = float(np.median(np.linalg.norm(residuals, axis=1)))
    # the usual residual's arrow has 0.02 of the image's width
    scale = 0.02 * size_px[0] / max(usual, 1e-6)
    scale = float(f"{scale:.1g}")
    ends = data.uv_px + scale * residuals
    gap = np.full((len(ends), 2), np.nan)
    path = np.stack([data.uv_px, ends, gap], axis=1).reshape(-1, 2)
    arrows: Trace = {
        "type": "scattergl",
        "mode": "lines",
        "x": packed(path[:, 0]),
        "y": packed(path[:, 1]),
        "line": {"color": COLORS[camera], "width": 1.1},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    heads: Trace = {
        "type": "scattergl",
        "mode": "markers",
        "x": packed(data.uv_px[:, 0]),
        "y": packed(data.uv_px[:, 1]),
        "marker": {"color": COLORS[camera], "size": 3},
        "text": [f"{u:+.2f}, {v:+.2f} px" for u, v in residuals.tolist()],
        "hoverinfo": "text",
        "showlegend": False,
    }
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
    width, height = size_px
    step = max(size_px) / 16
    columns, rows = max(1, round(width / step)), max(1, round(height / step))
    count, v_edges, u_edges = np.histogram2d(
        data.uv_px[:, 1], data.uv_px[:, 0], (rows, columns), ((0, height), (0, width))
    )
    heat: Trace = {
        "type": "heatmap",
        "x": packed(0.5 * (u_edges[1:] + u_edges[:-1])),
        "y": packed(0.5 * (v_edges[1:] + v_edges[:-1])),
        "z": packed(count, "i4"),
        "colorscale": COVERAGE,
        "colorbar": color_bar("corners"),
        "zmin": 0,
    }
    empty = 100.0 * float((count == 0).mean())
    return _over_image(
        f"coverage-{camera}",
        f"Coverage of the {SIDES[camera]} image",
        f"Corners in each part of the image; {empty:.0f} % of the parts have none. Where there are none, the "
        "distortion is extrapolated.",
        [heat],
        size_px,
    )


def epipolar_figure(right_px: Array, error_px: Array, size_px: tuple[int, int]) -> Figure:
    """Epipolar errors over the right image."""
    rms = float(np.sqrt(np.nanmean(error_px**2)))
    limit = max(3.0 * rms, 1e-3)
    points: Trace = {
        "type": "scattergl",
        "mode": "markers",
        "x": packed(right_px[:, 0]),
        "y": packed(right_px[:, 1]),
        "marker": {
            "color": packed(error_px),
            "colorscale": DIVERGING,
            "cmin": -limit,
            "cmax": limit,
            "size": 5,
            "line": {"color": FAINT, "width": 0.3},
            "colorbar": color_bar("px"),
        },
        "showlegend": False,
    }
    return _over_image(
        "epipolar-map",
        "Epipolar error over the right image",
        f"Distance of each corner in the right image from the epipolar line of the same corner in the left "
        f"one; {rms:.3f} px rms. Stereo matching looks along these lines.",
        [points],
        size_px,
    )


def epipolar_histogram(error_px: Array) -> Figure:
    """Their distribution."""
    known = error_px[np.isfinite(error_px)]
    limit = max(float(np.percentile(np.abs(known), 99.5)), 1e-3)
    count, edges = np.histogram(known, np.linspace(-limit, limit, 61))
    bars: Trace = {
        "type": "bar",
        "x": packed(0.5 * (edges[1:] + edges[:-1])),
        "y": packed(count, "i4"),
        "marker": {"color": ACCENT},
        "showlegend": False,
    }
    return Figure(
        "epipolar-histogram",
        "Distribution of the epipolar error",
        "Of the corners that both cameras see. A mean beside 0 would be a rotation or a displacement of the "
        "right camera that the adjustment did not remove.",
        [bars],
        layout(xaxis=axis("epipolar error [px]"), yaxis=axis("corners"), bargap=0.05),
        height_px=460,
        wide=False,
    )


def views_figure(
    residuals: Sequence[Array], data: Sequence[CornerData], names: Sequence[str], count: int
) -> Figure:
    """Root mean square residual of each image."""
    bars: list[Trace] = []
    numbers = np.arange(count)
    for camera in (0, 1):
        rms = view_rms(residuals[camera], data[camera], count)
        bars.append(
            {
                "type": "bar",
                "x": packed(numbers, "i4"),
                "y": packed(rms),
                "name": SIDES[camera],
                "marker": {"color": COLORS[camera]},
                "text": list(names),
                "textposition": "none",
                "hovertemplate": "%{text}: %{y:.3f} px",
            }
        )
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
        traces.append(
            {
                "type": "scattergl",
                "mode": "markers",
                "x": packed(distance),
                "y": packed(outward),
                "marker": {"color": COLORS[camera], "size": 2.5, "opacity": 0.35},
                "showlegend": False,
                "hoverinfo": "skip",
                **on(1),
            }
        )
        edges = np.quantile(distance, np.linspace(0.0, 1.0, 17))
        place = np.clip(np.searchsorted(edges, distance, "right") - 1, 0, 15)
        mean = [float(outward[place == k].mean()) if (place == k).any() else np.nan for k in range(16)]
        middle = 0.5 * (edges[1:] + edges[:-1])
        traces.append(
            line(
                middle,
                mean,
                f"{SIDES[camera]}, mean",
                COLORS[camera],
                line={"color": COLORS[camera], "width": 2.5},
            )
        )
    return Figure(
        "radial",
        "Radial residuals",
        "Outward part of each residual against the distance from the principal point, and its mean. A mean "
        "that waves about 0 calls for a model with more coefficients, or for the fisheye.",
        traces,
        layout(xaxis=axis("distance from the principal point [px]"), yaxis=axis("outward residual [px]")),
        height_px=360,
    )


def _over_image(key: str, title: str, caption: str, traces: list[Trace], size_px: tuple[int, int]) -> Figure:
    width, height = size_px
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
    )
    return Figure(key, title, caption, traces, drawing, height_px=460, wide=False)


def page_sections(
    views: Views, state: RigState, data: tuple[CornerData, CornerData], residuals: Sequence[Array]
) -> dict[str, list[Figure]]:
    """The figures of a calibration or a verification, by the titles of their sections."""
    right_px, error = epipolar_errors(state, data)
    sizes = (views.size_px(0), views.size_px(1))
    names = [printable(each or "") for each in views.pairs.names[0]]
    return {
        "Residuals": [
            *(residual_figure(data[c], residuals[c], sizes[c], c) for c in (0, 1)),
            views_figure(residuals, data, names, views.count),
            radial_figure(state, data, residuals),
        ],
        "Epipolar error": [epipolar_figure(right_px, error, sizes[1]), epipolar_histogram(error)],
        "Coverage": [coverage_figure(data[c], sizes[c], c) for c in (0, 1)],
    }
