"""Figures of the rotation: the polhode, the inertia ratios, and what a free body conserves."""

import numpy as np
import trimesh

from polhode.geometry.lie import Array
from polhode.geometry.rigid_body import angular_acceleration, angular_momentum_N, rotational_energy
from polhode.report import plot_style as style
from polhode.report.plot_style import ACCENT, FAINT, INK, Figure, Trace
from polhode.run_directory.stored_run import StoredMotion, StoredRun
from polhode.run_directory.summary_schema import Inertia, Summary


def rotation_figures(content: StoredRun) -> list[Figure]:
    """Polhode, inertia ratios, conserved quantities; nothing without an estimate."""
    if content.motion is None:
        return []
    return [_polhode(content.motion), _ratios(content), _conserved(content.motion)]


def torque_free_path(time_s: Array, w_P: Array, moments: Array) -> Array:
    """The path between the frames by Euler's equation, each stretch from the frame before it.

    time_s (F,), w_P (F, 3) [rad/s], moments (3,) -> (S, 3) with S >= F; ends at the last frame. RK4, all
    stretches at once, steps of at most 0.05 rad of rotation.
    """
    dt = np.diff(time_s)
    if len(dt) == 0:
        return w_P
    steps = int(np.clip(np.ceil(np.max(np.linalg.norm(w_P[:-1], axis=1) * dt) / 0.05), 4, 400))
    J, h = np.diag(moments), (dt / steps)[:, None]
    w, path = w_P[:-1], [w_P[:-1]]
    for _ in range(steps - 1):
        a = angular_acceleration(J, w)
        b = angular_acceleration(J, w + 0.5 * h * a)
        c = angular_acceleration(J, w + 0.5 * h * b)
        d = angular_acceleration(J, w + h * c)
        w = w + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        path.append(w)
    return np.concatenate([np.stack(path, axis=1).reshape(-1, 3), w_P[-1:]])


def look_at(w_P: Array) -> Array:
    """A direction (3,) from which the path is in front: over its middle, a little from above."""
    middle = np.mean(w_P / np.maximum(np.linalg.norm(w_P, axis=1, keepdims=True), 1e-300), axis=0)
    start = w_P[0] / max(float(np.linalg.norm(w_P[0])), 1e-300)
    # A path right around the body has no middle: look at its start.
    eye = middle if np.linalg.norm(middle) > 0.2 else start
    return np.asarray(eye / np.linalg.norm(eye) + [0.2, -0.2, 0.2]) if np.any(eye) else np.ones(3)


def _polhode(motion: StoredMotion) -> Figure:
    path, moments = motion.trajectory, motion.moments
    energy = float(np.mean(rotational_energy(np.diag(moments), path.w_P)))
    momentum = float(np.mean(np.linalg.norm(path.w_P * moments, axis=1)))
    # A mesh, not a trace of type "surface", which takes a browser four times as long.
    sphere = trimesh.creation.icosphere(subdivisions=3)
    light = {"ambient": 0.75, "diffuse": 0.5, "specular": 0.05}
    sheet = {"color": style.SHEET, "opacity": 0.35, "lighting": light}
    wires = {"mode": "lines", "line": {"color": style.WIRE, "width": 1.5}, "hoverinfo": "skip"}
    dense = {"mode": "lines", "line": {"color": INK, "width": 4}, "hoverinfo": "skip"}
    scale = {"colorscale": style.TIME_SCALE, "colorbar": style.color_bar("time [s]")}
    dots = {"size": 3.5, "color": path.time_s, **scale}
    now = {"size": 9, "color": style.SECOND, "symbol": "diamond", "line": {"color": INK, "width": 2}}
    w_deg_s, dense_w = np.rad2deg(path.w_P), np.rad2deg(torque_free_path(path.time_s, path.w_P, moments))
    semi_axes = np.rad2deg(np.sqrt(2.0 * energy / moments))
    data = [
        style.mesh3d(sphere.vertices * semi_axes, sphere.faces, "energy ellipsoid", **sheet),
        style.points3d(_grid_of_sphere() * np.rad2deg(momentum / moments), "momentum ellipsoid", **wires),
        style.points3d(dense_w, "path between frames", **dense),
        style.points3d(w_deg_s, "ω at the frames", marker=dots),
        # Moved by the page's slider.
        style.points3d(w_deg_s[:1], "at the time of the slider", marker=now),
    ]
    names = ("ω<sub>x</sub>", "ω<sub>y</sub>", "ω<sub>z</sub>")
    caption = (
        "The path of the angular velocity in the principal axes (dots: frames; line: Euler's equation "
        "from each frame to the next) on the two surfaces that a torque-free body cannot leave: the "
        "ellipsoids of constant energy (surface) and of constant angular momentum (wires), drawn for the "
        "mean of the run. The path lies where they intersect."
    )
    layout = style.scene_layout(data, "deg/s", names, look_at(path.w_P))
    return Figure("polhode", "Polhode", caption, data, layout, height_px=520, wide=False)


def _grid_of_sphere() -> Array:
    """Points (n, 3) of one line along 8 meridians and 7 parallels of the unit sphere, without a gap.

    A gap would be drawn as a point at the origin.
    """
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    angles = [np.stack([turn, np.full_like(turn, azimuth)]) for azimuth in np.arange(8) * np.pi / 8]
    # Down the first meridian, once around at each parallel.
    for level in np.arange(1, 8) * np.pi / 8:
        down = np.linspace(level - np.pi / 8, level, 5)
        angles += [np.stack([down, np.zeros_like(down)]), np.stack([np.full_like(turn, level), turn])]
    polar, azimuth = np.concatenate(angles, axis=1)
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=1)


def _ratios(content: StoredRun) -> Figure:
    inertia, errors = (
        content.summary.inertia,
        (content.metrics.get("error_k1"), content.metrics.get("error_k2")),
    )
    assert inertia is not None
    mean = np.array([inertia.k1, inertia.k2])
    ellipse, box = ratio_ellipse(inertia), ratio_box(content.summary)
    truth = None
    if all(isinstance(error, int | float) for error in errors):
        truth = mean - np.array(errors, dtype=np.float64)
    top = max(2.0, 1.3 * mean[1] if box is None else 1.1 * float(box[:, 1].max()))
    zoom = ellipse if ellipse is not None else mean + 0.15 * np.array([[-1.0, -1.0], [1.0, 1.0]])
    zoom = box if box is not None else zoom
    shown = zoom if truth is None else np.vstack([zoom, truth])
    low, high = shown.min(axis=0), shown.max(axis=0)
    pad = 0.25 * np.maximum(high - low, 1e-6)
    close_up = np.stack([low - pad, high + pad], axis=1).tolist()
    notes = [
        style.note(words, x, 1.0, yanchor="bottom", font={"size": 13})
        for words, x in (("all possible bodies", 0.225), ("close up", 0.785))
    ]
    # A thin disc that is symmetric about its axis has Jxx = 2 Jyy: no body with k2 = 0 lies beyond.
    for x, text, side, shift in ((0, "sphere", "left", 4), (float(np.log(2.0)), "thin disc", "right", -4)):
        place = {"xref": "x", "yref": "y", "xanchor": side, "yanchor": "bottom", "xshift": shift}
        notes.append(style.note(text, x, 0, **place, font={"size": 11, "color": FAINT}))
    layout = style.layout(
        legend=style.layout()["legend"] | {"y": 1.08},
        xaxis=style.axis("k<sub>1</sub> = ln(Jxx / Jyy)", domain=[0, 0.45], range=[0, 0.78], anchor="y"),
        yaxis=style.axis("k<sub>2</sub> = ln(Jyy / Jzz)", range=[0, top], anchor="x"),
        xaxis2=style.axis("k<sub>1</sub>", domain=[0.57, 1], anchor="y2", range=close_up[0]),
        yaxis2=style.axis("k<sub>2</sub>", anchor="x2", range=close_up[1]),
        annotations=notes,
    )
    cross = {"color": INK, "size": 11, "symbol": "x-thin", "line": {"width": 2, "color": INK}}
    data = []
    for panel in (1, 2):
        data += [possible_bodies(panel), *ratio_traces(inertia, "estimate", ACCENT, panel)]
        if box is not None:
            data.append(_area(box, "possible range", ACCENT, panel, 0.12))
        if truth is not None:
            data.append(style.line(truth[:1], truth[1:], "truth", INK, panel, mode="markers", marker=cross))
    words = "Dot: estimate; ellipse: where it is three standard deviations away."
    if ellipse is None:
        words = "The motion does not determine the ratios: the open dot is the best guess and has no ellipse."
    if box is not None:
        words += " Frame: where they can lie, by the bounds named below the table of mass properties."
    if truth is not None:
        words += " Cross: the truth of the simulation."
    caption = (
        "Where the body lies among all rigid bodies. Beyond the curve the largest moment would exceed "
        f"the sum of the other two, which no mass distribution can do (triangle inequality). {words}"
    )
    return Figure("inertia-ratios", "Inertia ratios", caption, data, layout, height_px=460)


def ratio_ellipse(inertia: Inertia) -> Array | None:
    """Points (200, 2) at three standard deviations; None: undetermined."""
    covariance = np.array(inertia.cov, dtype=np.float64)
    if not np.all(np.isfinite(covariance)):
        return None
    return confidence_ellipse(np.array([inertia.k1, inertia.k2]), covariance, 3.0)


def confidence_ellipse(mean: Array, covariance: Array, n_sigma: float) -> Array:
    """Points (200, 2) where the Mahalanobis distance to the mean (2,) is n_sigma."""
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(mean + n_sigma * (circle * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def ratio_box(summary: Summary) -> Array | None:
    """Corners (5, 2), closed, of the intervals of k1 and k2; a determined one has three standard deviations.

    None: there are no intervals.
    """
    inertia, intervals = summary.inertia, summary.intervals
    if inertia is None or intervals is None or (intervals.k1 is None and intervals.k2 is None):
        return None
    sides = []
    for k, name in enumerate(("k1", "k2")):
        value, variance = getattr(inertia, name), inertia.cov[k][k]
        spread = 0.0 if variance is None else 3.0 * float(np.sqrt(variance))
        sides.append(getattr(intervals, name) or (value - spread, value + spread))
    (a, b), (c, d) = sides
    return np.array([[a, c], [b, c], [b, d], [a, d], [a, c]])


def ratio_traces(inertia: Inertia, name: str, color: str, panel: int = 1) -> list[Trace]:
    """A dot for the estimate in its ellipse; an open dot without one where undetermined."""
    ellipse = ratio_ellipse(inertia)
    marker = {"color": color, "size": 9, "symbol": "circle-open" if ellipse is None else "circle"}
    dot = style.line([inertia.k1], [inertia.k2], name, color, panel, mode="markers", marker=marker)
    return [dot] if ellipse is None else [_area(ellipse, "3σ", color, panel, 0.2), dot]


def largest_k1(k2: Array) -> Array:
    """The triangle inequality Jxx <= Jyy + Jzz in the ratios: k1 <= ln(1 + exp(-k2))."""
    return np.asarray(np.log1p(np.exp(-k2)))


def possible_bodies(panel: int) -> Trace:
    """The region of the ratios that the triangle inequality leaves to rigid bodies."""
    k2 = np.linspace(0, 8, 200)
    corners = np.stack([np.concatenate([[0], largest_k1(k2), [0]]), np.concatenate([[0], k2, [8]])], axis=1)
    return _area(corners, "possible bodies", style.REGION, panel, 0.1)


def _area(corners: Array, name: str, color: str, panel: int, alpha: float) -> Trace:
    edge = {"color": color, "width": 1.6}
    fill = style.translucent(color, alpha)
    return style.outline(corners[:, 0], corners[:, 1], name, panel, line=edge, fillcolor=fill)


def _conserved(motion: StoredMotion) -> Figure:
    path, moments, covariance = motion.trajectory, motion.moments, motion.covariance.covariance
    h_P = path.w_P * moments
    energy, momentum = rotational_energy(np.diag(moments), path.w_P), np.linalg.norm(h_P, axis=1)
    h_N = angular_momentum_N(np.diag(moments), path.R_NP, path.w_P)
    mean_h = np.mean(h_N, axis=0)
    # The arctangent keeps its digits at small angles, where the arccosine has none.
    tilt = np.arctan2(np.linalg.norm(np.cross(h_N, mean_h), axis=1), h_N @ mean_h)
    translation = 0.5e6 * np.sum(path.v_N**2, axis=1)

    def sigma(gradient: Array, block: slice) -> Array:
        """Root of g C g (F,) for gradients (F, 3) and a block of the state's covariance."""
        return np.asarray(np.sqrt(np.einsum("fi,fij,fj->f", gradient, covariance[:, block, block], gradient)))

    v, w = slice(3, 6), slice(9, 12)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_h = h_P * moments / momentum[:, None]
        curves = (
            (100 * (energy / energy.mean() - 1), 100 * sigma(h_P, w) / energy.mean(), 0.0),
            (translation, 1e6 * sigma(path.v_N, v), float(np.mean(translation))),
            (100 * (momentum / momentum.mean() - 1), 100 * sigma(slope_h, w) / momentum.mean(), 0.0),
        )
    data = []
    for panel, (value, spread, mean) in enumerate(curves, start=1):
        data.append(style.dashed(path.time_s[[0, -1]], [mean, mean], "mean", panel))
        data += style.line_with_band(path.time_s, value, spread, "estimate", ACCENT, panel)
    data.append(style.line(path.time_s, np.rad2deg(tilt), "estimate", ACCENT, 4))
    titles = [("rotation [%]", "½ v² [mm²/s²]"), ("momentum [%]", "direction [deg]")]
    layout = style.panels(titles, style.TIME_TITLE)
    layout["yaxis4"]["rangemode"] = "tozero"
    caption = (
        "Kinetic energy of the rotation relative to its mean, and of the translation per mass; angular "
        "momentum relative to its mean, and the angle between it in N and its mean direction. Bands: three "
        "standard deviations, from the velocities alone. Without force and torque all are constant: a drift "
        "beyond the bands indicates one, or a wrong inertia."
    )
    title = "Energy and angular momentum"
    return Figure("energy-momentum", title, caption, data, layout, height_px=480, clock="time")
