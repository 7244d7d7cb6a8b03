"""How large the page may become, and the fewer points with which the figures of a long run stay within it.

A figure has some pixels for each curve; a run may have thousands of frames for it. A curve that is thinned
keeps the lowest and the highest point of each stretch, so that no outlier disappears, and where it has gaps.
The files of the run keep everything.
"""

import base64
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from polhode.lie import Array
from polhode.pipeline.report.plot_style import Figure, Trace, packed
from polhode.records import Ints

PAGE_BYTES = 3_000_000
FIGURE_BYTES = 430_000
"""Of all figures; the library takes 1.96 MB, and what these and the words leave is for the pictures."""
POINTS_PER_CURVE = (1200, 800, 560, 400, 280, 200, 140, 100, 70)
"""The first number with which the figures are small enough, else the last one."""
CLOUD = 8
"""Points of a cloud for each point of a curve"""
MIN_POINTS_OF_PATH = 900
"""A path in space is not thinned further: the wires of an ellipsoid have fewer points."""
FEWER = " Drawn with fewer points than there are, with every peak; the files of the run have all."


def figures_within(
    figures: Sequence[Figure], text: Callable[[Figure], str], most_bytes: int = FIGURE_BYTES
) -> list[Figure]:
    """The figures, with fewer points where their ``text`` is longer than ``most_bytes`` in all."""
    thinned = list(figures)
    for most in POINTS_PER_CURVE:
        if sum(len(text(each)) for each in thinned) <= most_bytes:
            break
        thinned = [with_fewer_points(each, most) for each in figures]
    return thinned


def with_fewer_points(figure: Figure, most: int) -> Figure:
    """At most ``most`` points on a curve, and ``CLOUD`` times as many in a cloud; meshes stay as they are."""
    data = [_thinned(trace, most) for trace in figure.data]
    if all(a is b for a, b in zip(data, figure.data, strict=True)):
        return figure
    return replace(figure, data=data, caption=figure.caption + FEWER)


def unpacked(values: dict[str, str]) -> Array:
    """The array that ``packed`` was given, of its shape."""
    array = np.frombuffer(base64.b64decode(values["bdata"]), dtype=np.dtype(values["dtype"]))
    return array.reshape([int(n) for n in values["shape"].split(", ")]) if "shape" in values else array


def extremes(values: Array, most: int) -> Ints:
    """Indices (n,), n <= most, ascending: the ends, and the extremes of equal stretches of values (F,).

    Of a stretch with values and gaps (NaN), its first gap takes the place of the lowest value.
    """
    if len(values) <= most:
        return np.arange(len(values))
    kept = [0, len(values) - 1]
    for stretch in np.array_split(np.arange(len(values)), max((most - 2) // 2, 1)):
        known, gaps = stretch[np.isfinite(values[stretch])], stretch[~np.isfinite(values[stretch])]
        if len(known):
            kept.append(int(known[np.argmax(values[known])]))
            kept.append(int(gaps[0] if len(gaps) else known[np.argmin(values[known])]))
        else:
            kept.append(int(gaps[0]))
    return np.unique(kept)


def _thinned(trace: Trace, most: int) -> Trace:
    kind = trace["type"]
    if kind == "heatmap":
        return _thinned_columns(trace, most)
    if kind not in ("scatter", "scatter3d", "bar") or not isinstance(trace["y"], dict):
        return trace
    y = unpacked(trace["y"])
    if kind == "scatter" and trace.get("fill") == "toself" and trace["mode"] == "lines" and "line" in trace:
        return _chosen(trace, _of_outline(trace, y, most))
    if kind == "scatter3d":
        drawn = CLOUD * most if trace["mode"] == "markers" else max(2 * most, MIN_POINTS_OF_PATH)
        drawn = min(drawn, len(y))
        return _chosen(trace, np.unique(np.linspace(0, len(y) - 1, drawn).round().astype(int)))
    return _chosen(trace, extremes(y, most), wider=kind == "bar")


def _of_outline(trace: Trace, y: Array, most: int) -> Ints:
    """Indices of a band's outline, which goes there along the upper edge and back along the lower one."""
    half = len(y) // 2
    x = unpacked(trace["x"])
    if len(y) % 2 or not np.array_equal(x[:half], x[half:][::-1]):
        return np.arange(len(y))
    there = extremes(y[:half], most)
    back = len(y) - 1 - extremes(y[half:][::-1], most)
    return np.concatenate([there, back[::-1]])


def _chosen(trace: Trace, kept: Ints, wider: bool = False) -> Trace:
    """The trace with the points ``kept``, also where colours and sizes are given for each of them."""
    count = len(unpacked(trace["y"]))
    if len(kept) >= count:
        return trace

    def chosen(value: Any) -> Any:
        if isinstance(value, dict) and "bdata" in value:
            array = unpacked(value)
            return packed(array[kept], value["dtype"]) if len(array) == count else value
        return {name: chosen(each) for name, each in value.items()} if isinstance(value, dict) else value

    thinned: Trace = chosen(trace)
    # Bars close the gaps that the missing ones leave.
    return thinned | {"width": trace["width"] * count / len(kept)} if wider and "width" in trace else thinned


def _thinned_columns(trace: Trace, most: int) -> Trace:
    """A heat map of marks (0, 1): a column of the new one has the marks of all those that it stands for."""
    x, z = unpacked(trace["x"]), unpacked(trace["z"])
    if len(x) <= most:
        return trace
    starts = np.unique(np.linspace(0, len(x), most, endpoint=False).astype(int))
    marks = np.maximum.reduceat(z, starts, axis=1)
    return trace | {"x": packed(x[starts]), "z": packed(marks, trace["z"]["dtype"])}
