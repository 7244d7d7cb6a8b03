"""The parts that every figure is drawn with: traces, axes, colours, as plain data for plotly.js."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polhode.lie import Array
from polhode.records import Bools

Trace = dict[str, Any]
Layout = dict[str, Any]

TIME_TITLE = "time since the first frame [s]"
AXIS_COLORS: tuple[str, str, str] = ("#d55e00", "#009e73", "#0072b2")
"""x, y, z: vermillion, green, blue of Okabe and Ito, distinguishable for colour-blind readers too."""
INK, FAINT, ACCENT = "#22303c", "#8a97a3", "#5b3f8c"
GRID = "#e8ecf0"
TIME_SCALE = [[0.0, "#3b0f70"], [0.35, "#b5367a"], [0.7, "#fb8861"], [1.0, "#f6d746"]]
EYE_DISTANCE = 2.3
"""In sizes of the scene: far enough that no axis leaves the drawing."""
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


def packed(values: ArrayLike, dtype: str = "f4") -> dict[str, str]:
    """An array as plotly.js reads it fastest and shortest: base64 of its bytes. Infinities become gaps."""
    array = np.asarray(values)
    if dtype.startswith("f"):
        array = np.where(np.isfinite(array), array, np.nan)
    array = np.ascontiguousarray(array.astype("<" + dtype if dtype != "u1" else dtype))
    out = {"dtype": dtype, "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    if array.ndim > 1:
        out["shape"] = ", ".join(map(str, array.shape))
    return out


def translucent(color: str, alpha: float) -> str:
    """#rrggbb -> rgba()."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"


def line(x: ArrayLike, y: ArrayLike, name: str, color: str, panel: int = 1, **more: Any) -> Trace:
    """A line through the points, on the axes of one panel."""
    return {
        "type": "scatter",
        "mode": more.pop("mode", "lines+markers"),
        "x": packed(x),
        "y": packed(y),
        "name": name,
        "line": {"color": color, "width": 1.6},
        "marker": {"color": color, "size": 3.5},
        **on(panel),
        **more,
    }


def dashed(x: ArrayLike, y: ArrayLike, name: str, panel: int = 1) -> Trace:
    """A thin dashed line: a mean or a final value."""
    style = {"color": FAINT, "width": 1.2, "dash": "dash"}
    return line(x, y, name, FAINT, panel, mode="lines", line=style)


def points3d(points: ArrayLike, name: str, **more: Any) -> Trace:
    """Points (n, 3) of a scene, markers unless ``mode`` says otherwise."""
    xyz = {key: packed(column) for key, column in zip("xyz", np.asarray(points).T, strict=True)}
    return {"type": "scatter3d", "mode": "markers", **xyz, "name": name, **more}


def band(x: ArrayLike, y: ArrayLike, half: ArrayLike, color: str, panel: int = 1, **more: Any) -> list[Trace]:
    """The strip y - half .. y + half; nothing where half is not finite."""
    y, half = np.asarray(y, dtype=np.float64), np.asarray(half, dtype=np.float64)
    x, known = np.asarray(x, dtype=np.float64), np.isfinite(half)
    # A fill across a gap goes astray: each stretch without gaps is an outline of its own.
    stretches = np.split(np.arange(len(x)), np.flatnonzero(np.diff(known)) + 1)
    outlines = []
    for stretch in stretches:
        if len(stretch) and known[stretch[0]]:
            there, back = stretch, stretch[::-1]
            edge_x = np.concatenate([x[there], x[back]])
            outlines.append((edge_x, np.concatenate([(y + half)[there], (y - half)[back]])))
    style = {
        "type": "scatter",
        "mode": "lines",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    fill = {"fill": "toself", "fillcolor": translucent(color, 0.22)}
    return [{**style, **fill, "x": packed(a), "y": packed(b), **on(panel), **more} for a, b in outlines]


def on(panel: int) -> dict[str, str]:
    """Name the axes of a panel, counted from 1."""
    suffix = "" if panel == 1 else str(panel)
    return {"xaxis": f"x{suffix}", "yaxis": f"y{suffix}"}


def axis(title: str = "", **more: Any) -> Layout:
    """The common look of an axis."""
    return {
        "title": {"text": title, "font": {"size": 12}, "standoff": 6},
        "gridcolor": GRID,
        "zeroline": False,
        "linecolor": "#c3ccd4",
        "showline": True,
        "ticks": "outside",
        "ticklen": 3,
        "tickcolor": "#c3ccd4",
        "automargin": True,
        "exponentformat": "power",
        "minexponent": 5,
        **more,
    }


def layout(**more: Any) -> Layout:
    """The common look of a drawing."""
    return {
        "font": {
            "family": "Inter, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif",
            "size": 12,
            "color": INK,
        },
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 64, "r": 16, "t": 28, "b": 46},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0, "xanchor": "left"},
        "hovermode": "closest",
        "hoverlabel": {"font": {"size": 12}},
        "modebar": {"bgcolor": "rgba(255,255,255,0.85)", "color": "#b3bdc6", "activecolor": ACCENT},
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
    for row in range(rows):
        for column in range(columns):
            panel = row * columns + column + 1
            name = on(panel)
            left, top = column * (width + gap_x), 1 - row * (height + gap_y)
            last = row == rows - 1
            x = axis(x_title if last else "", domain=[left, left + width], anchor=name["yaxis"])
            x |= {"matches": "x", "showticklabels": last} if panel > 1 else {"showticklabels": last}
            y = axis(y_titles[row][column], domain=[top - height, top], anchor=name["xaxis"])
            out[name["xaxis"].replace("x", "xaxis", 1)] = x
            out[name["yaxis"].replace("y", "yaxis", 1)] = y
    centres = [column * (width + gap_x) + width / 2 for column in range(len(column_titles))]
    out["annotations"] = [
        note(title, centre, 1.0, yanchor="bottom", yshift=6, font={"size": 13, "color": INK})
        for title, centre in zip(column_titles, centres, strict=True)
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
    return [
        {
            "type": "rect",
            "layer": "below",
            "x0": float(edges[run[0]]),
            "x1": float(edges[run[-1] + 1]),
            "xref": on(column)["xaxis"],
            "y0": 0,
            "y1": 1,
            "yref": "paper",
            "fillcolor": "#dfe4e8",
            "opacity": 0.6,
            "line": {"width": 0},
        }
        for run in runs
        for column in range(1, columns + 1)
    ]


def color_bar(title: str) -> Layout:
    """A colour scale over the right edge of a scene."""
    where = {"x": 1.0, "xanchor": "right", "y": 0.52, "len": 0.62, "thickness": 11}
    return {"title": {"text": title, "side": "top", "font": {"size": 12}}, "outlinewidth": 0, **where}


def scene(
    unit: str, names: Sequence[str] = ("x", "y", "z"), eye: ArrayLike = (1.4, -1.5, 0.9), **more: Any
) -> Layout:
    """Three axes of equal scale, seen from the direction ``eye`` (3,)."""
    look = {
        "backgroundcolor": "#fafbfc",
        "gridcolor": "#dde3e8",
        "showbackground": True,
        "zeroline": False,
        "tickfont": {"size": 10.5},
        "nticks": 6,
    }
    toward = np.asarray(eye, dtype=np.float64)
    toward = EYE_DISTANCE * toward / np.linalg.norm(toward)
    axes = {
        f"{k}axis": {"title": {"text": f"{name} [{unit}]"}, **look}
        for k, name in zip("xyz", names, strict=True)
    }
    return {
        **axes,
        # The legend stands below.
        "domain": {"x": [0.0, 1.0], "y": [0.07, 1.0]},
        "aspectmode": "data",
        "camera": {
            "eye": dict(zip("xyz", toward.tolist(), strict=True)),
            "center": {"x": 0.0, "y": 0.0, "z": -0.07},
        },
        **more,
    }


def axis_arrows(origin: Array, R: Array, length: float, names: Sequence[str]) -> list[Trace]:
    """Three coloured lines from an origin (3,), along the columns of R (3, 3), named at their ends."""
    return [
        points3d(
            np.stack([origin, tip]),
            f"principal axis {name}",
            mode="lines+text",
            text=["", name],
            textfont={"color": color, "size": 13},
            line={"color": color, "width": 6},
            hoverinfo="name",
            showlegend=False,
        )
        for tip, name, color in zip((origin + length * R.T), names, AXIS_COLORS, strict=True)
    ]


def scene_layout(**more: Any) -> Layout:
    """A drawing that is one scene, with its legend below."""
    margin, legend = {"l": 0, "r": 0, "t": 8, "b": 0}, {"orientation": "h", "x": 0, "y": 0}
    return layout(scene=scene(**more), margin=margin, legend=legend)
