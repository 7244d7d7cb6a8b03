"""How large the page may become, and the fewer points with which the figures of a long run stay within it.

A figure has some pixels for each curve; a run may have thousands of frames for it. A curve that is thinned
keeps the lowest and the highest point of each stretch, so that no outlier disappears, and where it has gaps.
The files of the run keep everything.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from polhode.geometry.lie import Array, Ints
from polhode.report.plot_style import BAND, Figure, Trace

PAGE_BYTES = 3_000_000
FIGURE_BYTES = 430_000
"""Of all figures; the library takes 1.96 MB, and what these and the words leave is for the pictures."""
POINTS_PER_CURVE = (1200, 800, 560, 400, 280, 200, 140, 100, 70)
"""The first number with which the figures are small enough, else the last one."""
CLOUD_FACTOR = 8
"""Points of a cloud for each point of a curve"""
THINNED_NOTE = " Drawn with fewer points than there are, with every peak; the files of the run have all."


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
    """At most ``most`` points on a curve, ``CLOUD_FACTOR`` times that in a cloud; meshes stay as they are."""
    data = [_thin_trace(trace, most) for trace in figure.data]
    if all(a is b for a, b in zip(data, figure.data, strict=True)):
        return figure
    return replace(figure, data=data, caption=figure.caption + THINNED_NOTE)


def extremes(values: Array, most: int) -> Ints:
    """Indices (n,), n <= most, ascending: the ends, and the extremes of equal stretches of values (F,).

    Of a stretch with values and gaps (NaN), its first gap takes the place of the lowest value.
    """
    if len(values) <= most:
        return np.arange(len(values))
    chosen = [0, len(values) - 1]
    for stretch in np.array_split(np.arange(len(values)), max((most - 2) // 2, 1)):
        known, gaps = stretch[np.isfinite(values[stretch])], stretch[~np.isfinite(values[stretch])]
        if len(known):
            chosen.append(int(known[np.argmax(values[known])]))
        chosen.append(int(gaps[0] if len(gaps) else known[np.argmin(values[known])]))
    return np.unique(chosen)


def _thin_trace(trace: Trace, most: int) -> Trace:
    kind, y = trace["type"], trace.get("y")
    is_band = trace.get("name") == BAND
    if not isinstance(y, np.ndarray) or kind == "mesh3d" or ("fill" in trace and not is_band):
        return trace
    if kind == "heatmap":
        # of marks (0, 1): a column of the new one has the marks of all those that it stands for
        if len(trace["x"]) <= most:
            return trace
        starts = np.unique(np.linspace(0, len(trace["x"]), most, endpoint=False).astype(int))
        return trace | {"x": trace["x"][starts], "z": np.maximum.reduceat(trace["z"], starts, axis=1)}
    if is_band:
        # its outline goes there along the upper edge and back along the lower one
        half = len(y) // 2
        there, back = extremes(y[:half], most), len(y) - 1 - extremes(y[half:][::-1], most)
        chosen = np.concatenate([there, back[::-1]])
    elif kind == "scatter3d":
        # A path in space keeps 900 points: the wires of an ellipsoid have fewer.
        drawn = CLOUD_FACTOR * most if trace["mode"] == "markers" else max(2 * most, 900)
        chosen = np.unique(np.linspace(0, len(y) - 1, min(drawn, len(y))).round().astype(int))
    else:
        chosen = extremes(y, most)
    if len(chosen) >= len(y):
        return trace

    def choose(value: Any) -> Any:
        """Also of colours and sizes that are given for each point."""
        if isinstance(value, np.ndarray):
            return value[chosen] if len(value) == len(y) else value
        return {name: choose(each) for name, each in value.items()} if isinstance(value, dict) else value

    thinned: Trace = choose(trace)
    # Bars close the gaps that the missing ones leave.
    return thinned | ({"width": trace["width"] * len(y) / len(chosen)} if "width" in trace else {})
