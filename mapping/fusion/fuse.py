"""Depth maps and poses to one surface: the dense half of the pipeline (thesis 6.6)."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, islice

import numpy as np

from polhode.camera import RectifiedRig
from polhode.config.mapping import Mapping
from polhode.lie import Array
from polhode.mapping.fusion.block_grid import BYTES_PER_BLOCK, EDGE
from polhode.mapping.fusion.field import Field
from polhode.progress import Progress, Silent
from polhode.records import DepthMap, SurfaceModel

Frame = tuple[DepthMap, Array]
_PEEK = 5
"""Frames looked at to choose the voxel size."""
_KEPT = 0.25
"""Of the field's memory, for frames that wait for the blocks of later ones."""


def fuse(
    frames: Iterable[Frame],
    rig: RectifiedRig,
    config: Mapping,
    progress: Progress | None = None,
    n_frames: int = 0,
    covariance_G: Array | None = None,
) -> SurfaceModel:
    """Fuse depth maps into a mesh in G.

    frames: pairs of a DepthMap and X_RG (4, 4), the target's pose in the rectified left camera; read once,
    one at a time. Depth or poses with NaN are left out. n_frames: how many are coming, for the progress bar.
    covariance_G (F, 6, 6): of the poses, as ``Field.add`` takes them; None: exact; not finite: unknown.
    Frames whose poses are doubtful are aligned to the surface of the others; ``aligned`` of the result holds
    their poses. Returns an empty mesh when nothing was seen; ``warnings`` of the result tells what is missing
    and why.
    """
    stream = iter(frames)
    head = list(islice(stream, _PEEK))
    field = Field(
        rig, config, choose_voxel_m([frame for frame, _ in head], rig, config), _KEPT * config.memory_mib
    )
    with (progress or Silent()).stage("fusing depth", n_frames) as advance:
        for k, (frame, X_RG) in enumerate(_stepping(chain(head, stream), advance)):
            field.add(frame, X_RG, None if covariance_G is None else covariance_G[k])
    aligned = field.align() if config.align else None
    return replace(field.surface(), aligned=aligned)


def _stepping(frames: Iterable[Frame], advance: object) -> Iterator[Frame]:
    """Pass frames on, advancing the bar after each."""
    for frame in frames:
        yield frame
        if callable(advance):
            advance()


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
    voxel_m = footprint_m
    area_m2 = 6.0 * max(len(d) for d in depths) * footprint_m**2
    # The band around the surface is about three blocks thick.
    blocks = 3.0 * area_m2 / (EDGE * voxel_m) ** 2
    most = config.memory_mib * 2**20 / BYTES_PER_BLOCK
    return float(voxel_m * max(1.0, blocks / most) ** 0.5)
