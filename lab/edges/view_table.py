"""The metric of a target for views from all around, tabulated, and smooth between the views.

Visibility changes in jumps with the view, and an optimizer needs derivatives. So the metric, with hidden
lines removed and the light of each instant, is computed from directions spread over a sphere around the
target from some ranges. Between them it is a mean with Gaussian weights (Nadaraya and Watson, 1964), which
has all derivatives. The mean is that of log tr (I + C)^-1 (translations in radii, rotations in radians, one
pixel of noise), less its main trend 3 log(range). The camera points at o, the model's centre, with all of the
body in its image: rotations about the optical axis then do not change the metric.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import trimesh

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, make_pose
from polhode.planning.edges.edge_model import EdgeModel
from polhode.planning.edges.observability_metric import edge_motion, motion_scale
from polhode.planning.edges.visible_edges import contrast, contrast_weight, control_points

RANGES = 4
SUBDIVISIONS = 2
"""Of an icosahedron: 162 directions, 18 degrees apart"""
WIDTH = 0.6
"""Sigma of the weights, as a share of the distance between the views"""
TREND = 3.0
"""C falls about as range^-3: f f^T with range^-2, the number of control points with range^-1"""


@dataclass(frozen=True)
class ViewTable:
    """Views from D directions and Q ranges, at T instants."""

    towards_G: Array
    """(D, 3) unit, from o to the camera"""
    range_m: Array
    """(Q,) evenly spaced in the logarithm"""
    log_trace: Array
    """(T, D Q) less TREND log(range)"""
    spacing_rad: float
    """mean distance of neighbouring directions"""

    def log_trace_of(self) -> ca.Function:
        """From the camera's position from o along G (3,) and a row of ``log_trace`` to log tr (I + C)^-1."""
        p, row = ca.SX.sym("p", 3), ca.SX.sym("row", self.log_trace.shape[1])
        r = ca.norm_2(p)
        near = 1.0 / (WIDTH * self.spacing_rad) ** 2
        of_direction = ca.exp(near * (ca.mtimes(ca.DM(self.towards_G), p / r) - 1.0))
        logs = np.log(self.range_m)
        of_range = ca.exp(-0.5 * ((ca.log(r) - ca.DM(logs)) / (WIDTH * float(logs[1] - logs[0]))) ** 2)
        both = ca.vec(ca.mtimes(of_range, of_direction.T))
        value = ca.dot(both / ca.sum1(both), row) + TREND * ca.log(r)
        return ca.Function("log_trace", [p, row], [value])


def view_table(model: EdgeModel, rig: RectifiedRig, range_m: tuple[float, float], sun_G: Array) -> ViewTable:
    """Tabulate between two ranges, for the light sun_G (T, 3) of each instant."""
    sphere = trimesh.creation.icosphere(SUBDIVISIONS)
    towards = np.asarray(sphere.vertices)
    edges = towards[sphere.edges_unique]
    spacing = float(np.arccos(np.einsum("ek,ek->e", edges[:, 0], edges[:, 1])).mean())
    low, high = range_m
    # one step beyond either end: means at the ends need views on both sides
    step = np.log(high / low) / (RANGES - 1)
    ranges = np.exp(np.log(low) + step * np.arange(-1, RANGES + 1))
    log_trace = np.empty((len(sun_G), len(towards), len(ranges)))
    scale = motion_scale(model.radius_m)
    for d, towards_G in enumerate(towards):
        R_RG = camera_attitude(-towards_G, np.array([0.31, 0.52, 0.79]))
        for q, r in enumerate(ranges):
            eye_G = model.centre_G + r * towards_G
            X_RG = make_pose(R_RG, -R_RG @ eye_G)
            points = control_points(model, rig, X_RG)
            f = edge_motion(points, rig, X_RG, model.centre_G) * scale
            light = np.array([contrast_weight(contrast(model, points, eye_G, sun)) for sun in sun_G])
            C = np.einsum("tm,mi,mj->tij", points.weight * light, f, f, optimize=True)
            log_trace[:, d, q] = np.log(trace_of_inverse(C)) - TREND * np.log(r)
    return ViewTable(towards, ranges, log_trace.reshape(len(sun_G), -1), spacing)


def trace_of_inverse(C: Array) -> Array:
    """tr (I + C)^-1 (...,) of information C (..., 6, 6) with translations in radii."""
    return np.asarray(np.trace(np.linalg.inv(C + np.eye(6)), axis1=-2, axis2=-1))


def camera_attitude(ahead: Array, up: Array) -> Array:
    """R_RW (3, 3) of a camera that looks along ``ahead`` (3,) in W, its y axis away from ``up`` (3,)."""
    z = ahead / np.linalg.norm(ahead)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-6 * np.linalg.norm(up):
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
