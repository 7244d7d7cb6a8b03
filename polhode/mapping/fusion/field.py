"""Depth maps and poses fused to one surface, the dense half of the pipeline (thesis 6.6).

Frames are added one by one, and moved when their poses improve. The field keeps sums, so a frame can be
removed as it was added. Once poses change, only the frames that moved on the body by more than a part of a
voxel are removed and added again. A motion that all frames share moves the frame G on the body, not the
surface: it is kept as one transform between the field and G.
"""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
import trimesh

from polhode.config.mapping_settings import Mapping
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, inverse_pose, make_pose, transform_points
from polhode.geometry.rigid_fit import mean_rotation
from polhode.mapping.fusion.block_grid import BYTES_PER_BLOCK, EDGE, BlockGrid
from polhode.mapping.fusion.depth_frame import FrameTensors, at_pose, frame_tensors
from polhode.mapping.fusion.frame_alignment import FieldLookup, FrameAlignment, align, depth_points
from polhode.mapping.fusion.integration import allocate, integrate
from polhode.mapping.fusion.surface_extraction import empty_surface, extract_surface
from polhode.mapping.fusion.vertex_sigma import separate_sides, vertex_sigma
from polhode.mapping.fusion.vertex_views import views_of_vertices
from polhode.records.surface import AlignedPoses, DepthMap, SurfaceModel
from polhode.runtime.progress import Progress, Silent

ALIGN_FROM = 0.5
"""A pose is uncertain when its covariance moves the surface by more than this share of the depth's sigma."""
_log = logging.getLogger(__name__)


@dataclass
class _StoredFrame:
    """A frame in the field."""

    tensors: FrameTensors
    X_RF: Array
    """Pose of the field's frame with which it was added"""
    blocks: int
    """Number of the field's blocks, from the first, to which it has been added"""
    X_RG: Array
    """The pose as given"""
    covariance_G: Array | None = None
    """Of that pose; None: too small for an alignment to gain"""


class Field:
    """Depth maps fused in the field's frame F, which differs from G by the later motion common to all poses.

    The depth maps are kept, 0.2 to 1 MB each, so that frames can be moved, and each frame contributes to all
    blocks, also those allocated later. ``kept_mib`` limits this: the oldest are dropped and remain as fused.
    """

    def __init__(
        self, rig: RectifiedRig, config: Mapping, voxel_m: float, kept_mib: float | None = None
    ) -> None:
        self.rig, self.config = rig, config
        self._max_kept = np.inf if kept_mib is None else kept_mib * 2**20
        self.used = self.without_pose = self.without_depth = 0
        self._doubtful: set[int] = set()
        self._voxel_m = voxel_m
        self._grid = self._empty()
        self._kept: dict[int, _StoredFrame] = {}
        self._X_FG = np.eye(4)
        self._frames = self._evicted = 0

    def _empty(self) -> BlockGrid:
        return BlockGrid(self._voxel_m, self.config.memory_mib)

    @property
    def bytes(self) -> int:
        """Memory of the field, without the frames that are kept."""
        return self._grid.bytes

    def add(self, frame: DepthMap, X_RG: Array, covariance_G: Array | None = None) -> bool:
        """Add a frame; false when it has no depth, or no finite pose, and is left out.

        X_RG (4, 4) the target in the rectified left camera; covariance_G (6, 6) of that pose, translation [m]
        and rotation [rad] in G, about its origin: p_R = X_RG (Exp(rotation) p_G + translation); None: exact.
        Where it is not finite, the frame gets a low weight, as if its pose were off by the truncation
        distance in front of the surface, and there is a warning.
        """
        number = self._frames
        self._frames += 1
        if not np.isfinite(X_RG).all():
            self.without_pose += 1
            return False
        known = covariance_G is None or bool(np.isfinite(covariance_G).all())
        # of an unknown pose: with a larger error it would miss the truncation band
        covariance_R = None if known else np.diag([self._grid.front_m**2] * 3 + [0.0] * 3)
        if covariance_G is not None and known:
            covariance_R = _turned(covariance_G, X_RG[:3, :3])
        tensors = frame_tensors(frame, self.rig, covariance_R, X_RG[:3, 3])
        if tensors is None:
            self.without_depth += 1
            return False
        doubtful = known and tensors.doubt > ALIGN_FROM
        if not doubtful:
            tensors = replace(tensors, sigma_m=None)
        X_RF = X_RG @ inverse_pose(self._X_FG)
        kept = _StoredFrame(tensors, X_RF, 0, X_RG, covariance_G if doubtful else None)
        self._put(kept)
        self.used += 1
        if not known:
            self._doubtful.add(number)
        self._kept[number] = kept
        while sum(each.tensors.bytes for each in self._kept.values()) > self._max_kept:
            oldest = self._kept.pop(next(iter(self._kept)))
            self._complete(oldest)
            self._evicted += 1
        return True

    def _put(self, kept: _StoredFrame) -> None:
        allocate(self._grid, kept.tensors, kept.X_RF, self.rig)
        self._complete(kept)

    def _complete(self, kept: _StoredFrame) -> None:
        """Add a frame to the blocks allocated since it was added."""
        most = len(self._grid)
        integrate(self._grid, kept.tensors, kept.X_RF, self.rig, (kept.blocks, most))
        kept.blocks = most

    def move(self, X_RG: Array) -> int:
        """Move the frames to better poses (F, 4, 4); returns how many had to be fused again.

        F: number of frames added, including rejected ones. A frame whose new pose is not finite is removed.
        """
        if self._evicted:
            raise ValueError(f"{self._evicted} frames were dropped and cannot be moved")
        if len(X_RG) != self._frames:
            raise ValueError(f"{len(X_RG)} poses for {self._frames} frames")
        lost = [k for k in self._kept if not np.isfinite(X_RG[k]).all()]
        for k in lost:
            self._remove(self._kept.pop(k))
            self._doubtful.discard(k)
            self.used, self.without_pose = self.used - 1, self.without_pose + 1
        if not self._kept:
            return len(lost)
        numbers = np.array(list(self._kept))
        moved = numbers
        if len(self._grid):
            self._X_FG, moved = self._displaced_frames(numbers, X_RG[numbers])
        if 2 * len(moved) > len(numbers):
            # cheaper than removing and adding
            self._grid, self._X_FG, moved = self._empty(), np.eye(4), numbers
        else:
            for k in moved.tolist():
                self._remove(self._kept[k])
        for k in moved.tolist():
            kept = self._kept[k]
            kept.X_RF, kept.blocks = X_RG[k] @ inverse_pose(self._X_FG), 0
            self._put(kept)
        for k, kept in self._kept.items():
            kept.X_RG = X_RG[k]
        return len(moved) + len(lost)

    def _remove(self, kept: _StoredFrame) -> None:
        integrate(self._grid, kept.tensors, kept.X_RF, self.rig, (0, kept.blocks), remove=True)
        kept.blocks = 0

    def align(self) -> AlignedPoses | None:
        """Align the frames with uncertain poses to the surface that the others show; None: there is none.

        A pose is uncertain when its covariance moves the surface by more than ``ALIGN_FROM`` of the depth's
        own sigma. These frames are all removed; then each, the least uncertain first, is aligned and added,
        and aligned again after the others. Frames that cannot be aligned are added as they were at the end,
        so that no frame is aligned to them.
        """
        doubtful = {k: each for k, each in self._kept.items() if each.covariance_G is not None}
        if not doubtful:
            return None
        for kept in doubtful.values():
            self._remove(kept)
        order = sorted(doubtful, key=lambda k: (doubtful[k].tensors.doubt, k))
        found: dict[int, FrameAlignment] = {}
        for _ in range(2):
            for k in order:
                if k in found:
                    self._remove(doubtful[k])
                aligned = self._aligned(doubtful[k])
                if aligned is not None:
                    found[k] = aligned
                elif k in found:
                    self._put(doubtful[k])
        for k in order:
            if k not in found:
                self._put(doubtful[k])
        frames = sorted(found)
        return AlignedPoses(
            doubtful=len(doubtful),
            frames=np.array(frames, dtype=np.int64),
            X_RG=np.array([found[k].apply(doubtful[k].X_RG) for k in frames]).reshape(-1, 4, 4),
            covariance_G=np.array([found[k].covariance_G for k in frames]).reshape(-1, 6, 6),
        )

    def _aligned(self, kept: _StoredFrame) -> FrameAlignment | None:
        """Align a removed frame to the field and add it; None: refused, and not added."""
        if kept.covariance_G is None:
            return None
        points = depth_points(kept.tensors, kept.X_RG, self.rig)
        # a frame is aligned if at least this share of its depth lies near known surface
        aligned = align(points, kept.covariance_G, self.lookup(), 0.3)
        if aligned.refused is not None:
            _log.debug("a pose is left unchanged: %s", aligned.refused)
            return None
        X_RG = aligned.apply(kept.X_RG)
        covariance_R = _turned(aligned.covariance_G, X_RG[:3, :3])
        kept.tensors = at_pose(kept.tensors, self.rig, covariance_R, X_RG[:3, 3])
        kept.X_RF = X_RG @ inverse_pose(self._X_FG)
        self._put(kept)
        return aligned

    def lookup(self) -> FieldLookup:
        """The present field, interpolated between its voxels."""
        return FieldLookup.of(self._grid, self._X_FG, self.config.carved_share)

    def _displaced_frames(self, numbers: Array, X_RG: Array) -> tuple[Array, Array]:
        """G in F (4, 4) such that few frames are displaced since they were fused, and which those are."""
        X_RF = np.stack([self._kept[int(k)].X_RF for k in numbers])
        # of the box around the blocks
        centres = self._grid.centres_m().numpy().astype(np.float64)
        corners = np.asarray(trimesh.bounds.corners([centres.min(axis=0), centres.max(axis=0)]))
        best = self._X_FG, np.ones(len(numbers), dtype=bool)
        between = inverse_pose(X_RF) @ X_RG
        # When poses improve, a frame is fused again if its pose moves a point of the body by more
        tolerance_m = 0.1 * self._voxel_m
        trial = self._X_FG
        for _ in range(5):
            # by how much the corners are displaced if each frame's G in F is replaced by a common one
            shift = transform_points(between @ inverse_pose(trial), corners) - corners
            displaced_m = np.linalg.norm(shift, axis=-1).max(axis=-1)
            if (displaced_m > tolerance_m).sum() < best[1].sum():
                best = trial, displaced_m > tolerance_m
            # the motion common to most frames, without outliers
            agree = displaced_m <= max(np.median(displaced_m), tolerance_m)
            centre = corners.mean(axis=0)
            R = mean_rotation(between[agree][:, :3, :3])
            at_G = np.mean(transform_points(inverse_pose(between[agree]), centre[None])[:, 0], axis=0)
            # exact at the centre
            trial = make_pose(R, centre - R @ at_G)
        return best[0], numbers[best[1]]

    def surface(self, landmarks_G: Array | None = None) -> SurfaceModel:
        """The mesh in G of the surface that frames agree on, with warnings.

        landmarks_G (L, 3) [m] of the sparse map show how accurate the depth is; None: not known.
        """
        config = self.config
        for kept in self._kept.values():
            self._complete(kept)
        warnings = self._warnings()
        least = min(config.min_views, max(self.used, 1))
        found = extract_surface(self._grid, config, least)
        if self.used > least and found is None:
            # frames that do not overlap
            found = extract_surface(self._grid, config, 1)
            if found is not None:
                warnings.append(
                    f"no part of the surface was seen in {config.min_views} frames: the mesh is what single "
                    "frames saw, and nothing confirms it"
                )
        elif 0 < self.used < config.min_views:
            warnings.append(
                f"the surface is made of {self.used} {'frame' if self.used == 1 else 'frames'}: nothing "
                "confirms its parts, and what they did not see is open"
            )
        if found is None:
            if self.used:
                warnings.append("what the frames agree on is too small for a surface: there is none")
            return empty_surface(tuple(warnings))
        # its sides are separated, and its vertices get sigmas
        cut_m, voxel_m = (self._grid.front_m, self._grid.behind_m), self._voxel_m
        frames = [(kept.tensors, kept.X_RF) for kept in self._kept.values()]
        mesh, normals, noise_m = found.mesh, np.asarray(found.mesh.vertex_normals), found.noise_m
        views = views_of_vertices(frames, self.rig, np.asarray(mesh.vertices), normals, cut_m, voxel_m)
        # enough for the frames' mean to replace that of the field
        if len(frames) >= 0.5 * self.used:
            mesh, noise_m = separate_sides(mesh, noise_m, views)
        landmarks_F = None if landmarks_G is None else transform_points(self._X_FG, landmarks_G)
        sigma_m, errors = vertex_sigma(
            mesh, normals, noise_m, found.single_m, views, landmarks_F, voxel_m, self.config
        )
        mesh.apply_transform(inverse_pose(self._X_FG))
        return SurfaceModel(
            mesh=mesh, sigma_m=sigma_m, views=found.views, warnings=tuple(warnings), errors=errors
        )

    def _warnings(self) -> list[str]:
        out = []
        if self.without_pose:
            out.append(
                f"{self.without_pose} of {self._frames} frames have no finite pose: not in the surface"
            )
        if self._doubtful:
            n, width_mm = len(self._doubtful), self._grid.front_m * 1e3
            out.append(
                f"{n} of {self._frames} frames have a pose of unknown precision: they count as if "
                f"{width_mm:.3g} mm off"
            )
        if self._frames and self.used == 0:
            out.append("no frame has valid depth: there is no surface")
        elif 2 * self.without_depth > self._frames:
            out.append(f"{self.without_depth} of {self._frames} frames have no valid depth")
        if self._grid.refused:
            out.append(
                f"the field of {self.config.memory_mib:.0f} MiB is full and parts of the surface are "
                "missing; larger mapping.memory_mib or mapping.voxel_mm helps"
            )
        return out


def _turned(covariance: Array, R: Array) -> Array:
    """Covariance (6, 6) along other axes."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = R
    return np.asarray(both @ covariance @ both.T)


Frame = tuple[DepthMap, Array]
KEPT_SHARE = 0.25
"""Share of the field's memory for the depth maps that are kept."""


def fuse(
    frames: Iterable[Frame],
    rig: RectifiedRig,
    config: Mapping,
    progress: Progress | None = None,
    n_frames: int = 0,
    covariance_G: Array | None = None,
    landmarks_G: Array | None = None,
) -> SurfaceModel:
    """Fuse depth maps into a mesh in G.

    frames: pairs of a DepthMap and X_RG (4, 4), the target's pose in the rectified left camera; read once,
    one at a time. Depth or poses with NaN are left out. n_frames: how many are coming, for the progress bar.
    covariance_G (F, 6, 6): of the poses, as for ``Field.add``; None: exact; not finite: unknown. Frames with
    uncertain poses are aligned to the surface of the others; ``aligned`` of the result has their poses.
    landmarks_G (L, 3) [m]: the sparse map, which shows how accurate the depth is; None: not known. The mesh
    is empty when nothing was seen; ``warnings`` say what is missing and why.
    """
    stream = iter(frames)
    # the first ones choose the size of a voxel
    head = list(islice(stream, 5))
    voxel_m = choose_voxel_m([frame for frame, _ in head], rig, config)
    field = Field(rig, config, voxel_m, KEPT_SHARE * config.memory_mib)
    with (progress or Silent()).stage("fusing depth", n_frames) as advance:
        for k, (frame, X_RG) in enumerate(chain(head, stream)):
            field.add(frame, X_RG, None if covariance_G is None else covariance_G[k])
            advance()
    aligned = field.align() if config.align else None
    return replace(field.surface(landmarks_G), aligned=aligned)


def choose_voxel_m(frames: list[DepthMap], rig: RectifiedRig, config: Mapping) -> float:
    """Edge of a voxel [m]: the median footprint of a pixel; larger where the field would fill the memory."""
    if config.voxel_mm is not None:
        return config.voxel_mm * 1e-3
    depths = [frame.depth_m[np.isfinite(frame.depth_m) & (frame.depth_m > 0)] for frame in frames]
    depths = [d for d in depths if len(d)]
    if not depths:
        return 1e-3
    z = float(np.median(np.concatenate(depths)))
    footprint_m = z / rig.focal_px
    area_m2 = 6.0 * max(len(d) for d in depths) * footprint_m**2
    # The band around the surface is about three blocks thick.
    blocks = 3.0 * area_m2 / (EDGE * footprint_m) ** 2
    most = config.memory_mib * 2**20 / BYTES_PER_BLOCK
    return float(footprint_m * max(1.0, blocks / most) ** 0.5)
