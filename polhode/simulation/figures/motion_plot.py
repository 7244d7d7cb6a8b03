"""Cones, polhode and herpolhode of a scene.

``python -m polhode.simulation.figures.motion_plot CONFIG -o FILE.png``
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from polhode.config.scene_settings import Scene
from polhode.geometry.lie import Array
from polhode.runtime.drawing_style import default_style
from polhode.runtime.errors import InputError
from polhode.simulation.bodies import build_body
from polhode.simulation.dataset.plan import load_scene
from polhode.simulation.motion.forces import is_free
from polhode.simulation.motion.mass import mass_distribution
from polhode.simulation.motion.poinsot import (
    Precession,
    circulation_order,
    free_rotation,
    precession_of,
    rotation_states,
    separatrix,
)
from polhode.simulation.motion.target import target_motion

INK, BODY, SPACE, RATE, PATH = "#1c2530", "#3f78c9", "#e2942f", "#c62f4b", "#2a8f5b"
CONES = {
    "prograde": "The body cone rolls beside the space cone",
    "retrograde": "The body cone rolls around the space cone",
    "none": "No cones: a steady spin",
}


@default_style
def motion_figure(scene: Scene, seed: int, name: str) -> Figure:
    """Three panels: the cones in space, the polhode on the energy ellipsoid, the herpolhode.

    The cones and curves are those of the free motion from the first frame's state; where something acts, the
    true path is drawn as well. Raises InputError if the target does not rotate.
    """
    mass = mass_distribution(scene.mass, build_body(scene.body, seed))
    motion = target_motion(scene, mass, seed)
    moments, w_P = mass.moments, motion.w_P[0]
    if not w_P.any():
        raise InputError("scene.motion.spin_rpm is zero: a target at rest has neither cones nor polhode")
    precession, two_energy = precession_of(moments, w_P), float(moments @ w_P**2)
    steady = precession.direction == "none"
    # A steady spin is shown for 10 s.
    period_s, once_s = (10.0, 10.0) if steady else (precession.spin_period_s, precession.precession_period_s)
    t_s = np.concatenate(
        [np.linspace(0.0, once_s, 361), np.linspace(once_s, 12.0 * period_s + once_s, 5000)[1:]]
    )
    R_HP, rates_P = free_rotation(moments, w_P, t_s)
    herpolhode_H = np.einsum("nij,nj->ni", R_HP, rates_P)
    polhode_P = free_rotation(moments, w_P, np.linspace(0.0, period_s, 361))[1]

    figure = Figure(figsize=(15.0, 7.2), facecolor="white", layout="constrained")
    figure.suptitle(f"{headline(precession, name)}\n{numbers(precession, moments, polhode_P)}", color=INK)
    cones, ellipsoid = (figure.add_subplot(1, 3, k, projection="3d") for k in (1, 2))
    assert isinstance(cones, Axes3D) and isinstance(ellipsoid, Axes3D)

    cones.set_title(f"{CONES[precession.direction]}\nh angular momentum, ω angular velocity", pad=40)
    size = float(np.linalg.norm(herpolhode_H, axis=1).max())
    if not steady:
        order = circulation_order(moments, w_P)
        assert order is not None
        axis_H = R_HP[0][:, order[2]] * np.sign(w_P[order[2]])
        edges = ((herpolhode_H[:361], SPACE, "space cone, at rest"),
                 (polhode_P @ R_HP[0].T, BODY, "body cone, at the first frame"))  # fmt: skip
        for edge, color, label in edges:
            mantle = np.linspace(0.0, 1.0, 17)[:, None, None] * edge
            cones.plot_surface(*np.moveaxis(mantle, -1, 0), color=color, alpha=0.4, label=label)
        _arrow(cones, 1.25 * size * axis_H, BODY, f"{'x' if order[2] == 0 else 'z'} {precession.axis}")
    _arrow(cones, np.array([0.0, 0.0, 1.08 * size]), INK, "h")
    _arrow(cones, herpolhode_H[0], RATE, "ω")

    ellipsoid.set_title("Polhode on the energy ellipsoid, in the principal axes", pad=40)
    semi = np.sqrt(two_energy / moments)
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, 60), np.linspace(0, 2 * np.pi, 120), indexing="ij")
    unit = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])
    ellipsoid.plot_surface(*(unit * semi[:, None, None]), color="#d5dae2", alpha=0.35)
    for curve in separatrix(moments, two_energy):
        ellipsoid.plot(*curve.T, color=INK, lw=0.8)
    if not is_free(scene.motion):
        h_P = rotation_states(motion.forces, motion.h_P[0], np.linspace(0.0, motion.t_s[-1], 3000))[1]
        path_P = h_P / moments
        path_P = path_P * np.sqrt(two_energy / (path_P**2 @ moments))[:, None]
        ellipsoid.plot(*path_P.T, color=PATH, lw=1.2, label="true path, not free")
    ellipsoid.plot(*polhode_P.T, color=RATE, lw=2.6, label="polhode")
    ellipsoid.plot(*polhode_P[:1].T, "o", color=RATE, label="first frame")
    for axis, label in zip(np.diag(1.3 * semi), ("x greatest", "y", "z least"), strict=True):
        _arrow(ellipsoid, axis, INK, label)
    for panel in (cones, ellipsoid):
        panel.set_aspect("equal")
        panel.set_axis_off()

    plane = np.rad2deg(herpolhode_H[:, :2])
    flat = figure.add_subplot(1, 3, 3, title="Herpolhode in the invariable plane", aspect="equal",
                              xlabel="rate across h [deg/s]")  # fmt: skip
    flat.plot(*plane[360:].T, color=SPACE, lw=0.7, alpha=0.75, label="and on")
    flat.plot(*plane[:361].T, color=RATE, lw=2.2, label="one precession")
    flat.plot(*plane[:1].T, "o", color=RATE)
    flat.plot(0, 0, "+", color=INK)
    # A steady spin is a point: rounding is not enlarged to a curve.
    reach = 1.12 * max(
        float(np.linalg.norm(plane, axis=1).max()), 0.02 * float(np.rad2deg(np.linalg.norm(w_P)))
    )
    flat.set(xlim=(-reach, reach), ylim=(-reach, reach))
    for panel in (cones, ellipsoid, flat):
        panel.legend(loc="center" if panel is flat else "lower center", frameon=False)
    return figure


def headline(precession: Precession, name: str) -> str:
    """Headline with the kind of motion."""
    if precession.direction == "none":
        return f"{name}: no precession"
    return f"{name}: {precession.direction} precession about the axis of {precession.axis} inertia"


def numbers(precession: Precession, moments: Array, polhode_P: Array) -> str:
    """Rates, wobble, periods and moments, with units."""
    rate_rpm = np.linalg.norm(polhode_P, axis=1) * 60.0 / (2.0 * np.pi)
    parts = [f"rate {rate_rpm.min():.2f} to {rate_rpm.max():.2f} RPM"]
    if precession.direction != "none":
        low_deg, high_deg = precession.wobble_deg
        parts += [
            f"wobble {low_deg:.1f} to {high_deg:.1f}°",
            f"precession period {precession.precession_period_s:.1f} s",
            f"spin period (polhode) {precession.spin_period_s:.1f} s",
        ]
    ratios = " : ".join(f"{value:.3f}" for value in moments / moments[1])
    return "   ·   ".join([*parts, f"moments {ratios}"])


def _arrow(axes: Axes3D, tip: Array, color: str, label: str) -> None:
    """An arrow from the origin, and its name."""
    axes.quiver(0, 0, 0, *tip, color=color, arrow_length_ratio=0.07, lw=1.8)
    axes.text(*(1.06 * tip), label, color=color)


@default_style
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
        motion_figure(scene, seed, arguments.config.stem).savefig(arguments.output, dpi=110)
    except InputError as error:
        parser.exit(error.exit_code, f"{parser.prog}: error: {error}\n")


if __name__ == "__main__":
    main()
