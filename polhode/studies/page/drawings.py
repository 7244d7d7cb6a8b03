"""The drawings of the page: dependence of metrics on axes, shares of points for which something holds."""

import re
from collections.abc import Sequence
from operator import attrgetter
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.lie import Array, Bools
from polhode.report.plot_style import (
    ACCENT,
    FAINT,
    INK,
    Figure,
    Layout,
    Trace,
    axis,
    layout,
    packed,
    translucent,
)
from polhode.studies.page.columns import Axis, Metric
from polhode.studies.page.dependence import Estimate, shares, spreads
from polhode.studies.table import chosen_rows

HEIGHT_PX = 320


def dependence(metric: Metric, along: Axis, key: str) -> Figure:
    """A metric along an axis: points, median with its band, the range of four fifths of the points.

    The caption names the lowest and the highest median, and whether their bands keep apart.
    """
    found = spreads(along, metric.values)
    shown = np.flatnonzero(np.isfinite(metric.values))
    shown = shown[chosen_rows(len(shown), 400)]
    x = along.values[shown]
    if along.labels:
        x = x + np.random.default_rng(0).uniform(-0.18, 0.18, len(shown))
    points = _trace(
        x, metric.values[shown], "points", "markers", marker={"color": translucent(ACCENT, 0.35), "size": 4},
        showlegend=False, hoverinfo="x+y",
    )  # fmt: skip
    middles = [each.median for each in found]
    at, four_fifths = [each.at for each in middles], [(each.tenth, each.nine_tenths) for each in found]
    wide = _strip(along, at, four_fifths, "four fifths of the points", translucent(FAINT, 0.22))
    bands = [(each.low, each.high) for each in middles]
    narrow = _strip(along, at, bands, "its 95 % band", translucent(ACCENT, 0.33))
    caption = "One group of points has this metric."
    if len(middles) > 1:
        low, high = min(middles, key=attrgetter("value")), max(middles, key=attrgetter("value"))
        if low.high < high.low:
            bands_are = "the bands of these two keep apart"
        elif np.isnan(low.high) or np.isnan(high.low):
            bands_are = "some groups have too few points for a band"
        else:
            bands_are = "the bands of these two overlap"
        caption = f"Medians from {low.value:.3g} to {high.value:.3g}; {bands_are}."
    across, labels_px = _axis_along(along)
    drawing = layout(xaxis=across, yaxis=_axis_of(metric, beside=True))
    data = [points, *wide, _middle(along, middles, "median"), *narrow]
    return Figure(key, f"Against {along.name}", caption, data, drawing, HEIGHT_PX + labels_px, wide=False)


def share_drawing(along: Axis, holds: Bools, what: str, key: str) -> Figure:
    """The share of the points for which something holds, along an axis."""
    found = shares(along, holds)
    bands = [(each.low, each.high) for each in found]
    band = _strip(along, [each.at for each in found], bands, "95 % band (Wilson)", translucent(ACCENT, 0.33))
    across, labels_px = _axis_along(along)
    y = axis(what, range=[-0.03, 1.03], tickformat=".0%")
    least = min(found, key=attrgetter("value"))
    place = along.labels[round(least.at)] if along.labels else f"{least.at:.3g}"
    caption = (
        f"Least: {least.value:.0%} at {place} ({least.count} points, band {least.low:.0%} to "
        f"{least.high:.0%})."
    )
    data, drawing = [*band, _middle(along, found, what)], layout(xaxis=across, yaxis=y, showlegend=False)
    return Figure(key, f"Against {along.name}", caption, data, drawing, 270 + labels_px, wide=False)


def _trace(x: ArrayLike, y: ArrayLike, name: str, mode: str = "lines", **more: Any) -> Trace:
    xy = {"x": packed(x, "f8"), "y": packed(y, "f8")}
    return {"type": "scatter", "mode": mode, **xy, "name": name, **more}


def _axis_of(metric: Metric, beside: bool = False) -> Layout:
    """Below a drawing, or beside it, where a long title has two lines."""
    title = metric.title
    ends = [match.end() for match in re.finditer(r"[._ ]", title)]
    if beside and len(title) > 28 and ends:
        at = min(ends, key=lambda end: abs(end - len(title) / 2))
        title = f"{title[:at]}<br>{title[at:]}"
    return axis(title, **(_by_ratio(metric.known) if metric.is_logarithmic else {}))


def _axis_along(along: Axis) -> tuple[Layout, int]:
    """An axis of the study below a drawing, and the height that its labels take beyond a single line [px].

    Few labels stand side by side, broken into lines where their words have room; others are turned by a right
    angle.
    """
    if not along.labels:
        return axis(along.name, **(_by_ratio(along.values) if along.is_logarithmic else {})), 0
    # characters that have room below a drawing, for each label
    room = 52 // len(along.labels)
    longest = max(len(word) for label in along.labels for word in label.split() or [""])
    is_upright = len(along.labels) <= 6 and longest <= room
    lines = [(wrap(label, room) or [""]) if is_upright else [label] for label in along.labels]
    height = 15 * (max(map(len, lines)) - 1) if is_upright else round(6.5 * max(map(len, along.labels)))
    ticks = axis(
        along.name,
        tickvals=list(range(len(lines))),
        ticktext=["<br>".join(each) for each in lines],
        tickangle=0 if is_upright else 90,
        # without this, plotly.js leaves out a label that reaches beyond the drawing
        ticklabeloverflow="allow",
        range=[-0.6, len(lines) - 0.4],
    )
    return ticks, height


def _by_ratio(values: Array) -> Layout:
    """A logarithmic scale over values (n,), with numbers that can be read beside its ticks."""
    ends = np.log10(values.min()), np.log10(values.max())
    steps = (1.0, 2.0, 5.0) if ends[1] - ends[0] < 2.5 else (1.0,)
    decades = range(int(np.floor(ends[0])) - 1, int(np.ceil(ends[1])) + 1)
    ticks = [float(f"{step}e{decade}") for decade in decades for step in steps]
    return {"type": "log", "tickvals": ticks, "ticktext": [f"{each:g}" for each in ticks]}


def _middle(along: Axis, found: Sequence[Estimate], name: str) -> Trace:
    return _trace(
        [each.at for each in found],
        [each.value for each in found],
        name,
        "markers" if along.labels else "lines+markers",
        text=[f"{each.count} points" for each in found],
        hovertemplate="%{y:.4g}, %{text}<extra></extra>",
        line={"color": INK, "width": 1.6},
        marker={"color": INK, "size": 6},
    )


def _strip(
    along: Axis, at: Sequence[float], ends: Sequence[tuple[float, float]], name: str, color: str
) -> list[Trace]:
    """Between two curves where the axis has numbers, bars over its labels; groups without are left out."""
    rows = np.array([(x, *pair) for x, pair in zip(at, ends, strict=True)]).reshape(-1, 3)
    rows = rows[np.isfinite(rows).all(axis=1)]
    if along.labels:
        # bars stand 1 apart
        parts = [row + np.array([[-0.22, 0.0, 0.0], [0.22, 0.0, 0.0]]) for row in rows]
    else:
        parts = [rows] if len(rows) else []
    style: Layout = {"line": {"width": 0}, "fill": "toself", "fillcolor": color, "hoverinfo": "skip"}
    return [
        _trace(np.concatenate([x, x[::-1]]), np.concatenate([low, high[::-1]]), name, **style)
        for x, low, high in (part.T for part in parts)
    ]
