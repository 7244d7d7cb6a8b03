"""The drawings of the page: distributions, dependence on axes, shares that hold, trade-offs, consistency."""

import re
from collections.abc import Sequence
from operator import attrgetter
from textwrap import wrap
from typing import Any

import numpy as np

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
from polhode.studies.page.dependence import Estimate, Spread, shares, spreads
from polhode.studies.table import chosen_rows

HEIGHT_PX = 320
HALF_BAR = 0.22
"""Half the width of a bar over a label; over one, they are 1 apart"""
MAX_UPRIGHT = 6
"""Labels that can stand side by side, broken into lines; more are turned by a right angle"""
CHARACTERS_ACROSS = 52
"""That have room below a drawing"""
CHARACTER_PX, LINE_PX = 6.5, 15
MAX_TITLE = 28
"""Characters of a title that have room beside a drawing; a longer one has two lines"""
QUANTITIES = {"com": "centre of mass", "axes": "principal axes", "angular_velocity": "angular velocity"}
"""Names of quantities with a NEES, where the key is no word"""


def distribution(metric: Metric, key: str) -> Figure:
    """A histogram, with the median."""
    known = metric.known
    edges = np.histogram_bin_edges(np.log10(known) if metric.is_logarithmic else known, bins=_bins(known))
    counts, _ = np.histogram(np.log10(known) if metric.is_logarithmic else known, edges)
    if metric.is_logarithmic:
        edges = 10.0**edges
    middle = float(np.median(known))
    low, high = np.quantile(known, [0.1, 0.9])
    outline = {
        "type": "scatter",
        "mode": "lines",
        "x": packed(np.repeat(edges, 2), "f8"),
        "y": packed(np.concatenate([[0], np.repeat(counts, 2), [0]])),
        "line": {"color": ACCENT, "width": 1.4},
        "fill": "toself",
        "fillcolor": translucent(ACCENT, 0.22),
        "name": "points",
        "hoverinfo": "x+y",
    }
    mark = {
        "type": "scatter",
        "mode": "lines",
        "x": [middle, middle],
        "y": [0, int(counts.max())],
        "line": {"color": SECOND, "width": 1.6, "dash": "dash"},
        "name": f"median {middle:.3g}",
    }
    caption = f"{len(known)} points; four fifths of them lie between {low:.3g} and {high:.3g}."
    drawing = layout(xaxis=_axis_of(metric), yaxis=axis("points", rangemode="tozero"))
    return Figure(key, "Distribution", caption, [outline, mark], drawing, HEIGHT_PX, wide=False)


def _bins(values: Array) -> int:
    return int(np.clip(2.0 * len(values) ** 0.5, 5, 40))


def dependence(metric: Metric, along: Axis, key: str) -> Figure:
    """A metric along an axis: points, median with its band, the range of four fifths of the points."""
    found = spreads(along, metric.values)
    shown = np.flatnonzero(np.isfinite(metric.values))
    shown = shown[chosen_rows(len(shown), 400)]
    points = {
        "type": "scatter",
        "mode": "markers",
        "x": packed(_jittered(along, shown), "f8"),
        "y": packed(metric.values[shown], "f8"),
        "marker": {"color": translucent(ACCENT, 0.35), "size": 4},
        "name": "points",
        "showlegend": False,
        "hoverinfo": "x+y",
    }
    middles = [each.median for each in found]
    wide = _strip(
        along, middles, [each.tenth for each in found], [each.nine_tenths for each in found],
        "four fifths of the points", translucent(FAINT, 0.22),
    )  # fmt: skip
    narrow = _strip(
        along, middles, [each.low for each in middles], [each.high for each in middles],
        "its 95 % band", translucent(ACCENT, 0.33),
    )  # fmt: skip
    drawing = layout(xaxis=_axis_along(along), yaxis=_axis_of(metric, beside=True))
    data, height = [points, *wide, _middle(along, middles, "median"), *narrow], HEIGHT_PX + _labels_px(along)
    return Figure(key, f"Against {along.name}", _caption(metric, found), data, drawing, height, wide=False)


def _caption(metric: Metric, found: Sequence[Spread]) -> str:
    """The lowest and the highest median, and whether their bands keep apart."""
    known = [each.median for each in found]
    if len(known) < 2:
        return "One group of points has this metric."
    low, high = min(known, key=attrgetter("value")), max(known, key=attrgetter("value"))
    said = f"Medians from {low.value:.3g} to {high.value:.3g}"
    if low.high < high.low:
        return f"{said}; the bands of these two keep apart."
    if np.isnan(low.high) or np.isnan(high.low):
        return f"{said}; some groups have too few points for a band."
    return f"{said}; the bands of these two overlap."


def share_drawing(along: Axis, holds: Bools, what: str, key: str) -> Figure:
    """The share of the points for which something holds, along an axis."""
    found = shares(along, holds)
    band = _strip(
        along, found, [each.low for each in found], [each.high for each in found],
        "95 % band (Wilson)", translucent(ACCENT, 0.33),
    )  # fmt: skip
    drawing = layout(
        xaxis=_axis_along(along), yaxis=axis(what, range=[-0.03, 1.03], tickformat=".0%"), showlegend=False
    )
    least = min(found, key=attrgetter("value"))
    caption = (
        f"Least: {least.value:.0%} at {_place(along, least.at)} ({least.count} points, band {least.low:.0%} "
        f"to {least.high:.0%})."
    )
    data = [*band, _middle(along, found, what)]
    height = 270 + _labels_px(along)
    return Figure(key, f"Against {along.name}", caption, data, drawing, height, wide=False)


def _place(along: Axis, at: float) -> str:
    return along.labels[round(at)] if along.labels else f"{at:.3g}"


def trade_off(first: Metric, second: Metric, words: Sequence[str], key: str) -> Figure | None:
    """Two metrics of each point, and the front: points that no other one is better than in both.

    ``words``: of each point, shown where the pointer rests. None: no point has both.
    """
    both = np.flatnonzero(np.isfinite(first.values) & np.isfinite(second.values))
    if len(both) < 2:
        return None
    front = both[front_of(_worse(first)[both], _worse(second)[both])]
    # the front has all of its points
    shown = both[chosen_rows(len(both), 1000)]
    ways = [f"{'more' if each.more_is_better else 'less'} {each.title}" for each in (first, second)]
    caption = (
        f"{len(both)} points, {len(front)} of them on the front: no other point has {ways[0]} than one of "
        f"these, and {ways[1]} at the same time."
    )
    data = [
        _points(first, second, shown, words, "points", translucent(ACCENT, 0.4), 5),
        {
            **_points(first, second, front, words, "Pareto front", SECOND, 7),
            "mode": "lines+markers",
            "line": {"color": SECOND, "width": 1.4, "dash": "dot"},
        },
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


def _worse(metric: Metric) -> Array:
    return -metric.values if metric.more_is_better else metric.values


def _points(
    first: Metric, second: Metric, rows: Ints, words: Sequence[str], name: str, color: str, size: int
) -> Trace:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": packed(first.values[rows], "f8"),
        "y": packed(second.values[rows], "f8"),
        "text": [words[row] for row in rows],
        "hovertemplate": "%{text}<br>%{x:.4g}, %{y:.4g}<extra></extra>",
        "marker": {"color": color, "size": size},
        "name": name,
    }


def consistency_drawing(found: Sequence[Consistency], group: str, key: str) -> Figure:
    """Of each quantity the mean with its band, beside where it is expected."""
    scale = [each.expected if group == NEES else 1.0 for each in found]
    names = [f"{QUANTITIES.get(each.name, each.name)} ({each.runs})" for each in found]
    place = np.arange(len(found), dtype=np.float64)[::-1]
    expected = [
        {
            "type": "scatter",
            "mode": "lines",
            "x": [each.expected_low / by, each.expected_high / by],
            "y": [at, at],
            "line": {"color": EDGE, "width": 11},
            "name": "expected, if the standard deviations are right",
            "hoverinfo": "x",
        }
        for each, by, at in zip(found, scale, place, strict=True)
    ]
    value = np.array([each.mean / by for each, by in zip(found, scale, strict=True)])
    low = np.array([each.low / by for each, by in zip(found, scale, strict=True)])
    high = np.array([each.high / by for each, by in zip(found, scale, strict=True)])
    means = {
        "type": "scatter",
        "mode": "markers",
        "x": packed(value, "f8"),
        "y": packed(place, "f8"),
        "error_x": _bars(value, low, high, ACCENT, 2.0),
        "marker": {"color": ACCENT, "size": 8},
        "name": "mean over the runs, with its 95 % band",
    }
    ticks = {"tickvals": place.tolist(), "ticktext": names, "range": [-0.6, len(found) - 0.4]}
    across = (
        axis("mean NEES over its number of components", **_by_ratio(_finite([*value, *low, *high, 1.0])))
        if group == NEES
        else axis("share within three standard deviations", tickformat=".1%")
    )
    drawing = layout(
        xaxis=across, yaxis=axis("", **ticks), shapes=[_upright(1.0 if group == NEES else found[0].expected)]
    )
    height = 120 + 34 * len(found)
    return Figure(key, _TITLES[group], _CAPTIONS[group], [*expected, means], drawing, height, wide=False)


_TITLES = {
    NEES: "NEES",
    COVERAGE: "Coverage of the states",
    COVERAGE_CONSTANTS: "Coverage of the constants",
}
_CAPTIONS = {
    NEES: "Right of the expected range: the standard deviations are too small. Left of it: too large. In "
    "brackets the number of runs.",
    COVERAGE: "Of position, velocity, attitude and angular velocity in all frames of a run. Left of the "
    "expected range: the standard deviations are too small.",
    COVERAGE_CONSTANTS: "Of inertia, centre of mass and principal axes. Left of the expected range: the "
    "standard deviations are too small.",
}


def _upright(at: float) -> Layout:
    return {
        "type": "line",
        "x0": at,
        "x1": at,
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": FAINT, "width": 1, "dash": "dot"},
    }


def _finite(values: Sequence[float]) -> Array:
    """The finite ones above 0 (n,)."""
    known = np.array(values)
    return np.asarray(known[np.isfinite(known) & (known > 0.0)])


def _axis_of(metric: Metric, beside: bool = False) -> Layout:
    """Below a drawing, or beside it, where its title has less room."""
    title = _in_two_lines(metric.title) if beside else metric.title
    return axis(title, **(_by_ratio(metric.known) if metric.is_logarithmic else {}))


def _in_two_lines(title: str) -> str:
    """A long name of a column, broken between its words."""
    ends = [match.end() for match in re.finditer(r"[._ ]", title)]
    if len(title) <= MAX_TITLE or not ends:
        return title
    at = min(ends, key=lambda end: abs(end - len(title) / 2))
    return f"{title[:at]}<br>{title[at:]}"


def _axis_along(along: Axis) -> Layout:
    if along.labels:
        places, lines = list(range(len(along.labels))), _lines_of_labels(along)
        return axis(
            along.name,
            tickvals=places,
            ticktext=["<br>".join(each) for each in lines],
            tickangle=0 if _is_upright(lines) else 90,
            # without this, plotly.js leaves out a label that reaches beyond the drawing
            ticklabeloverflow="allow",
            range=[-0.6, len(places) - 0.4],
        )
    return axis(along.name, **(_by_ratio(along.values) if along.is_logarithmic else {}))


def _lines_of_labels(along: Axis) -> list[list[str]]:
    """The lines of each label: several where few labels stand side by side, and their words have room."""
    room = CHARACTERS_ACROSS // len(along.labels)
    longest = max(len(word) for label in along.labels for word in label.split() or [""])
    if len(along.labels) > MAX_UPRIGHT or longest > room:
        return [[label] for label in along.labels]
    return [wrap(label, room) or [""] for label in along.labels]


def _is_upright(lines: Sequence[Sequence[str]]) -> bool:
    room = CHARACTERS_ACROSS // len(lines)
    return len(lines) <= MAX_UPRIGHT and all(len(line) <= room for label in lines for line in label)


def _labels_px(along: Axis) -> int:
    """Height that its labels take beyond a single line."""
    if not along.labels:
        return 0
    lines = _lines_of_labels(along)
    if _is_upright(lines):
        return LINE_PX * (max(map(len, lines)) - 1)
    return round(CHARACTER_PX * max(map(len, along.labels)))


def _by_ratio(values: Array) -> Layout:
    """A logarithmic scale over values (n,), with numbers that can be read beside its ticks."""
    ends = np.log10(values.min()), np.log10(values.max())
    steps = (1.0, 2.0, 5.0) if ends[1] - ends[0] < 2.5 else (1.0,)
    decades = range(int(np.floor(ends[0])) - 1, int(np.ceil(ends[1])) + 1)
    ticks = [float(f"{step}e{decade}") for decade in decades for step in steps]
    return {"type": "log", "tickvals": ticks, "ticktext": [f"{each:g}" for each in ticks]}


def _jittered(along: Axis, rows: Ints) -> Array:
    """Values of an axis; beside the middle where they are labels."""
    if not along.labels:
        return np.asarray(along.values[rows])
    return np.asarray(along.values[rows] + np.random.default_rng(0).uniform(-0.18, 0.18, len(rows)))


def _middle(along: Axis, found: Sequence[Estimate], name: str) -> Trace:
    return {
        "type": "scatter",
        "mode": "markers" if along.labels else "lines+markers",
        "x": packed([each.at for each in found], "f8"),
        "y": packed([each.value for each in found], "f8"),
        "text": [f"{each.count} points" for each in found],
        "hovertemplate": "%{y:.4g}, %{text}<extra></extra>",
        "line": {"color": INK, "width": 1.6},
        "marker": {"color": INK, "size": 6},
        "name": name,
    }


def _strip(
    along: Axis,
    found: Sequence[Estimate],
    low: Sequence[float],
    high: Sequence[float],
    name: str,
    color: str,
) -> list[Trace]:
    """Between two curves where the axis has numbers, bars over its labels; groups without are left out."""
    x, below, above = np.array([each.at for each in found]), np.array(low), np.array(high)
    known = np.isfinite(below) & np.isfinite(above)
    x, below, above = x[known], below[known], above[known]
    if not len(x):
        return []
    if along.labels:
        sides = np.array([-HALF_BAR, HALF_BAR])
        return [
            _outline(at + sides, np.repeat(a, 2), np.repeat(b, 2), name, color)
            for at, a, b in zip(x, below, above, strict=True)
        ]
    return [_outline(x, below, above, name, color)]


def _outline(x: Array, below: Array, above: Array, name: str, color: str) -> Trace:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(np.concatenate([x, x[::-1]]), "f8"),
        "y": packed(np.concatenate([below, above[::-1]]), "f8"),
        "line": {"width": 0},
        "fill": "toself",
        "fillcolor": color,
        "name": name,
        "hoverinfo": "skip",
    }


def _bars(value: Array, low: Array, high: Array, color: str, width: float) -> dict[str, Any]:
    """Error bars between two ends; none where they are not finite."""
    known = np.isfinite(low) & np.isfinite(high)
    return {
        "type": "data",
        "symmetric": False,
        "array": packed(np.where(known, high - value, 0.0), "f8"),
        "arrayminus": packed(np.where(known, value - low, 0.0), "f8"),
        "color": color,
        "thickness": width,
        "width": 0,
    }
