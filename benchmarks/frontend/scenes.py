"""The scenes on which methods of the front end are compared, and what the simulator knows of their features.

configs/frontend_test/: bodies, a texture generator and Sun directions that training never sees
(docs/training.md), hard light, 30 degrees of turn from frame to frame. Rendered to data/frontend_test/ on
demand; an interrupted rendering goes on.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import ROOT, simulated
from polhode.camera import RectifiedRig
from polhode.config.loader import load_config
from polhode.dataset import StereoSequence, open_sequence
from polhode.frontend.rectification import RectifiedPair, Rectifier, make_rectifier, rectified_pair
from polhode.lie import Array, inverse_pose, transform_points
from polhode.records import Bools
from polhode.simulation.dataset.correspondence import view_of
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.rendering.raycast import RayCaster

CONFIGS = ROOT / "configs" / "frontend_test"
DATA = ROOT / "data" / "frontend_test"
SHORT = ("bus", "dish", "truss")
NEIGHBOURS_PX = np.array([[u, v] for v in (-1.0, 0.0, 1.0) for u in (-1.0, 0.0, 1.0)])
"""A key point on an edge shows any of the surfaces within a pixel of it."""

BRIGHT_DN = 12
"""Grey value above which a pixel is lit [DN]."""
EVERY = 7
"""So many pixels are one sample of the area that is lit in both frames."""
SAME_SURFACE_M = 2e-3
"""A ray of the other camera that ends so near the place sees it [m]."""


def scene_names(short: bool = False) -> list[str]:
    """All scenes, or a few."""
    names = sorted(path.stem for path in CONFIGS.glob("*.yaml"))
    return [name for name in names if name in SHORT] if short else names


def render(name: str) -> Path:
    """The sequence on disk, made if it is missing."""
    return simulated(CONFIGS / f"{name}.yaml", DATA / name)


@dataclass(frozen=True)
class UnseenScene:
    """A rendered scene with the body that was rendered."""

    sequence: StereoSequence
    rectifier: Rectifier
    caster: RayCaster
    X_GR: Array
    """(F, 4, 4) rectified left camera in the frame of the body"""

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def rig(self) -> RectifiedRig:
        return self.rectifier.rig

    def pair(self, k: int) -> RectifiedPair:
        """Rectified images of frame k."""
        return rectified_pair(self.sequence, self.rectifier, k)

    def motion(self, i: int, j: int) -> Array:
        """True X_RiRj (4, 4)."""
        return np.asarray(inverse_pose(self.X_GR[i]) @ self.X_GR[j])

    def body_points(self, k: int, uvd_px: Array) -> tuple[Array, Array]:
        """What the measurements (n, 3) of frame k show: points (n, 3) of the body [m], NaN where only sky is,
        and by how much their disparities are wrong (n,) [px], infinite there.

        Of the surfaces within a pixel, the one that fits the disparity best.
        """
        n, tries = len(uvd_px), len(NEIGHBOURS_PX)
        uv = (uvd_px[:, None, :2] + NEIGHBOURS_PX).reshape(-1, 2)
        p_G, depth_m = self._seen(k, uv)
        rig = self.rig
        disparity = rig.focal_px * rig.baseline_m / depth_m + rig.disparity_offset_px
        error = np.abs(np.repeat(uvd_px[:, 2], tries) - disparity).reshape(n, tries)
        error = np.where(np.isnan(error), np.inf, error)
        # In a tie the feature's own pixel.
        error[:, tries // 2] -= 1e-9
        best = error.argmin(axis=1)
        rows = np.arange(n)
        return p_G.reshape(n, tries, 3)[rows, best], np.maximum(error[rows, best], 0.0)

    def lit_in_both(self, i: int, j: int) -> int:
        """Pixels of frame i that are bright there and, where the body shows the same place, in frame j."""
        bright_i, bright_j = (self.pair(k).left > BRIGHT_DN for k in (i, j))
        v, u = np.nonzero(bright_i)
        p_G, _ = self._seen(i, np.column_stack([u, v])[::EVERY].astype(np.float64))
        return EVERY * int(self._shown(p_G, j, bright_j).sum())

    def shown_in_light(self, p_G: Array, j: int) -> Bools:
        """Whether frame j shows points (n, 3) of the body in the light; not where they are NaN."""
        return self._shown(p_G, j, self.pair(j).left > BRIGHT_DN)

    def _shown(self, p_G: Array, j: int, bright: Bools) -> Bools:
        """Whether frame j shows points (n, 3) at pixels that are ``bright`` (H, W)."""
        shown = np.isfinite(p_G[:, 0])
        uv = np.full((len(p_G), 2), -1.0)
        uv[shown] = self.rig.project(transform_points(inverse_pose(self.X_GR[j]), p_G[shown]))[:, :2]
        pixel = np.round(uv).astype(int)
        shown &= ((pixel >= 0) & (pixel < [self.rig.width_px, self.rig.height_px])).all(axis=1)
        again_G, _ = self._seen(j, uv[shown])
        same = np.linalg.norm(again_G - p_G[shown], axis=1) < SAME_SURFACE_M
        shown[shown] = same & bright[pixel[shown, 1], pixel[shown, 0]]
        return shown

    def _seen(self, k: int, uv_px: Array) -> tuple[Array, Array]:
        """First surface behind pixels (n, 2) of the rectified left image: points (n, 3) in G, depth (n,)."""
        rig, X_GR = self.rig, self.X_GR[k]
        ahead = np.ones(len(uv_px))
        rays_R = np.column_stack([(uv_px - [rig.cx_px, rig.cy_px]) / rig.focal_px, ahead])
        rays_R /= np.linalg.norm(rays_R, axis=1, keepdims=True)
        hits = self.caster.first_hits(X_GR[:3, 3], rays_R @ X_GR[:3, :3].T)
        p_G, depth_m = np.full((len(uv_px), 3), np.nan), np.full(len(uv_px), np.nan)
        p_G[hits.ray] = hits.p_G
        depth_m[hits.ray] = (hits.p_G - X_GR[:3, 3]) @ X_GR[:3, 2]
        return p_G, depth_m


def open_scene(name: str) -> UnseenScene:
    """A scene that is rendered already."""
    return scene_of(CONFIGS / f"{name}.yaml", DATA / name)


def scene_of(path: Path, folder: Path) -> UnseenScene:
    """A sequence with the configuration that it was rendered from."""
    config = load_config(path)
    if config.scene is None:
        raise SystemExit(f"{path}: the configuration has no scene")
    sequence = open_sequence(folder)
    rectifier = make_rectifier(sequence.calibration)
    plan = plan_sequence(config.scene, config.seed)
    # A view's camera is the left one as calibrated, C; a rectifier turns it.
    X_GC = np.array([view_of(plan, k, 0).X_GK for k in range(len(sequence))])
    return UnseenScene(sequence, rectifier, RayCaster(plan.body), X_GC @ rectifier.X_CR)
