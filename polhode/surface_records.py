"""Records of depth and surface (a part of ``polhode.records``, which is what to import)."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.lie import Array

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

UNSEEN, SEEN_UNLIT, SEEN_LIT = 0, 1, 2
"""Classes of coverage: no frame saw it; frames saw it, but never in light; seen in light."""


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
    """Poses that the surface tells better than the motion did: of frames that the motion knows poorly."""

    doubtful: int
    """Frames whose poses were worth it; those that are not aligned keep theirs"""
    frames: Ints
    """(n,) aligned ones, by the order in which they were added"""
    X_RG: Array
    """(n, 4, 4) the target in the rectified left camera"""
    covariance_G: Array
    """(n, 6, 6) p_R = X_RG (Exp(turn) p_G + shift): shift [m], turn [rad]"""

    def put_into(self, X_RG: Array) -> Array:
        """All poses (F, 4, 4), those of the aligned frames replaced."""
        out = X_RG.copy()
        out[self.frames] = self.X_RG
        return out


@dataclass(frozen=True)
class SurfaceModel:
    """The dense model in G."""

    mesh: trimesh.Trimesh
    """vertex colours set"""
    sigma_m: Array
    """(V,) inf where nothing was measured"""
    views: Ints
    """(V,) frames that saw the vertex; 0 where nothing was measured"""
    invented: Bools | None = None
    """(T,) faces that close a small hole, where nothing was measured; None: there are none"""
    coverage: NDArray[np.uint8] | None = None
    """(V,) UNSEEN, SEEN_UNLIT or SEEN_LIT; None: all was measured, so seen in light"""
    warnings: tuple[str, ...] = ()
    """What is missing of the surface, and why"""
    aligned: AlignedPoses | None = None
    """None: no pose was in doubt"""

    @property
    def is_invented(self) -> Bools:
        """(T,) ``invented``, none where it is not given."""
        return np.zeros(len(self.mesh.faces), dtype=bool) if self.invented is None else self.invented

    @property
    def coverage_classes(self) -> NDArray[np.uint8]:
        """(V,) ``coverage``, SEEN_LIT where it is not given."""
        full = np.full(len(self.mesh.vertices), SEEN_LIT, dtype=np.uint8)
        return full if self.coverage is None else self.coverage
