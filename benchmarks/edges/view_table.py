"""The metric of a target for views from all around, tabulated, and smooth between the views.

Visibility changes in jumps with the view, and an optimizer needs derivatives. So the metric, with hidden
lines removed and the light of each instant, is computed from directions spread over a sphere around the
target from some ranges. Between them it is a mean with Gaussian weights (Nadaraya and Watson, 1964), which
has all derivatives. The mean is that of log tr (I + C)^-1 (translations in radii, rotations in radians, one
pixel of noise), less its main trend 3 log(range). The camera points at o, the model's centre, with all of the
body in its image: rotations about the optical axis then do not change the metric.

Edges beside faces seen edge-on count here, though a tracker leaves them out (`visible_edges.clear_points`):
that happens in bands that are narrower than the table's steps, and would be smeared over all of it.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import trimesh

from polhode.camera import RectifiedRig
from polhode.errors import InputError
from polhode.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import edge_motion, motion_scale
from polhode.planning.edges.visible_edges import SPACING_PX, contrast, contrast_weight, control_points

RANGES = 4
SUBDIVISIONS = 2
"""Of an icosahedron: 162 directions, 18 degrees apart; 3 makes 642."""
WIDTH = 0.6
"""Sigma of the weights, as a share of the distance between the views."""
TREND = 3.0
"""C falls about as range^-3: f f^T with range^-2, the number of control points with range^-1."""


@dataclass(frozen=True)
class ViewTable:
    """Views from D directions and Q ranges, at T instants (one, if light plays no part)."""

    towards_G: Array
    """(D, 3) unit, from o to the camera"""
    range_m: Array
    """(Q,) evenly spaced in the logarithm"""
    log_trace: Array
    """(T, D Q) less TREND log(range)"""
    spacing_rad: float
    """mean distance of neighbouring directions"""

    def at(self, k: int) -> int:
        """Row of the instant."""
        return k if len(self.log_trace) > 1 else 0

    def weights(self) -> ca.Function:
        """From the camera's position from o along G (3,) [m] to the weights (D Q,) of the views, sum 1."""
        p = ca.SX.sym("p", 3)
        r = ca.norm_2(p)
        near = 1.0 / (WIDTH * self.spacing_rad) ** 2
        of_direction = ca.exp(near * (ca.mtimes(ca.DM(self.towards_G), p / r) - 1.0))
        logs = np.log(self.range_m)
        gap = float(logs[1] - logs[0]) if len(logs) > 1 else 1.0
        of_range = ca.exp(-0.5 * ((ca.log(r) - ca.DM(logs)) / (WIDTH * gap)) ** 2)
        both = ca.vec(ca.mtimes(of_range, of_direction.T))
        return ca.Function("weights", [p], [both / ca.sum1(both)])

    def log_trace_of(self) -> ca.Function:
        """From a position (3,) and a row of ``log_trace`` to log tr (I + C)^-1."""
        p, row = ca.SX.sym("p", 3), ca.SX.sym("row", self.log_trace.shape[1])
        value = ca.dot(self.weights()(p), row) + TREND * ca.log(ca.norm_2(p))
        return ca.Function("log_trace", [p, row], [value])


def view_table(
    model: EdgeModel,
    rig: RectifiedRig,
    range_m: tuple[float, float],
    sun_G: Array | None = None,
    subdivisions: int = SUBDIVISIONS,
    spacing_px: float = SPACING_PX,
) -> ViewTable:
    """Tabulate between two ranges; with sun_G (T, 3) for the light of each instant."""
    low, high = range_m
    if not 0.0 < low < high:
        raise InputError(f"ranges from {low:g} to {high:g} m: give two positive ones, the nearer first")
    sphere = trimesh.creation.icosphere(subdivisions)
    towards = np.asarray(sphere.vertices)
    edges = towards[sphere.edges_unique]
    spacing = float(np.arccos(np.einsum("ek,ek->e", edges[:, 0], edges[:, 1])).mean())
    # one step beyond either end: means at the ends need views on both sides
    step = np.log(high / low) / (RANGES - 1)
    ranges = np.exp(np.log(low) + step * np.arange(-1, RANGES + 1))
    T = 1 if sun_G is None else len(sun_G)
    log_trace = np.empty((T, len(towards), len(ranges)))
    scale = motion_scale(model.radius_m)
    for d, towards_G in enumerate(towards):
        R_RG = camera_attitude(-towards_G, np.array([0.31, 0.52, 0.79]))
        for q, r in enumerate(ranges):
            eye_G = model.centre_G + r * towards_G
            X_RG = make_pose(R_RG, -R_RG @ eye_G)
            points = control_points(model, rig, X_RG, spacing_px)
            f = edge_motion(points, rig, X_RG, model.centre_G) * scale
            weight = np.tile(points.weight, (T, 1))
            if sun_G is not None:
                weight *= np.array([contrast_weight(contrast(model, points, eye_G, sun)) for sun in sun_G])
            C = np.einsum("tm,mi,mj->tij", weight, f, f, optimize=True)
            trace = np.trace(np.linalg.inv(C + np.eye(6)), axis1=1, axis2=2)
            log_trace[:, d, q] = np.log(trace) - TREND * np.log(r)
    return ViewTable(towards, ranges, log_trace.reshape(T, -1), spacing)


def camera_attitude(ahead: Array, up: Array) -> Array:
    """R_RW (3, 3) of a camera that looks along ``ahead`` (3,) in W, its y axis away from ``up`` (3,).

    Where the two are parallel another axis is taken for up.
    """
    z = ahead / np.linalg.norm(ahead)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-6 * np.linalg.norm(up):
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
