"""What the formats are written from. F is the frame of the file: G, P or that of a CAD model."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools, Ints, make_pose, transform_points
from polhode.records.estimate import Landmarks
from polhode.records.surface import SurfaceModel


@dataclass(frozen=True)
class Placement:
    """The frame F in the body."""

    name: str
    """G, P or cad"""
    X_FG: Array
    """(4, 4) p_F = X_FG @ p_G"""
    description: str
    """For the files' comments"""

    @property
    def R_FG(self) -> Array:
        """(3, 3)"""
        return np.asarray(self.X_FG[:3, :3])


@dataclass(frozen=True)
class ExportShape:
    """A surface in F [m]; without faces a point cloud."""

    vertices: Array
    """(V, 3)"""
    faces: Ints
    """(T, 3)"""
    normals: Array
    """(V, 3) unit, or zero where there is none"""
    rgba: NDArray[np.uint8]
    """(V, 4)"""
    sigma_m: Array
    """(V,) inf where nothing was measured"""
    views: Ints
    """(V,) frames that saw the vertex"""
    coverage: NDArray[np.uint8]
    """(V,) 0 never seen, 1 seen but never lit, 2 seen in light"""
    invented: Bools
    """(T,) faces that close a small hole"""

    def mesh(self) -> trimesh.Trimesh:
        """The geometry alone."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)


@dataclass(frozen=True)
class Inertial:
    """Mass and inertia as the files have them, and their origin."""

    mass_kg: float
    com_F: Array
    """(3,) [m]"""
    R_FP: Array
    """(3, 3) principal axes"""
    moments_kg_m2: Array
    """(3,) about the centre of mass, along the axes of P"""
    mass_is: str
    """given, determined, assumed or relative"""
    scale_is: str
    """determined, given, assumed or relative: that of the moments"""
    notes: tuple[str, ...]
    """Origin of each number and what was assumed, a sentence each"""
    restated: tuple[str, ...] = ()
    """Those of the notes that only repeat what the user gave"""

    @property
    def X_FP(self) -> Array:
        """(4, 4)"""
        return make_pose(self.R_FP, self.com_F)


@dataclass(frozen=True)
class LastState:
    """The last state of a run."""

    timestamp_ns: int
    X_NF: Array
    """(4, 4)"""
    v_N: Array
    """(3,) velocity of the origin of F [m/s]"""
    w_F: Array
    """(3,) angular velocity, in F [rad/s]"""


def shape_of_surface(surface: SurfaceModel, at: Placement) -> ExportShape:
    """The dense model in F."""
    mesh = surface.mesh
    colours = getattr(mesh.visual, "vertex_colors", np.full((1, 4), 128))
    return ExportShape(
        transform_points(at.X_FG, np.asarray(mesh.vertices)),
        np.asarray(mesh.faces, dtype=np.int64),
        np.asarray(mesh.vertex_normals) @ at.R_FG.T,
        np.broadcast_to(np.asarray(colours, dtype=np.uint8), (len(mesh.vertices), 4)),
        surface.sigma_m,
        surface.views,
        surface.coverage_classes,
        surface.is_invented,
    )


def shape_of_landmarks(landmarks: Landmarks, at: Placement) -> ExportShape:
    """The sparse map in F: points without faces."""
    count = len(landmarks.p_G)
    return ExportShape(
        transform_points(at.X_FG, landmarks.p_G),
        np.zeros((0, 3), dtype=np.int64),
        np.zeros((count, 3)),
        np.tile(np.array([160, 160, 160, 255], dtype=np.uint8), (count, 1)),
        landmarks.sigma_m,
        landmarks.observations,
        np.full(count, 2, dtype=np.uint8),
        np.zeros(0, dtype=bool),
    )
