"""The drawings of the page: distributions, dependence on axes, shares that hold, trade-offs, consistency."""

import re
from collections.abc import Sequence
from operator import attrgetter
from textwrap import wrap
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.metrics import COVERAGE, COVERAGE_CONSTANTS, NEES
from polhode.report.plot_style import (
    ACCENT,
    EDGE,
    FAINT,
    INK,
    SECOND,
    Figure,
    Layout,
    Trace,
    axis,
    layout,
    packed,
    translucent,
)
from polhode.studies.page.columns import Axis, Metric
from polhode.studies.page.consistency import Consistency
from polhode.studies.page.dependence import Estimate, shares, spreads
from polhode.studies.table import chosen_rows

HEIGHT_PX = 320
QUANTITIES = {"com": "centre of mass", "axes": "principal axes", "angular_velocity": "angular velocity"}
"""Names of quantities with a NEES, where the key is no word"""
_CONSISTENCY = {
    NEES: (
        "NEES",
        "Right of the expected range: the standard deviations are too small. Left of it: too large. In "
        "brackets the number of runs.",
    ),
    COVERAGE: (
        "Coverage of the states",
        "Of position, velocity, attitude and angular velocity in all frames of a run. Left of the expected "
        "range: the standard deviations are too small.",
    ),
    COVERAGE_CONSTANTS: (
        "Coverage of the constants",
        "Of inertia, centre of mass and principal axes. Left of the expected range: the standard deviations "
        "are too small.",
    ),
}
"""Title and caption of the drawing of each group"""


def distribution(metric: Metric, key: str) -> Figure:
    """A histogram, with the median."""
    known = metric.known
    values = np.log10(known) if metric.is_logarithmic else known
    counts, edges = np.histogram(values, bins=int(np.clip(2.0 * len(known) ** 0.5, 5, 40)))
    edges = 10.0**edges if metric.is_logarithmic else edges
    low, middle, high = np.quantile(known, [0.1, 0.5, 0.9])
    data = [
        _trace(
            np.repeat(edges, 2), np.concatenate([[0], np.repeat(counts, 2), [0]]), "points",
            line={"color": ACCENT, "width": 1.4}, fill="toself", fillcolor=translucent(ACCENT, 0.22),
            hoverinfo="x+y",
        ),
        _trace(
            [middle, middle], [0, counts.max()], f"median {middle:.3g}",
            line={"color": SECOND, "width": 1.6, "dash": "dash"},
        ),
    ]  # fmt: skip
    caption = f"{len(known)} points; four fifths of them lie between {low:.3g} and {high:.3g}."
    drawing = layout(xaxis=_axis_of(metric), yaxis=axis("points", rangemode="tozero"))
    return Figure(key, "Distribution", caption, data, drawing, HEIGHT_PX, wide=False)


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


def trade_off(first: Metric, second: Metric, words: Sequence[str], key: str) -> Figure | None:
    """Two metrics of each point, and the front: points that no other one is better than in both.

    ``words``: of each point, shown where the pointer rests. None: no point has both.
    """
    both = np.flatnonzero(np.isfinite(first.values) & np.isfinite(second.values))
    if len(both) < 2:
        return None
    front = both[
        front_of(*(-m.values[both] if m.more_is_better else m.values[both] for m in (first, second)))
    ]
    ways = [f"{'more' if each.more_is_better else 'less'} {each.title}" for each in (first, second)]
    caption = (
        f"{len(both)} points, {len(front)} of them on the front: no other point has {ways[0]} than one of "
        f"these, and {ways[1]} at the same time."
    )

    def points(rows: Ints, name: str, color: str, size: int, mode: str = "markers", **more: Any) -> Trace:
        hover = {"hovertemplate": "%{text}<br>%{x:.4g}, %{y:.4g}<extra></extra>"} | more
        hover |= {"text": [words[row] for row in rows], "marker": {"color": color, "size": size}}
        return _trace(first.values[rows], second.values[rows], name, mode, **hover)

    # the front has all of its points
    shown, line = both[chosen_rows(len(both), 1000)], {"color": SECOND, "width": 1.4, "dash": "dot"}
    data = [
        points(shown, "points", translucent(ACCENT, 0.4), 5),
        points(front, "Pareto front", SECOND, 7, "lines+markers", line=line),
    ]
    drawing = layout(xaxis=_axis_of(first), yaxis=_axis_of(second, beside=True))
    title = f"{second.title} against {first.title}"
    return Figure(key, title, caption, data, drawing, 360, wide=False)


def front_of(first: Array, second: Array) -> Ints:
    """Indices of the points that no other one is below in both (n,), by ascending ``first``; of equal points
    the first one."""
    order = np.lexsort((second, first))
    best = np.minimum.accumulate(second[order])
    is_new = np.concatenate([[True], second[order][1:] < best[:-1]])
    return np.asarray(order[is_new])


def consistency_drawing(found: Sequence[Consistency], group: str, key: str) -> Figure:
    """Of each quantity the mean with its band, beside where it is expected."""
    scale = np.array([each.expected if group == NEES else 1.0 for each in found])
    value, low, high, expected_low, expected_high = (
        np.array([getattr(each, name) for each in found]) / scale
        for name in ("mean", "low", "high", "expected_low", "expected_high")
    )
    place = np.arange(len(found), dtype=np.float64)[::-1]
    expected = [
        _trace(
            ends, [at, at], "expected, if the standard deviations are right", hoverinfo="x",
            line={"color": EDGE, "width": 11},
        )
        for *ends, at in zip(expected_low, expected_high, place, strict=True)
    ]  # fmt: skip
    known = np.isfinite(low) & np.isfinite(high)
    bars = {
        "type": "data",
        "symmetric": False,
        "array": packed(np.where(known, high - value, 0.0), "f8"),
        "arrayminus": packed(np.where(known, value - low, 0.0), "f8"),
        "color": ACCENT,
        "thickness": 2.0,
        "width": 0,
    }
    marker = {"color": ACCENT, "size": 8}
    name = "mean over the runs, with its 95 % band"
    means = _trace(value, place, name, "markers", error_x=bars, marker=marker)
    names = [f"{QUANTITIES.get(each.name, each.name)} ({each.runs})" for each in found]
    ticks = {"tickvals": place.tolist(), "ticktext": names, "range": [-0.6, len(found) - 0.4]}
    if group == NEES:
        ends = np.concatenate([value, low, high, [1.0]])
        ratios = _by_ratio(ends[np.isfinite(ends) & (ends > 0.0)])
        across = axis("mean NEES over its number of components", **ratios)
    else:
        across = axis("share within three standard deviations", tickformat=".1%")
    at = 1.0 if group == NEES else found[0].expected
    line = {"color": FAINT, "width": 1, "dash": "dot"}
    upright = {"type": "line", "x0": at, "x1": at, "y0": 0, "y1": 1, "yref": "paper", "line": line}
    drawing = layout(xaxis=across, yaxis=axis("", **ticks), shapes=[upright])
    height = 120 + 34 * len(found)
    return Figure(key, *_CONSISTENCY[group], [*expected, means], drawing, height, wide=False)


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
