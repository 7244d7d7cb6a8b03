"""A scene on which methods of the front end are compared, and what the simulator knows of their features."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.config.loader import load_config
from polhode.frontend.rectification import RectifiedPair, Rectifier, make_rectifier, rectified_pair
from polhode.geometry.lie import Array, inverse_pose, transform_points
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.raycast import RayCaster

NEIGHBOURS_PX = np.array([[u, v] for v in (-1.0, 0.0, 1.0) for u in (-1.0, 0.0, 1.0)])
"""A key point on an edge shows any of the surfaces within a pixel of it."""
BRIGHT_DN = 12
"""Grey value above which a pixel is lit [DN]."""
EVERY = 7
"""So many pixels are one sample of the area that is lit in both frames."""
SAME_SURFACE_M = 2e-3
"""A ray of the other camera that ends so near the place sees it [m]."""


@dataclass(frozen=True)
class UnseenScene:
    """A rendered sequence with the body that was rendered."""

    sequence: StereoSequence
    rectifier: Rectifier
    caster: RayCaster
    X_GR: Array
    """(F, 4, 4) rectified left camera in the frame of the body"""

    def pair(self, k: int) -> RectifiedPair:
        """Rectified images of frame k."""
        return rectified_pair(self.sequence, self.rectifier, k)

    def rotation(self, i: int, j: int) -> Array:
        """True R_RiRj (3, 3)."""
        return np.asarray((inverse_pose(self.X_GR[i]) @ self.X_GR[j])[:3, :3])

    def body_points(self, k: int, uvd_px: Array) -> tuple[Array, Array]:
        """What the measurements (n, 3) of frame k show: points (n, 3) of the body [m], NaN where only sky is,
        and by how much their disparities are wrong (n,) [px], infinite there.

        Of the surfaces within a pixel, the one that fits the disparity best.
        """
        n, tries = len(uvd_px), len(NEIGHBOURS_PX)
        p_G, depth_m = self._first_surface(k, (uvd_px[:, None, :2] + NEIGHBOURS_PX).reshape(-1, 2))
        rig = self.rectifier.rig
        disparity = rig.focal_px * rig.baseline_m / depth_m + rig.disparity_offset_px
        error = np.abs(np.repeat(uvd_px[:, 2], tries) - disparity).reshape(n, tries)
        error = np.where(np.isnan(error), np.inf, error)
        # In a tie the feature's own pixel.
        error[:, tries // 2] -= 1e-9
        best, rows = error.argmin(axis=1), np.arange(n)
        return p_G.reshape(n, tries, 3)[rows, best], np.maximum(error[rows, best], 0.0)

    def lit_in_both_px(self, i: int, j: int) -> int:
        """Pixels of frame i that are bright there and, where the body shows the same place, in frame j."""
        bright_i, bright_j = (self.pair(k).left > BRIGHT_DN for k in (i, j))
        v, u = np.nonzero(bright_i)
        p_G, _ = self._first_surface(i, np.column_stack([u, v])[::EVERY].astype(np.float64))
        p_G, rig = p_G[np.isfinite(p_G[:, 0])], self.rectifier.rig
        uv = rig.project(transform_points(inverse_pose(self.X_GR[j]), p_G))[:, :2]
        pixel = np.round(uv).astype(int)
        inside = ((pixel >= 0) & (pixel < [rig.width_px, rig.height_px])).all(axis=1)
        again_G, _ = self._first_surface(j, uv[inside])
        same = np.linalg.norm(again_G - p_G[inside], axis=1) < SAME_SURFACE_M
        return EVERY * int((same & bright_j[pixel[inside, 1], pixel[inside, 0]]).sum())

    def _first_surface(self, k: int, uv_px: Array) -> tuple[Array, Array]:
        """Behind pixels (n, 2) of the rectified left image: points (n, 3) in G, depth (n,)."""
        rig, X_GR = self.rectifier.rig, self.X_GR[k]
        rays_R = np.column_stack([(uv_px - [rig.cx_px, rig.cy_px]) / rig.focal_px, np.ones(len(uv_px))])
        rays_R /= np.linalg.norm(rays_R, axis=1, keepdims=True)
        hits = self.caster.first_hits(X_GR[:3, 3], rays_R @ X_GR[:3, :3].T)
        p_G, depth_m = np.full((len(uv_px), 3), np.nan), np.full(len(uv_px), np.nan)
        p_G[hits.ray] = hits.p_G
        depth_m[hits.ray] = (hits.p_G - X_GR[:3, 3]) @ X_GR[:3, 2]
        return p_G, depth_m


def open_scene(config: Path, folder: Path) -> UnseenScene:
    """A sequence with the configuration that it was rendered from."""
    found = load_config(config)
    if found.scene is None:
        raise SystemExit(f"{config}: the configuration has no scene")
    sequence, plan = open_sequence(folder), plan_sequence(found.scene, found.seed)
    rectifier = make_rectifier(sequence.calibration)
    # A view's camera is the left one as calibrated, C; a rectifier turns it.
    X_GC = np.array([view_of(plan, k, 0).X_GK for k in range(len(sequence))])
    return UnseenScene(sequence, rectifier, RayCaster(plan.body), X_GC @ rectifier.X_CR)
