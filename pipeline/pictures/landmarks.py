"""The landmarks from six sides, the half that faces the eye in each: thesis figure 6-28."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from polhode.lie import Array
from polhode.pipeline.pictures.body_views import ALONG_AXES, BodyFrame, Direction, round_length_mm
from polhode.pipeline.report.figures.plot import AXIS_COLORS, FAINT, GRID, INK, SIGMA_SCALE
from polhode.records import Bools, Landmarks

SIZE_IN, DPI = (12.0, 8.3), 100
KEPT_SHARE = 0.995
"""The drawing ends where this share of the landmarks does, with a margin: one far away shrinks nothing."""
SIGMA_MAP = LinearSegmentedColormap.from_list(
    "sigma", [(float(str(place)), str(colour)) for place, colour in SIGMA_SCALE]
)


def draw_landmarks(landmarks: Landmarks, frame: BodyFrame) -> bytes:
    """A PNG of six orthographic views, coloured by standard deviation; ValueError without landmarks."""
    if len(landmarks.p_G) == 0:
        raise ValueError("there are no landmarks")
    p_mm = 1e3 * frame.points(landmarks.p_G)
    sigma_mm = 1e3 * landmarks.sigma_m
    known = np.isfinite(sigma_mm)
    low, top = np.quantile(sigma_mm[known], (0.05, 0.95)) if known.any() else (0.0, 1.0)
    half_mm = 1.12 * max(float(np.quantile(np.abs(p_mm).max(axis=1), KEPT_SHARE)), 1e-3)
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 3, left=0.055, right=0.895, bottom=0.08, top=0.89, wspace=0.22, hspace=0.24)
    norm = Normalize(float(low), float(max(top, 1.001 * low, 1e-6)))
    for k, direction in enumerate(ALONG_AXES):
        axes = figure.add_subplot(grid[k // 3, k % 3])
        _draw_side(axes, direction, p_mm, sigma_mm, known, norm, half_mm)
    _add_scale_bar(figure.axes[0], half_mm)
    bar_axes = figure.add_axes((0.92, 0.08, 0.014, 0.81))
    bar = figure.colorbar(ScalarMappable(norm, SIGMA_MAP), cax=bar_axes, extend="both")
    bar.set_label("standard deviation of a landmark [mm]", color=INK)
    outside = int((np.abs(p_mm).max(axis=1) > half_mm).sum())
    notes = [f"Beyond the drawing: {outside}."] if outside else []
    notes += [f"Without a standard deviation (grey): {int((~known).sum())}."] if not known.all() else []
    words = f"{frame.words} Each view shows the half that faces the eye."
    for height, text, style in (
        (0.965, f"{len(p_mm)} landmarks from six sides", {"size": 14, "weight": "bold"}),
        (0.937, words, {"size": 10}),
        (0.015, " ".join(notes), {"size": 9}),
    ):
        figure.text(0.055, height, text, color=INK, va="center", **style)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=DPI)
    return content.getvalue()


def _draw_side(
    axes: Axes,
    direction: Direction,
    p_mm: Array,
    sigma_mm: Array,
    known: Bools,
    norm: Normalize,
    half_mm: float,
) -> None:
    height = p_mm @ direction.eye
    facing = np.flatnonzero(height >= 0.0)
    facing = facing[np.argsort(height[facing], kind="stable")]
    across, upward = int(np.argmax(np.abs(direction.right))), int(np.argmax(np.abs(direction.up)))
    size = 9.0 if len(p_mm) < 3000 else 4.0
    for chosen, colours in (
        (facing[~known[facing]], {"color": FAINT}),
        (facing[known[facing]], {"c": sigma_mm[facing[known[facing]]], "cmap": SIGMA_MAP, "norm": norm}),
    ):
        axes.scatter(p_mm[chosen, across], p_mm[chosen, upward], s=size, linewidths=0, **colours)
    for axis in (across, upward):
        _draw_axis(axes, axis, (across, upward), 0.5 * half_mm)
    axes.plot(0.0, 0.0, marker="D", markersize=6, color=INK, markeredgecolor="white", zorder=6)
    # An axis that points to the left counts to the left.
    sign = float(np.sign(direction.right[across]))
    axes.set_xlim(-sign * half_mm, sign * half_mm)
    axes.set_ylim(-half_mm, half_mm)
    axes.set_aspect("equal")
    axes.set_title(f"from {direction.name}: {len(facing)} landmarks", size=10, color=INK, loc="left", pad=4)
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, color=FAINT, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_color(GRID)
    axes.set_xlabel(f"{'xyz'[across]} [mm]", size=9, color=INK, labelpad=1)
    axes.set_ylabel(f"{'xyz'[upward]} [mm]", size=9, color=INK, labelpad=-2)


def _draw_axis(axes: Axes, axis: int, plane: tuple[int, int], length_mm: float) -> None:
    """An arrow from the centre of mass along one of the two axes in the plane of the drawing."""
    colour, along = AXIS_COLORS[axis], np.array([float(axis == each) for each in plane])
    x, y = (1.14 * length_mm * along).tolist()
    arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tuple(length_mm * along), xytext=(0.0, 0.0), arrowprops=arrow, zorder=4)
    label = axes.text(x, y, "xyz"[axis], color=colour, size=12, weight="bold", ha="center", va="center")
    label.set_zorder(5)
    label.set_path_effects([withStroke(linewidth=3, foreground="white")])


def _add_scale_bar(axes: Axes, half_mm: float) -> None:
    length = round_length_mm(2.0 * half_mm)
    bar = AnchoredSizeBar(
        axes.transData, length, f"{length:g} mm", "lower left", frameon=False, color=INK, pad=0.4, sep=4
    )
    axes.add_artist(bar)
