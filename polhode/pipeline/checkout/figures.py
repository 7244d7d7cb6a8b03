"""Figures of checkout.html, as plain data for plotly.js; and one pair with lines along its rows."""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.frontend.features.epipolar_search import RowOffsets
from polhode.frontend.rectification import Image, RectifiedPair
from polhode.geometry.camera import RectifiedRig
from polhode.pipeline.checkout.check_table import limit_of
from polhode.pipeline.checkout.checkout import Checkout, Findings
from polhode.pipeline.checkout.exposure import frame_gains
from polhode.pipeline.checkout.rig_tilt import REGIONS, RowFit, design, regions
from polhode.pipeline.checkout.target_range import ranges_m
from polhode.pipeline.checkout.timing import Stamps
from polhode.report.plot_style import (
    ACCENT,
    AXIS_COLORS,
    FAINT,
    INK,
    TIME_TITLE,
    Figure,
    Layout,
    Trace,
    axis,
    color_bar,
    dashed,
    layout,
    line,
    note,
    on,
    packed,
    panels,
)

DIVERGING = [[0.0, "#0072b2"], [0.5, "#e8ecf0"], [1.0, "#d55e00"]]
LEVEL_PX = 3.0 * limit_of("rows")
"""Rows of a match that differ by more are drawn in another colour."""
LEFT, RIGHT = AXIS_COLORS[2], AXIS_COLORS[0]


def checkout_figures(done: Checkout) -> list[tuple[str, list[Figure]]]:
    """(title of the section, its figures)"""
    sections: list[tuple[str, list[Figure]]] = []
    found = done.findings
    if found is not None:
        if (rows := found.rows) is not None:
            both = [_map(rows, found.rig), _slopes(rows, found.rig)]
            sections.append(("Rows of left and right image", both))
        sections.append(("Range and motion", [*_ranges(found), *_motion(found)]))
        sections.append(("Images", [_images(found)]))
    return [*sections, *([("Times", [_times(done.stamps)])] if len(done.stamps.left) >= 2 else [])]


def _map(fit: RowFit, rig: RectifiedRig) -> Figure:
    offset_px, uv_px = fit.offset_px[fit.good], fit.uv_px[fit.good]
    limit = max(limit_of("rows"), float(np.percentile(np.abs(offset_px), 98.0)))
    median, count = regions(fit, rig, fit.offset_px)
    marker: Layout = {"color": packed(offset_px), "colorscale": DIVERGING, "cmin": -limit, "cmax": limit}
    marker |= {"size": 5, "line": {"color": FAINT, "width": 0.3}, "colorbar": color_bar("px")}
    points: Trace = {"type": "scatter", "mode": "markers", "x": packed(uv_px[:, 0]), "y": packed(uv_px[:, 1])}
    points |= {"marker": marker, "showlegend": False, **on(1)}
    width, height = rig.width_px, rig.height_px
    style: Layout = {"xref": "x", "yref": "y", "bgcolor": "rgba(255,255,255,0.75)"}
    style |= {"font": {"size": 12, "color": INK}}
    words = [
        note(
            f"<b>{median[row, column]:+.2f}</b> ({count[row, column]})",
            (column + 0.5) * width / REGIONS,
            (row + 0.5) * height / REGIONS,
            **style,
        )
        for row, column in np.argwhere(count)
    ]
    grid: list[Layout] = []
    for k in range(1, REGIONS):
        u, v = k * width / REGIONS, k * height / REGIONS
        for x0, x1, y0, y1 in ((u, u, 0, height), (0, width, v, v)):
            ends = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}
            grid.append({"type": "line", **ends, "line": {"color": "#c3ccd4", "width": 1}})
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
        annotations=words,
        shapes=grid,
    )
    caption = (
        "Row in the left minus row in the right image, of matches of all examined pairs, in the rectified "
        "left image; in each part of the image the median [px] and the number of matches. A rig that is as "
        "calibrated shows grey everywhere."
    )
    title = "Vertical disparity over the image"
    return Figure("rows-map", title, caption, [points], drawing, height_px=460, wide=False)


def _slopes(fit: RowFit, rig: RectifiedRig) -> Figure:
    """The offsets along u and along v, with the fit's part that depends on it."""
    uv, offset_px, d = fit.uv_px[fit.good], fit.offset_px[fit.good], fit.disparity_px[fit.good]
    drawing = panels([("row offset [px]",), ("row offset [px]",)], "", showlegend=False)
    drawing["xaxis"] = axis("u in the right image [px]", domain=[0, 1], anchor="y")
    drawing["xaxis2"] = axis("v [px]", domain=[0, 1], anchor="y2")
    drawing["yaxis"] |= {"domain": [0.60, 1.0]}
    drawing["yaxis2"] |= {"domain": [0.0, 0.40]}
    data: list[Trace] = []
    style = {"color": FAINT, "size": 3, "opacity": 0.6}
    for panel, x in ((1, uv[:, 0] - d), (2, uv[:, 1])):
        data.append(line(x, offset_px, "matches", FAINT, panel, mode="markers", marker=style))
        # the fit at the middle of the other coordinate
        at, middle_d = np.linspace(x.min(), x.max(), 50), np.full(50, float(np.median(d)))
        point = np.tile(np.median(uv, axis=0), (50, 1))
        point[:, panel - 1] = at + middle_d if panel == 1 else at
        fitted = design(rig, point, middle_d)[:, :3] @ fit.tilt
        data.append(line(at, fitted, "fit", RIGHT, panel, mode="lines", line={"color": RIGHT, "width": 2}))
    caption = (
        "Upper: along the rows. An offset of all is a pitch of the right camera (or a vertical displacement "
        "of it), a slope its roll. Lower: down the image; a slope is a difference of the focal lengths. A "
        "yaw would move neither."
    )
    title = "Pitch is an offset, roll a slope"
    return Figure("rows-slopes", title, caption, data, drawing, height_px=460, wide=False)


def _ranges(found: Findings) -> list[Figure]:
    z, rig = ranges_m(found.sample), found.rig
    if len(z) == 0:
        return []
    low, high = np.percentile(z, [0.5, 99.5])
    count, edges = np.histogram(z, np.linspace(low, max(high, low + 1e-6), 50))
    middle = 0.5 * (edges[1:] + edges[:-1])
    drawing = layout(xaxis=axis("range [m]"), yaxis=axis("features", rangemode="tozero"))
    bars: Trace = {"type": "bar", "x": packed(middle), "y": packed(count, "i4"), "marker": {"color": ACCENT}}
    data, words = [bars | {"name": "features", **on(1)}], ""
    if not found.sequence.has_ranges:
        words = ", and how much depth a pixel of disparity is there"
        title = "depth per pixel of disparity [mm]"
        drawing["yaxis2"] = axis(title, overlaying="y", side="right", showgrid=False)
        per_px = 1e3 * middle**2 / (rig.focal_px * rig.baseline_m)
        data.append(line(middle, per_px, "depth per pixel", RIGHT, mode="lines") | {"yaxis": "y2"})
    caption = f"Depth of the features of all examined {found.sample.noun}{words}."
    return [Figure("ranges", "Range of the features", caption, data, drawing, height_px=360, wide=False)]


def _motion(found: Findings) -> list[Figure]:
    turns = found.turns
    if len(turns.time_s) == 0:
        return []
    drawing = panels([("turn [deg]",), ("matches",)], TIME_TITLE, showlegend=False)
    for each in ("yaxis", "yaxis2"):
        drawing[each] |= {"rangemode": "tozero"}
    data = [
        line(turns.time_s, turns.turn_deg, "turn", ACCENT),
        dashed(turns.time_s[[0, -1]], 2 * [limit_of("rotation")], "limit"),
        line(turns.time_s, turns.matches, "matches", ACCENT, 2),
    ]
    caption = "As the camera sees it, and the matches that agree with it; a gap: the two frames do not match."
    title = "Turn between successive frames"
    return [Figure("turns", title, caption, data, drawing, height_px=360, wide=False)]


def _images(found: Findings) -> Figure:
    sample, sequence = found.sample, found.sequence
    t = (sequence.timestamps_ns - sequence.timestamps_ns[0]) * 1e-9
    time_s = t[[pair.frame for pair in sample.pairs]]
    rows = [
        ("brightest [levels]", "saturated [%]"),
        ("width of edges [px]", "noise [levels]"),
        ("brightness, later / earlier", "border not dark [%]"),
    ]
    drawing, data = panels(rows, TIME_TITLE), list[Trace]()
    two = all(pair.right is not None for pair in sample.pairs)
    for side, (name, color) in enumerate((("left", LEFT), ("right", RIGHT)) if two else (("camera", LEFT),)):
        images = [pair.images[side] for pair in sample.pairs]
        values: dict[int, list[float]] = {
            1: [image.bright_level for image in images],
            2: [100.0 * image.saturated for image in images],
            3: [image.edge_px for image in images],
            4: [image.noise for image in images],
            6: [100.0 * image.border_bright for image in images],
        }
        for panel, y in values.items():
            drawing["yaxis" if panel == 1 else f"yaxis{panel}"] |= {"rangemode": "tozero"}
            data.append(line(time_s, y, name, color, panel, legendgroup=name, showlegend=panel == 1))
    gains = [np.nan if gain is None else gain for gain in frame_gains(sample)]
    data.append(line(found.turns.time_s, gains, "same points", ACCENT, 5, showlegend=False))
    caption = (
        "Of the target in each examined image as recorded; the ratio of brightness is that of the same "
        "points in two successive frames."
    )
    return Figure("images", "Exposure, sharpness, noise, surroundings", caption, data, drawing, height_px=560)


def _times(stamps: Stamps) -> Figure:
    time_s = (stamps.left - stamps.left[0]) * 1e-9
    rows = [("interval [s]",), (f"{stamps.second} minus {stamps.first} [us]",)]
    drawing = panels(rows, TIME_TITLE, showlegend=False)
    drawing["yaxis"] |= {"rangemode": "tozero"}
    differences_us = stamps.differences_ns() * 1e-3
    data = [
        line(time_s[1:], np.diff(stamps.left) * 1e-9, "interval", ACCENT),
        line(time_s[stamps.pairing.left], differences_us, "difference", ACCENT, 2, mode="markers"),
    ]
    title = f"Intervals, and stamps of the {stamps.second} against the {stamps.first}"
    caption = (
        f"By data.csv of the {stamps.first}; below, the difference of the stamps of each pair. A constant "
        "one is taken for an offset of the clocks."
    )
    return Figure("times", title, caption, data, drawing, height_px=360)


def draw_pair(pair: RectifiedPair, rows: RowOffsets) -> NDArray[np.uint8]:
    """Left and right image side by side (H, 2 W, 3) as rectified: guides along the rows, matches joined.

    As the astronauts' second screen (thesis figure 5-25): the lines must be as level as the guides. Or the
    image beside its range image: near is bright, black is not measured.
    """

    def grey(image: Image) -> NDArray[np.uint8]:
        bright = image.astype(np.float64) * (235.0 / max(float(np.percentile(image, 99.7)), 16.0))
        return np.repeat(np.clip(bright, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=2)

    if pair.measured is not None:
        d = pair.measured.disparity_px
        known = np.isfinite(d)
        low, high = np.percentile(d[known], [1.0, 99.0]) if known.any() else (0.0, 1.0)
        level = np.clip((np.where(known, d, low) - low) / max(high - low, 1e-6), 0.0, 1.0)
        colours = cv2.applyColorMap((255.0 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
        return np.hstack([grey(pair.left), np.where(known[..., None], colours, 0).astype(np.uint8)])
    picture, (height, width) = np.hstack([grey(pair.left), grey(pair.right)]), pair.left.shape
    for row in np.linspace(0, height, 9 + 2)[1:-1].astype(int).tolist():
        cv2.line(picture, (0, row), (2 * width, row), (0, 158, 115), 1)
    order = np.argsort(rows.uv_px[:, 1], kind="stable")
    some = order[np.unique(np.linspace(0, len(order) - 1, 40).astype(int))] if len(order) else order
    for k in some.tolist():
        u, v = rows.uv_px[k]
        ends = np.array([[u, v], [u - rows.disparity_px[k] + width, v - rows.offset_px[k]]])
        a, b = np.round(16 * ends).astype(int).tolist()
        color = (86, 180, 233) if abs(rows.offset_px[k]) <= LEVEL_PX else (213, 94, 0)
        cv2.line(picture, a, b, color, 1, cv2.LINE_AA, shift=4)
        for end in (a, b):
            cv2.circle(picture, end, 3 * 16, color, 1, cv2.LINE_AA, shift=4)
    return np.asarray(picture, dtype=np.uint8)
