"""Depth maps and the dense surface.

Frames (docs/notation.md): N inertial, R rectified left camera, G geometric frame of the target, P principal
axes at the centre of mass. ``p_N = X_NG @ p_G``; ``p_G = R_GP @ p_P + com_G``.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.lie import Array, Bools, Ints

UNSEEN, SEEN_UNLIT, SEEN_LIT = 0, 1, 2
"""Classes of coverage: in no frame's view; in view, but never lit; in view and lit."""


@dataclass(frozen=True)
class DepthMap:
    """Dense depth of one frame in the rectified left camera R; often only the target's crop is filled."""

    depth_m: NDArray[np.float32]
    """(H, W), NaN where unknown"""
    sigma_m: NDArray[np.float32]
    """(H, W), NaN where unknown"""
    intensity: NDArray[np.uint8]
    """(H, W) rectified left image"""
    target: Bools
    """(H, W) mask: the target's silhouette (what is outside is free space)"""


@dataclass(frozen=True)
class AlignedPoses:
    """Poses aligned with the surface, of frames whose pose the motion determines poorly."""

    doubtful: int
    """Number of frames with poorly determined poses; those that are not aligned keep theirs"""
    frames: Ints
    """(n,) aligned ones, by the order in which they were added"""
    X_RG: Array
    """(n, 4, 4) the target in the rectified left camera"""
    covariance_G: Array
    """(n, 6, 6) of translation t [m] and rotation a [rad]: p_R = X_RG (Exp(a) p_G + t)"""

    def put_into(self, X_RG: Array) -> Array:
        """All poses (F, 4, 4), those of the aligned frames replaced."""
        out = X_RG.copy()
        out[self.frames] = self.X_RG
        return out


@dataclass(frozen=True)
class ErrorCorrelation:
    """A share of the variance of the vertices' errors that neighbours have in common."""

    share: float
    length_m: float
    """It correlates by exp(-distance / this); inf: all over the body"""


@dataclass(frozen=True)
class SurfaceErrors:
    """How the errors of a surface's vertices belong together."""

    scale: float
    """Noise of the surface over what its depth maps state, by the landmarks"""
    landmarks: int
    """Number of landmarks that were compared with the surface"""
    correlation: tuple[ErrorCorrelation, ...]
    """The shares add up to one"""


@dataclass(frozen=True)
class SurfaceModel:
    """The dense model in G."""

    mesh: trimesh.Trimesh
    """vertex colours set"""
    sigma_m: Array
    """(V,) of the distance along the normal; inf where nothing was measured"""
    views: Ints
    """(V,) frames that saw the vertex; 0 where nothing was measured"""
    invented: Bools | None = None
    """(T,) faces that close a small hole, where nothing was measured; None: there are none"""
    coverage: NDArray[np.uint8] | None = None
    """(V,) UNSEEN, SEEN_UNLIT or SEEN_LIT; None: all was measured, so seen in light"""
    warnings: tuple[str, ...] = ()
    """Missing parts of the surface, and the reason"""
    aligned: AlignedPoses | None = None
    """None: all poses were well determined"""
    errors: SurfaceErrors | None = None
    """How the vertices' errors belong together; None: not known"""

    @property
    def is_invented(self) -> Bools:
        """(T,) ``invented``, none where it is not given."""
        return np.zeros(len(self.mesh.faces), dtype=bool) if self.invented is None else self.invented

    @property
    def coverage_classes(self) -> NDArray[np.uint8]:
        """(V,) ``coverage``, SEEN_LIT where it is not given."""
        full = np.full(len(self.mesh.vertices), SEEN_LIT, dtype=np.uint8)
        return full if self.coverage is None else self.coverage
