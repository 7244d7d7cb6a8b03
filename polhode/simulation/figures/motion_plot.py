"""Cones, polhode and herpolhode of a scene.

``python -m polhode.simulation.figures.motion_plot CONFIG -o FILE.png``

Surfaces are drawn translucent, by ray casting into a matplotlib panel; lines dim where they pass behind one.
"""

import argparse
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from PIL import Image

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array
from polhode.geometry.rays import RayScene
from polhode.runtime.drawing_style import default_style
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.plan import load_scene
from polhode.simulation.motion.forces import is_free
from polhode.simulation.motion.mass import mass_distribution
from polhode.simulation.motion.poinsot import Poinsot, poinsot, polhodes, rotation_states, separatrix
from polhode.simulation.motion.target import TargetMotion, target_motion

LIGHT = np.array([-0.5, 0.62, 0.6])
"""Direction to the light: right, up, towards the viewer."""
AMBIENT, DIFFUSE, GLOSS, SHININESS = 0.62, 0.42, 0.16, 30.0
LAYERS = 8
"""Number of translucent surfaces one behind the other that are drawn."""


INK, FAINT = "#1c2530", "#8a96a3"
BODY, SPACE, ELLIPSOID = "#3f78c9", "#e2942f", "#d5dae2"
MOMENTUM, RATE, AXIS, PATH = "#1c2530", "#c62f4b", "#2f5f9e", "#2a8f5b"
CONES = {
    "prograde": "The body cone rolls beside the space cone",
    "retrograde": "The body cone rolls around the space cone",
    "none": "No cones: a steady spin",
}
DPI, OVERSAMPLING = 110, 2
RINGS = 16
"""Strips of a cone from its tip to its edge."""


@dataclass(frozen=True)
class _Line:
    points: Array
    """(n, 3) right, up, nearness"""
    color: tuple[float, float, float]
    width_pt: float
    hidden: float
    """Opacity behind a surface"""


class Drawing:
    """Surfaces and lines in space in parallel projection."""

    def __init__(self, towards_viewer: Array, up: Array) -> None:
        """Directions (3,) in the frame of the drawing, of any length, not parallel."""
        near = np.asarray(towards_viewer, dtype=np.float64) / np.linalg.norm(towards_viewer)
        right = np.cross(up, near)
        right /= np.linalg.norm(right)
        self._R = np.stack([right, np.cross(near, right), near])
        self._triangles: list[Array] = []
        self._paints: list[Array] = []
        self._lines: list[_Line] = []

    def seen(self, points: Array) -> Array:
        """Points (..., 3) in the viewer's axes: right, up, towards the viewer."""
        return np.asarray(np.asarray(points) @ self._R.T)

    def surface(self, grid: Array, color: str, opacity: float) -> None:
        """A surface through a grid of points (m, n, 3)."""
        p = self.seen(grid)
        a, b, c, d = p[:-1, :-1], p[1:, :-1], p[1:, 1:], p[:-1, 1:]
        triangles = np.concatenate(
            [np.stack([a, b, c], axis=2).reshape(-1, 3, 3), np.stack([a, c, d], axis=2).reshape(-1, 3, 3)]
        )
        self._triangles.append(triangles)
        self._paints.append(np.tile([*to_rgb(color), opacity], (len(triangles), 1)))

    def line(self, points: Array, color: str, width_pt: float, hidden: float = 0.3) -> None:
        """A line through points (n, 3); behind a surface it has the opacity ``hidden``."""
        self._lines.append(_Line(self.seen(points), to_rgb(color), width_pt, hidden))

    def paint(self, axes: Axes, pixels: int = 1000) -> None:
        """Draw all; ``pixels`` is the larger side of the surfaces' picture."""
        corners = np.concatenate(
            [*(t.reshape(-1, 3) for t in self._triangles), *(x.points for x in self._lines)]
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
        size = float((high - low).max())
        triangles = np.concatenate([np.zeros((0, 3, 3)), *self._triangles])
        scene = RayScene(triangles)
        if len(triangles):
            step = float((high - low)[:2].max()) / pixels
            x, y = (np.arange(low[k] - step, high[k] + 2 * step, step) for k in (0, 1))
            rays = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), high[2] + size)], axis=-1)
            picture = _composed(
                scene, rays.reshape(-1, 3), triangles, np.concatenate(self._paints), 1e-3 * size
            )
            extent = (x[0] - step / 2, x[-1] + step / 2, y[0] - step / 2, y[-1] + step / 2)
            axes.imshow(picture.reshape(len(y), len(x), 4), extent=extent, origin="lower")
        for line in self._lines:
            self._paint_line(axes, scene, line, 4e-3 * size)
        axes.set(xlim=(low[0] - 0.02 * size, high[0] + 0.02 * size))
        axes.set(ylim=(low[1] - 0.02 * size, high[1] + 0.07 * size))
        axes.set_aspect("equal")
        axes.axis("off")

    def _paint_line(self, axes: Axes, scene: RayScene, line: _Line, lift: float) -> None:
        middles = 0.5 * (line.points[:-1] + line.points[1:]) + np.array([0.0, 0.0, lift])
        behind = np.zeros(len(middles), dtype=bool)
        if self._triangles:
            behind = scene.blocked(middles, np.tile([0.0, 0.0, 1.0], (len(middles), 1)))
        # Each stretch is one line: overlapping translucent pieces would be visible.
        cuts = np.flatnonzero(np.diff(behind)) + 1
        for start, end in pairwise([0, *cuts.tolist(), len(behind)]):
            opacity = line.hidden if behind[start] else 1.0
            stretch = line.points[start : end + 1, :2]
            axes.plot(
                *stretch.T, color=(*line.color, opacity), lw=line.width_pt, solid_capstyle="butt", zorder=3
            )


def _composed(scene: RayScene, rays: Array, triangles: Array, paints: Array, skip: float) -> Array:
    """Colours (n, 4) of rays that come down from (n, 3), surface behind surface."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    shades = _shaded(normals, paints)
    color, passing = np.zeros((len(rays), 3)), np.ones(len(rays))
    origins, alive = rays.copy(), np.arange(len(rays))
    for _ in range(LAYERS):
        down = np.tile([0.0, 0.0, -1.0], (len(alive), 1))
        hits = scene.first_hits(origins[alive], down)
        met = hits.face >= 0
        face, alive = hits.face[met], alive[met]
        opacity = paints[face, 3]
        color[alive] += (passing[alive] * opacity)[:, None] * shades[face]
        passing[alive] *= 1.0 - opacity
        origins[alive, 2] -= hits.distance[met] + skip
        if len(alive) == 0:
            break
    covered = 1.0 - passing
    return np.column_stack([color / np.maximum(covered, 1e-9)[:, None], covered]).clip(0.0, 1.0)


def _shaded(normals: Array, paints: Array) -> Array:
    """Colours (f, 3) of faces with normals (f, 3) towards the viewer."""
    light = LIGHT / np.linalg.norm(LIGHT)
    half = light + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    # Wrapped diffuse light: no face is black.
    diffuse = (0.35 + 0.65 * normals @ light)[:, None]
    gloss = np.maximum(normals @ half, 0.0)[:, None] ** SHININESS
    return np.asarray(paints[:, :3] * (AMBIENT + DIFFUSE * diffuse) + GLOSS * gloss)


@default_style
def motion_figure(scene: Scene, seed: int, name: str, pixels: int = 1000) -> Figure:
    """Three panels: the cones in space, the polhode on the energy ellipsoid, the herpolhode.

    The cones and curves are those of the free motion from the first frame's state; where something acts, the
    true path is drawn as well. ``pixels``: larger side of the drawings' surfaces. Raises
    InputError if the target does not rotate.
    """
    mass = mass_distribution(scene.mass, build_body(scene.body, seed))
    motion = target_motion(scene, mass, seed)
    if not motion.w_P[0].any():
        raise InputError("scene.motion.spin_rpm is zero: a target at rest has neither cones nor polhode")
    geometry = poinsot(mass.moments, motion.w_P[0])
    figure = Figure(figsize=(15.0, 6.4), dpi=DPI * OVERSAMPLING, facecolor="white")
    grid = figure.add_gridspec(1, 3, left=0.01, right=0.985, bottom=0.085, top=0.755, wspace=0.06)
    draw_cones(figure.add_subplot(grid[0]), geometry, pixels)
    path_P = None if is_free(scene.motion) else _true_path(motion, geometry)
    draw_polhode(figure.add_subplot(grid[1]), geometry, path_P, pixels)
    draw_herpolhode(figure.add_subplot(grid[2]), geometry)
    figure.text(0.02, 0.945, headline(geometry, name), fontsize=17, color=INK, weight="bold", va="center")
    figure.text(0.02, 0.893, numbers(geometry), fontsize=11.5, color="#4a5663", va="center")
    return figure


def headline(geometry: Poinsot, name: str) -> str:
    """Headline with the kind of motion."""
    precession = geometry.precession
    if precession.direction == "none":
        return f"{name}: no precession"
    return f"{name}: {precession.direction} precession about the axis of {precession.axis} inertia"


def numbers(geometry: Poinsot) -> str:
    """Rates, wobble, periods and moments, with units."""
    precession = geometry.precession
    rate_rpm = np.linalg.norm(geometry.polhode_P, axis=1) * 60.0 / (2.0 * np.pi)
    moments = " : ".join(f"{value:.3f}" for value in geometry.moments / geometry.moments[1])
    parts = [f"rate {_range(rate_rpm.min(), rate_rpm.max(), 2)} RPM"]
    if precession.direction != "none":
        parts += [
            f"wobble {_range(*precession.wobble_deg, 1)}°",
            f"precession period {precession.precession_period_s:.1f} s",
            f"spin period (polhode) {precession.spin_period_s:.1f} s",
        ]
    return "   ·   ".join([*parts, f"moments {moments}"])


def draw_cones(axes: Axes, geometry: Poinsot, pixels: int) -> None:
    """Body cone and space cone in H at the first frame: they touch along the rate."""
    up = np.array([0.0, 0.0, 1.0])
    drawing = Drawing(np.array([0.12, -1.0, 0.33]), up)
    w_H = geometry.herpolhode_H[0]
    size = float(np.linalg.norm(geometry.herpolhode_H, axis=1).max())
    tips = [(1.3 * size * up, MOMENTUM, "h"), (w_H, RATE, "ω")]
    if geometry.precession.direction != "none":
        drawing.surface(_cone(geometry.around_H), SPACE, 0.72)
        drawing.surface(_cone(geometry.body_cone_H), BODY, 0.42)
        drawing.line(geometry.around_H, "#9a5c0e", 1.6)
        drawing.line(geometry.body_cone_H, "#23508f", 1.6)
        name = {"greatest": "x greatest", "least": "z least"}[geometry.precession.axis]
        tips.append((1.25 * size * geometry.R_HP @ geometry.axis_P, AXIS, name))
    for tip, color, _ in tips:
        drawing.line(_spoke(tip), color, 2.4 if color == RATE else 1.6, 1.0 if color == RATE else 0.55)
    drawing.paint(axes, pixels)
    for tip, color, label in tips:
        _tip(axes, drawing, tip, color, label)
    axes.plot(0, 0, "o", color=INK, ms=4, zorder=6)
    entries = [("space cone, at rest", SPACE), ("body cone, at the first frame", BODY)]
    _caption(
        axes,
        CONES[geometry.precession.direction],
        entries,
        "h angular momentum   ω angular velocity   x, z axes of inertia",
    )


def draw_polhode(axes: Axes, geometry: Poinsot, path_P: Array | None, pixels: int) -> None:
    """Polhode on the ellipsoid of rates of the same energy, in the principal axes."""
    semi = geometry.semi_axes
    towards = _look_at(geometry)
    drawing = Drawing(towards, np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.95 else np.array([1.0, 0, 0]))
    drawing.surface(_ellipsoid(semi), ELLIPSOID, 1.0)
    for curve in polhodes(geometry.moments, geometry.two_energy, 4):
        drawing.line(curve, "#7d8792", 0.7, 0.0)
    for curve in separatrix(geometry.moments, geometry.two_energy):
        drawing.line(curve, INK, 1.0, 0.0)
    if path_P is not None:
        drawing.line(path_P, PATH, 1.2, 0.15)
    drawing.line(geometry.polhode_P, RATE, 2.6, 0.2)
    spikes = [
        (sign * semi * unit, 1.28 * sign * semi * unit, f"{'−' if sign < 0 else ''}{name}")
        for unit, name in zip(np.eye(3), _axis_names(geometry.moments), strict=True)
        for sign in (1.0, -1.0)
    ]
    for root, tip, _ in spikes:
        drawing.line(root + _spoke(tip - root), INK, 1.4, 0.0)
    drawing.paint(axes, pixels)
    seen = drawing.seen(geometry.polhode_P)
    _heading(axes, seen, len(seen) // 8)
    axes.plot(*seen[0, :2], "o", color=RATE, ms=7, mec="white", zorder=6)
    for root, tip, label in spikes:
        if drawing.seen(root)[2] > 0:
            _name_spike(axes, drawing, root, tip, label)
    entries = [("polhode", RATE), ("others of the same energy", "#7d8792")]
    if path_P is not None:
        entries.append(("true path, not free", PATH))
    _caption(axes, "Polhode on the energy ellipsoid", entries, "in the principal axes; dot: first frame")


def draw_herpolhode(axes: Axes, geometry: Poinsot) -> None:
    """Path of the rate in the invariable plane, perpendicular to the angular momentum."""
    plane = np.rad2deg(geometry.herpolhode_H[:, :2])
    once = len(geometry.around_H)
    radius = np.linalg.norm(plane, axis=1)
    axes.plot(plane[once - 1 :, 0], plane[once - 1 :, 1], color=SPACE, lw=0.7, alpha=0.75)
    axes.plot(plane[:once, 0], plane[:once, 1], color=RATE, lw=2.2)
    if geometry.precession.direction != "none":
        _heading(axes, plane, once // 8)
    axes.plot(plane[0, 0], plane[0, 1], "o", color=RATE, ms=7, mec="white", zorder=6)
    axes.plot(0, 0, "+", color=INK, ms=10, mew=1.6)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    for limit in (radius.min(), radius.max()):
        axes.plot(limit * np.cos(turn), limit * np.sin(turn), color=FAINT, lw=0.8, ls=(0, (4, 3)), zorder=0)
    rate = float(np.rad2deg(np.linalg.norm(geometry.herpolhode_H[0])))
    reach = 1.12 * max(float(radius.max()), 0.02 * rate)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.grid(color="#e7eaee", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors="#4a5663", labelsize=9, length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    entries = [("one precession", RATE), ("and on", SPACE)]
    _caption(axes, "Herpolhode in the invariable plane", entries, "rate across h [deg/s]")


def _cone(edge: Array) -> Array:
    """Mantle (rings, n, 3) from the tip at the origin to an edge (n, 3)."""
    return np.asarray(np.linspace(0.0, 1.0, RINGS + 1)[:, None, None] * edge)


def _spoke(tip: Array) -> Array:
    """Points (n, 3) from the origin to a tip (3,)."""
    return np.asarray(np.linspace(0.0, 1.0, 120)[:, None] * tip)


def _ellipsoid(semi: Array) -> Array:
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, 181), np.linspace(0, 2 * np.pi, 361), indexing="ij")
    unit = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return np.asarray(np.stack(unit, axis=-1) * semi)


def _look_at(geometry: Poinsot) -> Array:
    """Direction to the viewer: over the circled axis and the start, from a little above."""
    start = geometry.polhode_P[0] / np.linalg.norm(geometry.polhode_P[0])
    third = np.sign(geometry.polhode_P[0]) + (geometry.polhode_P[0] == 0)
    return np.asarray(0.9 * geometry.axis_P + 0.5 * start + 0.55 * third / np.sqrt(3.0))


def _true_path(motion: TargetMotion, geometry: Poinsot) -> Array:
    """Rate (n, 3) over the frames and the horizon, scaled onto the ellipsoid."""
    t_s = np.linspace(0.0, motion.t_s[-1], 3000)
    _, h_P = rotation_states(motion.forces, motion.h_P[0], t_s)
    w_P = h_P / geometry.moments
    return np.asarray(w_P * np.sqrt(geometry.two_energy / (w_P**2 @ geometry.moments))[:, None])


def _tip(axes: Axes, drawing: Drawing, tip: Array, color: str, label: str) -> None:
    """Head and name of an arrow from the origin."""
    end, before = drawing.seen(tip)[:2], drawing.seen(0.97 * tip)[:2]
    _head(axes, before, end, color)
    unit = end / max(float(np.linalg.norm(end)), 1e-12)
    # The rate is the short arrow between the others: its label goes beside it.
    offset_pt = (9.0, 1.0) if color == RATE else (11 * unit[0], 11 * unit[1])
    side = "center" if abs(unit[0]) < 0.3 and color != RATE else ""
    _label(axes, label, end, offset_pt, side, color)


def _heading(axes: Axes, points: Array, k: int) -> None:
    """An arrowhead on a curve (n, 2 or 3) at its point k."""
    if len(points) > k + 2:
        _head(axes, points[k, :2], points[k + 2, :2], RATE)


def _head(axes: Axes, before: Array, end: Array, color: str) -> None:
    style = {"arrowstyle": "-|>,head_width=0.32,head_length=0.62", "color": color, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (before[0], before[1]), arrowprops=style, zorder=5)


def _axis_names(moments: Array) -> tuple[str, str, str]:
    """Names of the axes; with two equal moments there is no middle axis."""
    if moments[0] == moments[1] or moments[1] == moments[2]:
        return ("x greatest", "y", "z") if moments[1] == moments[2] else ("x", "y", "z least")
    return "x greatest", "y middle", "z least"


def _name_spike(axes: Axes, drawing: Drawing, root: Array, tip: Array, label: str) -> None:
    a, b = drawing.seen(root)[:2], drawing.seen(tip)[:2]
    unit = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
    _label(axes, label, b, (5 * unit[0], 9 * unit[1]), "center" if abs(unit[0]) < 0.5 else "", INK)


def _label(axes: Axes, text: str, at: Array, offset_pt: tuple[float, float], side: str, color: str) -> None:
    """Text beside a point (2,), away from it unless ``side`` is given."""
    axes.annotate(
        text,
        (at[0], at[1]),
        offset_pt,
        textcoords="offset points",
        ha=side or ("left" if offset_pt[0] > 0 else "right"),
        va="center",
        color=color,
        fontsize=10,
        zorder=7,
        path_effects=[withStroke(linewidth=2.5, foreground="white", alpha=0.85)],
    )


def _caption(axes: Axes, title: str, entries: list[tuple[str, str]], below: str) -> None:
    """Title and key above a panel, a line below it, at the same height for all."""
    figure, box = axes.figure, axes.get_position(original=True)
    middle = 0.5 * (box.x0 + box.x1)
    figure.text(middle, 0.815, title, fontsize=12.5, color=INK, ha="center")
    figure.text(middle, 0.022, below, fontsize=9.5, color="#4a5663", ha="center")
    handles = [Patch(facecolor=color, label=text) for text, color in entries]
    figure.legend(
        handles=handles,
        loc="center",
        bbox_to_anchor=(middle, 0.785),
        ncols=len(handles),
        frameon=False,
        fontsize=9.5,
        labelcolor="#4a5663",
        handlelength=0.9,
        handleheight=0.9,
        columnspacing=1.4,
    )


def _range(low: float, high: float, digits: int) -> str:
    a, b = f"{low:.{digits}f}", f"{high:.{digits}f}"
    return a if a == b else f"{a} to {b}"


@default_style
def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG; it is drawn larger and reduced, which smooths the edges of surfaces."""
    large = BytesIO()
    figure.savefig(large, format="png")
    image = Image.open(large).convert("RGB")
    size = (image.width // OVERSAMPLING, image.height // OVERSAMPLING)
    image.resize(size, Image.Resampling.LANCZOS).save(path, optimize=True)


def main() -> None:
    """Write the figure of the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m polhode.simulation.figures.motion_plot", description=__doc__
    )
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FILE.png")
    arguments = parser.parse_args()
    try:
        scene, seed = load_scene(arguments.config)
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        save(motion_figure(scene, seed, arguments.config.stem), arguments.output)
    except InputError as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")


if __name__ == "__main__":
    main()
