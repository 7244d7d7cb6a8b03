"""Figures of checkout.html, as plain data for plotly.js; and one pair with lines along its rows."""

import cv2
import numpy as np
from numpy.typing import NDArray

from polhode.camera import RectifiedRig
from polhode.frontend.features.row_offsets import RowOffsets
from polhode.frontend.rectification import Image, MeasuredDisparity, RectifiedPair
from polhode.lie import Array
from polhode.pipeline.checkout.checkout import Checkout, Findings
from polhode.pipeline.checkout.exposure import frame_gains
from polhode.pipeline.checkout.rig_tilt import MAX_ROW_PX, REGIONS, RowFit, design, regions
from polhode.pipeline.checkout.target_motion import MAX_TURN_DEG
from polhode.pipeline.checkout.target_range import ranges_m
from polhode.pipeline.checkout.timing import Stamps
from polhode.pipeline.report.plot_style import (
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
GUIDES = 9
"""Lines along the rows over the height of the pair."""
LEVEL_PX = 3.0 * MAX_ROW_PX
"""Rows of a match that differ by more are drawn in another colour."""
MAX_SHOWN = 40
"""Matches that are drawn."""
GREEN, BLUE, RED = (0, 158, 115), (86, 180, 233), (213, 94, 0)
LEFT, RIGHT = AXIS_COLORS[2], AXIS_COLORS[0]


def checkout_figures(done: Checkout) -> list[tuple[str, list[Figure]]]:
    """(title of the section, its figures)"""
    sections: list[tuple[str, list[Figure]]] = []
    found = done.findings
    if found is not None:
        if found.rows is not None:
            sections.append(("Rows of left and right image", row_figures(found.rows, found.rig)))
        sections.append(("Range and motion", [*_ranges(found), *_motion(found)]))
        sections.append(("Images", [_images(found)]))
    times = _times(done.stamps)
    return [*sections, *([("Times", times)] if times else [])]


def row_figures(fit: RowFit, rig: RectifiedRig) -> list[Figure]:
    """Vertical disparity over the image, and along columns and rows."""
    return [_map(fit, rig), _slopes(fit, rig)]


def _map(fit: RowFit, rig: RectifiedRig) -> Figure:
    good, limit = fit.good, max(MAX_ROW_PX, float(np.percentile(np.abs(fit.offset_px[fit.good]), 98.0)))
    median, count = regions(fit, rig, fit.offset_px)
    marker = {
        "color": packed(fit.offset_px[good]),
        "colorscale": DIVERGING,
        "cmin": -limit,
        "cmax": limit,
        "size": 5,
        "line": {"color": FAINT, "width": 0.3},
        "colorbar": color_bar("px"),
    }
    points: Trace = {
        "type": "scatter",
        "mode": "markers",
        "x": packed(fit.uv_px[good, 0]),
        "y": packed(fit.uv_px[good, 1]),
        "marker": marker,
        "showlegend": False,
        **on(1),
    }
    width, height = rig.width_px, rig.height_px
    words = [
        note(
            f"<b>{median[row, column]:+.2f}</b> ({count[row, column]})",
            (column + 0.5) * width / REGIONS,
            (row + 0.5) * height / REGIONS,
            xref="x",
            yref="y",
            bgcolor="rgba(255,255,255,0.75)",
            font={"size": 12, "color": INK},
        )
        for row in range(REGIONS)
        for column in range(REGIONS)
        if count[row, column]
    ]
    grid: list[Layout] = [
        {"type": "line", "x0": x0, "x1": x1, "y0": y0, "y1": y1, "line": {"color": "#c3ccd4", "width": 1}}
        for k in range(1, REGIONS)
        for x0, x1, y0, y1 in (
            (k * width / REGIONS, k * width / REGIONS, 0, height),
            (0, width, k * height / REGIONS, k * height / REGIONS),
        )
    ]
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
        annotations=words,
        shapes=grid,
    )
    return Figure(
        "rows-map",
        "Vertical disparity over the image",
        "Row in the left minus row in the right image, of matches of all examined pairs, in the rectified "
        "left "
        "image; in each part of the image the median [px] and the number of matches. A rig that is as "
        "calibrated "
        "shows grey everywhere.",
        [points],
        drawing,
        height_px=460,
        wide=False,
    )


def _slopes(fit: RowFit, rig: RectifiedRig) -> Figure:
    """The offsets along u and along v, with the fit's part that depends on it."""
    good = fit.good
    drawing = panels([("row offset [px]",), ("row offset [px]",)], "")
    drawing["xaxis"] = axis("u in the right image [px]", domain=[0, 1], anchor="y")
    drawing["xaxis2"] = axis("v [px]", domain=[0, 1], anchor="y2")
    drawing["yaxis"] |= {"domain": [0.60, 1.0]}
    drawing["yaxis2"] |= {"domain": [0.0, 0.40]}
    drawing["showlegend"] = False
    u_right = fit.uv_px[good, 0] - fit.disparity_px[good]
    data: list[Trace] = []
    style = {"color": FAINT, "size": 3, "opacity": 0.6}
    for panel, x in ((1, u_right), (2, fit.uv_px[good, 1])):
        data.append(line(x, fit.offset_px[good], "matches", FAINT, panel, mode="markers", marker=style))
        # the fit at the middle of the other coordinate
        at = np.linspace(x.min(), x.max(), 50)
        uv = np.tile(np.median(fit.uv_px[good], axis=0), (50, 1))
        d = np.full(50, float(np.median(fit.disparity_px[good])))
        if panel == 1:
            uv[:, 0] = at + d
        else:
            uv[:, 1] = at
        fitted = design(rig, uv, d)[:, :3] @ np.array([fit.pitch_rad, fit.roll_rad, fit.stretch])
        data.append(line(at, fitted, "fit", RIGHT, panel, mode="lines", line={"color": RIGHT, "width": 2}))
    return Figure(
        "rows-slopes",
        "Pitch is an offset, roll a slope",
        "Upper: along the rows. An offset of all is a pitch of the right camera (or a vertical "
        "displacement of it), "
        "a slope its roll. Lower: down the image; a slope is a difference of the focal lengths. A yaw "
        "would move "
        "neither.",
        data,
        drawing,
        height_px=460,
        wide=False,
    )


def _ranges(found: Findings) -> list[Figure]:
    z, rig = ranges_m(found.sample), found.rig
    if len(z) == 0:
        return []
    low, high = np.percentile(z, [0.5, 99.5])
    edges = np.linspace(low, max(high, low + 1e-6), 50)
    count = np.histogram(z, edges)[0]
    middle = 0.5 * (edges[1:] + edges[:-1])
    per_px = 1e3 * middle**2 / (rig.focal_px * rig.baseline_m)
    drawing = layout(
        xaxis=axis("range [m]"),
        yaxis=axis("features", rangemode="tozero"),
        yaxis2=axis("depth per pixel of disparity [mm]", overlaying="y", side="right", showgrid=False),
    )
    bars: Trace = {
        "type": "bar",
        "x": packed(middle),
        "y": packed(count, "i4"),
        "marker": {"color": ACCENT},
        "name": "features",
        **on(1),
    }
    curve = line(middle, per_px, "depth per pixel", RIGHT, mode="lines") | {"yaxis": "y2"}
    has_ranges = found.sequence.has_ranges
    words = f"Depth of the features of all examined {found.sample.noun}"
    if has_ranges:
        del drawing["yaxis2"]
    return [
        Figure(
            "ranges",
            "Range of the features",
            f"{words}." if has_ranges else f"{words}, and how much depth a pixel of disparity is there.",
            [bars] if has_ranges else [bars, curve],
            drawing,
            height_px=360,
            wide=False,
        )
    ]


def _motion(found: Findings) -> list[Figure]:
    turns = found.turns
    if len(turns.time_s) == 0:
        return []
    drawing = panels([("turn [deg]",), ("matches",)], TIME_TITLE, showlegend=False)
    drawing["yaxis"] |= {"rangemode": "tozero"}
    drawing["yaxis2"] |= {"rangemode": "tozero"}
    ends = turns.time_s[[0, -1]]
    data = [
        line(turns.time_s, turns.turn_deg, "turn", ACCENT),
        dashed(ends, [MAX_TURN_DEG, MAX_TURN_DEG], "limit"),
        line(turns.time_s, turns.matches, "matches", ACCENT, 2),
    ]
    return [
        Figure(
            "turns",
            "Turn between successive frames",
            "As the camera sees it, and the matches that agree with it; a gap: the two frames do not match.",
            data,
            drawing,
            height_px=360,
            wide=False,
        )
    ]


def _images(found: Findings) -> Figure:
    sample, sequence = found.sample, found.sequence
    t = (sequence.timestamps_ns - sequence.timestamps_ns[0]) * 1e-9
    time_s = t[[pair.frame for pair in sample.pairs]]
    drawing = panels(
        [
            ("brightest [levels]", "saturated [%]"),
            ("width of edges [px]", "noise [levels]"),
            ("brightness, later / earlier", "border not dark [%]"),
        ],
        TIME_TITLE,
    )
    data: list[Trace] = []
    two = all(pair.right is not None for pair in sample.pairs)
    for side, (name, color) in enumerate((("left", LEFT), ("right", RIGHT)) if two else (("camera", LEFT),)):
        images = [pair.images[side] for pair in sample.pairs]
        values: list[tuple[int, list[float]]] = [
            (1, [image.bright_level for image in images]),
            (2, [100.0 * image.saturated for image in images]),
            (3, [image.edge_px for image in images]),
            (4, [image.noise for image in images]),
            (6, [100.0 * image.border_bright for image in images]),
        ]
        data += [
            line(time_s, y, name, color, panel, legendgroup=name, showlegend=panel == 1)
            for panel, y in values
        ]
    gains = [np.nan if gain is None else gain for gain in frame_gains(sample)]
    data.append(line(found.turns.time_s, gains, "same points", ACCENT, 5, showlegend=False))
    for panel in (1, 2, 3, 4, 6):
        suffix = "" if panel == 1 else str(panel)
        drawing[f"yaxis{suffix}"] |= {"rangemode": "tozero"}
    return Figure(
        "images",
        "Exposure, sharpness, noise, surroundings",
        "Of the target in each examined image as recorded; the ratio of brightness is that of the same "
        "points in "
        "two successive frames.",
        data,
        drawing,
        height_px=560,
    )


def _times(stamps: Stamps) -> list[Figure]:
    if len(stamps.left) < 2:
        return []
    dt = np.diff(stamps.left) * 1e-9
    time_s = (stamps.left[1:] - stamps.left[0]) * 1e-9
    pairs_s = (stamps.left[stamps.pairing.left] - stamps.left[0]) * 1e-9
    drawing = panels(
        [("interval [s]",), (f"{stamps.second} minus {stamps.first} [us]",)], TIME_TITLE, showlegend=False
    )
    drawing["yaxis"] |= {"rangemode": "tozero"}
    data = [
        line(time_s, dt, "interval", ACCENT),
        line(pairs_s, stamps.differences_ns() * 1e-3, "difference", ACCENT, 2, mode="markers"),
    ]
    return [
        Figure(
            "times",
            f"Intervals, and stamps of the {stamps.second} against the {stamps.first}",
            f"By data.csv of the {stamps.first}; below, the difference of the stamps of each pair. A "
            "constant one is taken for an offset of the clocks.",
            data,
            drawing,
            height_px=360,
        )
    ]


def draw_pair(pair: RectifiedPair, rows: RowOffsets) -> NDArray[np.uint8]:
    """Left and right image side by side (H, 2 W, 3) as rectified: guides along the rows, matches joined.

    As the astronauts' second screen (thesis figure 5-25): the lines must be as level as the guides.
    """
    if pair.measured is not None:
        return _with_ranges(pair.left, pair.measured)
    both = np.hstack([_stretched(pair.left), _stretched(pair.right)])
    picture = np.repeat(both[..., None], 3, axis=2)
    height, width = pair.left.shape
    for row in np.linspace(0, height, GUIDES + 2)[1:-1].astype(int).tolist():
        cv2.line(picture, (0, row), (2 * width, row), GREEN, 1)
    order = np.argsort(rows.uv_px[:, 1], kind="stable")
    some = order[np.unique(np.linspace(0, len(order) - 1, MAX_SHOWN).astype(int))] if len(order) else order
    for k in some.tolist():
        u, v = rows.uv_px[k]
        ends = np.array([[u, v], [u - rows.disparity_px[k] + width, v - rows.offset_px[k]]])
        a, b = np.round(16 * ends).astype(int).tolist()
        color = BLUE if abs(rows.offset_px[k]) <= LEVEL_PX else RED
        cv2.line(picture, a, b, color, 1, cv2.LINE_AA, shift=4)
        for end in (a, b):
            cv2.circle(picture, end, 3 * 16, color, 1, cv2.LINE_AA, shift=4)
    return np.asarray(picture, dtype=np.uint8)


def _with_ranges(left: Image, measured: MeasuredDisparity) -> NDArray[np.uint8]:
    """The image beside its range image (H, 2 W, 3): near is bright, black is not measured."""
    d = measured.disparity_px
    known = np.isfinite(d)
    low, high = np.percentile(d[known], [1.0, 99.0]) if known.any() else (0.0, 1.0)
    level = np.clip((np.where(known, d, low) - low) / max(high - low, 1e-6), 0.0, 1.0)
    colours = cv2.applyColorMap((255.0 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    grey = np.repeat(_stretched(left)[..., None], 3, axis=2)
    return np.hstack([grey, np.where(known[..., None], colours, 0).astype(np.uint8)])


def _stretched(image: Image) -> Image:
    high = max(float(np.percentile(image, 99.7)), 16.0)
    bright: Array = np.clip(image.astype(np.float64) * (235.0 / high), 0.0, 255.0)
    return np.asarray(bright, dtype=np.uint8)
