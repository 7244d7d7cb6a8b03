"""The parts that every figure is drawn with: traces, axes, colours, as plain data for plotly.js."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from polhode.geometry.lie import Array, Bools, Ints

Trace = dict[str, Any]
Layout = dict[str, Any]

TIME_TITLE = "time since the first frame [s]"
AXIS_COLORS: tuple[str, str, str] = ("#d55e00", "#cc79a7", "#0072b2")
"""x, y, z: vermillion, reddish purple, blue of Okabe and Ito, distinct for colour-blind readers too."""
INK, FAINT, ACCENT = "#22303c", "#77848f", "#0072b2"
SECOND = "#d55e00"
"""Beside ACCENT, where two curves share a drawing"""
GRID = "#e8ecf0"
PAPER, EDGE, STRIP = "#ffffff", "#c3ccd4", "#dfe4e8"
"""Ground of a drawing, line of an axis, strip over frames without measurements"""
SCENE_GROUND, SCENE_GRID = "#fafbfc", "#dde3e8"
WIRE, SHEET, REGION = "#7a8b99", "#9fc5de", "#5d6b78"
"""Wires and sheet of the ellipsoids; region of the possible bodies"""
DARK: dict[str, str] = {
    AXIS_COLORS[0]: "#f5893d", AXIS_COLORS[1]: "#e9a3cb", AXIS_COLORS[2]: "#56b4e9", INK: "#e6ebef",
    FAINT: "#93a0ab", GRID: "#29323a", PAPER: "#171d23", EDGE: "#4a5661", STRIP: "#34404a",
    SCENE_GROUND: "#1c242b", SCENE_GRID: "#36424c", WIRE: "#a7b4bf", SHEET: "#35566d", REGION: "#a9b6c1",
}  # fmt: skip
"""What a colour becomes in the dark scheme; others are the same in both."""
BAND = "± 3σ"
"""Name of a band of three standard deviations in a legend"""
TIME_SCALE = [[0.0, "#3b0f70"], [0.35, "#b5367a"], [0.7, "#fb8861"], [1.0, "#f6d746"]]
SIGMA_SCALE = [[0.0, "#fde725"], [0.33, "#35b779"], [0.66, "#31688e"], [1.0, "#440154"]]


@dataclass(frozen=True)
class Figure:
    """One drawing with its title and caption."""

    key: str
    title: str
    caption: str
    data: list[Trace]
    layout: Layout
    height_px: int = 420
    wide: bool = True
    clock: Literal["", "time", "frames"] = ""
    """What its first x axis and those that match it count, along which the page's slider moves a line"""

    @property
    def traces(self) -> list[Trace]:
        """The data, each name once in the legend: what shares a name is switched together."""
        shown: set[str] = set()
        traces = []
        for trace in self.data:
            name = trace.get("name", "")
            if name and trace.get("showlegend", True):
                trace = trace | {"legendgroup": name, "showlegend": name not in shown}
                shown.add(name)
            traces.append(trace)
        return traces

    @property
    def solid(self) -> bool:
        """Whether it is three-dimensional, which takes a browser longer."""
        return "scene" in self.layout


def packed(values: ArrayLike, dtype: str = "") -> dict[str, str]:
    """An array as plotly.js reads it fastest and shortest: base64 of its bytes. Infinities become gaps.

    dtype: single precision and ``i4`` unless given; ``u1`` and ``u2`` stay.
    """
    array = np.asarray(values)
    if not dtype and (dtype := array.dtype.str[1:]) not in ("u1", "u2"):
        dtype = "f4" if array.dtype.kind == "f" else "i4"
    if dtype.startswith("f"):
        array = np.where(np.isfinite(array), array, np.nan)
    array = np.ascontiguousarray(array, dtype="<" + dtype)
    out = {"dtype": dtype, "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    return out | ({"shape": ", ".join(map(str, array.shape))} if array.ndim > 1 else {})


def translucent(color: str, alpha: float) -> str:
    """#rrggbb -> #rrggbbaa, which begins with the colour: ``DARK`` replaces it there too."""
    return f"{color}{round(255 * alpha):02x}"


def line(x: ArrayLike, y: ArrayLike, name: str, color: str, panel: int = 1, **more: Any) -> Trace:
    """A line through the points, on the axes of one panel."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    style = {"line": {"color": color, "width": 1.6}, "marker": {"color": color, "size": 3.5}}
    return (
        {"type": "scatter", "mode": "lines+markers", "x": x, "y": y, "name": name} | style | on(panel) | more
    )


def dashed(x: ArrayLike, y: ArrayLike, name: str, panel: int = 1) -> Trace:
    """A thin dashed line: a mean or a final value."""
    style = {"color": FAINT, "width": 1.2, "dash": "dash"}
    return line(x, y, name, FAINT, panel, mode="lines", line=style)


def points3d(points: ArrayLike, name: str, **more: Any) -> Trace:
    """Points (n, 3) of a scene, markers unless ``mode`` says otherwise."""
    return {"type": "scatter3d", "mode": "markers", **columns("xyz", points), "name": name, **more}


def mesh3d(vertices: ArrayLike, faces: Array | Ints, name: str, **more: Any) -> Trace:
    """Triangles of a scene, vertices (V, 3) and faces (T, 3), without a text under the pointer."""
    corners = columns("ijk", faces.astype(np.uint16))
    hidden = {"name": name, "showlegend": True, "hoverinfo": "skip"}
    return {"type": "mesh3d", **columns("xyz", vertices), **corners, **hidden, **more}


def columns(names: str, rows: ArrayLike) -> dict[str, Array]:
    """The columns of an array (n, k) by names of a letter each."""
    return dict(zip(names, np.asarray(rows).T, strict=True))


def band(x: ArrayLike, y: ArrayLike, half: ArrayLike, color: str, panel: int = 1, **more: Any) -> list[Trace]:
    """The strip y - half .. y + half; nothing where half is not finite."""
    x, y, half = (np.asarray(each, dtype=np.float64) for each in (x, y, half))
    known = np.isfinite(half)
    # A fill across a gap goes astray: each stretch without gaps is an outline of its own.
    stretches = np.split(np.arange(len(x)), np.flatnonzero(np.diff(known)) + 1)
    style = {"line": {"width": 0}, "fillcolor": translucent(color, 0.22), **more}
    there_and_back = [np.concatenate([k, k[::-1]]) for k in stretches if len(k) and known[k[0]]]
    signed = [half[k] * np.repeat([1.0, -1.0], len(k) // 2) for k in there_and_back]
    return [
        outline(x[k], y[k] + offset, BAND, panel, **style)
        for k, offset in zip(there_and_back, signed, strict=True)
    ]


def outline(x: Array, y: Array, name: str, panel: int = 1, **more: Any) -> Trace:
    """A filled area."""
    style = {"type": "scatter", "mode": "lines", "fill": "toself", "hoverinfo": "skip", "name": name}
    return {**style, "x": x, "y": y, **on(panel), **more}


def line_with_band(
    x: ArrayLike, y: ArrayLike, sigma: ArrayLike, name: str, color: str, panel: int = 1
) -> list[Trace]:
    """A line and its band of three standard deviations."""
    return [*band(x, y, 3 * np.asarray(sigma), color, panel), line(x, y, name, color, panel)]


def on(panel: int) -> dict[str, str]:
    """Name the axes of a panel, counted from 1, as a trace names them."""
    suffix = "" if panel == 1 else str(panel)
    return {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}


def key_of(letter: str, panel: int) -> str:
    """Name of the x or y axis of a panel, counted from 1, as a layout names it."""
    return f"{letter}axis{'' if panel == 1 else panel}"


def axis(title: str = "", **more: Any) -> Layout:
    """The common look of an axis."""
    return {
        "title": {"text": title, "font": {"size": 12}, "standoff": 6},
        **{"gridcolor": GRID, "zeroline": False, "linecolor": EDGE, "showline": True},
        **{"ticks": "outside", "ticklen": 3, "tickcolor": EDGE},
        **{"automargin": True, "exponentformat": "power", "minexponent": 5},
        **more,
    }


def layout(**more: Any) -> Layout:
    """The common look of a drawing."""
    family = "Inter, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif"
    return {
        "font": {"family": family, "size": 12, "color": INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": PAPER,
        "margin": {"l": 64, "r": 16, "t": 28, "b": 46},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "xanchor": "left"},
        "showlegend": True,
        "hovermode": "closest",
        "hoverlabel": {"font": {"size": 12}},
        "modebar": {"bgcolor": PAPER, "color": FAINT, "activecolor": ACCENT},
        **more,
    }


def panels(
    y_titles: Sequence[Sequence[str]], x_title: str, column_titles: Sequence[str] = (), **more: Any
) -> Layout:
    """Axes of a table of drawings that share x; panels are counted along the rows, from 1 at the top left."""
    rows, columns = len(y_titles), len(y_titles[0])
    out = layout(**more)
    gap_x, gap_y = 0.09, 0.05
    width, height = (1 - gap_x * (columns - 1)) / columns, (1 - gap_y * (rows - 1)) / rows
    for panel in range(1, rows * columns + 1):
        row, column = divmod(panel - 1, columns)
        left, top, last = column * (width + gap_x), 1 - row * (height + gap_y), row == rows - 1
        x, y, name = key_of("x", panel), key_of("y", panel), on(panel)
        out[x] = axis(x_title if last else "", domain=[left, left + width], anchor=name["yaxis"])
        out[x] |= {"matches": "x", "showticklabels": last} if panel > 1 else {"showticklabels": last}
        out[y] = axis(y_titles[row][column], domain=[top - height, top], anchor=name["xaxis"])
    if column_titles:
        # The legend stands above them.
        out["legend"] = out["legend"] | {"y": 1.06}
    style = {"yanchor": "bottom", "yshift": 6, "font": {"size": 13, "color": INK}}
    out["annotations"] = [
        note(title, column * (width + gap_x) + width / 2, 1.0, **style)
        for column, title in enumerate(column_titles)
    ]
    return out


def note(text: str, x: float, y: float, **more: Any) -> Layout:
    """Words on the paper of a drawing, 0..1."""
    place = {"x": x, "y": y, "xref": "paper", "yref": "paper", "xanchor": "center"}
    return {"text": text, "showarrow": False, **place, **more}


def gap_shapes(time_s: Array, seen: Bools, columns: int = 1) -> list[Layout]:
    """Grey strips over the frames without measurements, neighbours joined, in the columns of a figure."""
    bridged = np.flatnonzero(~seen)
    if len(bridged) == 0 or len(time_s) < 2:
        return []
    edges = np.concatenate([time_s[:1], 0.5 * (time_s[1:] + time_s[:-1]), time_s[-1:]])
    runs = np.split(bridged, np.flatnonzero(np.diff(bridged) > 1) + 1)
    look = {"type": "rect", "layer": "below", "fillcolor": STRIP, "opacity": 0.6, "line": {"width": 0}}
    look |= {"name": "no measurements: bridged by the dynamics", "y0": 0, "y1": 1, "yref": "paper"}
    return [
        look
        | {"x0": float(edges[run[0]]), "x1": float(edges[run[-1] + 1]), "xref": on(column)["xaxis"]}
        | {"showlegend": number == 0 and column == 1}
        for number, run in enumerate(runs)
        for column in range(1, columns + 1)
    ]


def color_bar(title: str) -> Layout:
    """A colour scale over the right edge of a scene."""
    where = {"x": 1.0, "xanchor": "right", "y": 0.52, "len": 0.62, "thickness": 11}
    return {"title": {"text": title, "side": "top", "font": {"size": 12}}, "outlinewidth": 0, **where}


def scene_layout(
    data: Sequence[Trace],
    unit: str,
    names: Sequence[str] = ("x", "y", "z"),
    eye: ArrayLike = (1.4, -1.5, 0.9),
) -> Layout:
    """A drawing of traces in one scene: three axes of equal scale, seen from the direction ``eye`` (3,)."""
    look = {"backgroundcolor": SCENE_GROUND, "gridcolor": SCENE_GRID, "showbackground": True}
    look |= {"zeroline": False, "tickfont": {"size": 10.5}, "nticks": 6}
    # Far enough that no axis leaves the drawing, however long the body is.
    toward = np.asarray(eye, dtype=np.float64)
    toward = 2.66 * _scene_radius(data) * toward / np.linalg.norm(toward)
    scene: Layout = {
        f"{k}axis": {"title": {"text": f"{name} [{unit}]"}, **look}
        for k, name in zip("xyz", names, strict=True)
    }
    # The legend stands below.
    scene |= {"domain": {"x": [0.0, 1.0], "y": [0.07, 1.0]}, "aspectmode": "data"}
    eye_of_scene = dict(zip("xyz", toward.tolist(), strict=True))
    scene["camera"] = {"eye": eye_of_scene, "center": {"x": 0.0, "y": 0.0, "z": -0.07}}
    margin, legend = {"l": 0, "r": 0, "t": 8, "b": 0}, {"orientation": "h", "x": 0, "y": 0}
    return layout(scene=scene, margin=margin, legend=legend)


def _scene_radius(data: Sequence[Trace]) -> float:
    """Half the diagonal of the box around the traces that are shown at first, as the scene measures it.

    Plotly scales the box so that the product of its sides is 1.
    """
    shown = [[each[k] for k in "xyz"] for each in data if each.get("visible", True) is True]
    points = np.concatenate([np.array(each, dtype=np.float64) for each in shown], axis=1)
    sides = np.ptp(points, axis=1)
    sides = np.maximum(sides, 1e-3 * max(float(sides.max()), 1e-300))
    return float(0.5 * np.linalg.norm(sides / np.cbrt(np.prod(sides))))


def axis_arrows(origin: Array, R: Array, length: float, names: Sequence[str]) -> list[Trace]:
    """Three coloured lines from an origin (3,), along the columns of R (3, 3), named at their ends."""
    arrows = []
    for tip, name, color in zip(origin + length * R.T, names, AXIS_COLORS, strict=True):
        style: Layout = {"textfont": {"color": color, "size": 13}, "line": {"color": color, "width": 6}}
        style |= {"mode": "lines+text", "text": ["", name], "hoverinfo": "name"}
        arrows.append(points3d(np.stack([origin, tip]), f"principal axis {name}", **style))
    return arrows
