"""How much of the body was seen, seen but never lit, and never seen: from poses, images and the mesh itself.

Points spread over the surface are tested in each frame: inside the image, not occluded (rays), not edge-on;
and the image brighter there than the sky. Where the mesh is open its convex hull replaces the unknown
surface; self-shadowing and concavities cannot be distinguished then.
"""

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import NDArray

from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, Bools
from polhode.mapping.visibility import MIN_COSINE, Caster, FrameView, pixels_of, towards_G
from polhode.records.mesh_metrics import sample_surface
from polhode.records.surface import SEEN_LIT, SEEN_UNLIT, UNSEEN, SurfaceModel
from polhode.run_directory.summary_schema import Coverage

Classes = NDArray[np.uint8]

SAMPLES = 6000
MIN_ONE_SIDED = 0.6
"""A part faces one direction if its mean normal is at least this long, relative to a spherical cap."""


def classes_of(
    p_G: Array, normal_G: Array, caster: Caster, views: Sequence[FrameView], rig: RectifiedRig
) -> Classes:
    """(n,) UNSEEN, SEEN_UNLIT or SEEN_LIT of points (n, 3) of the caster's mesh, normals outwards."""
    found = np.full(len(p_G), UNSEEN, dtype=np.uint8)
    for view in views:
        open_ = np.flatnonzero(found != SEEN_LIT)
        row, column, inside = pixels_of(view, p_G[open_], rig)
        cosine = np.einsum("nk,nk->n", towards_G(view, p_G[open_]), normal_G[open_])
        inside &= cosine > MIN_COSINE
        at, row, column = open_[inside], row[inside], column[inside]
        seen = caster.sees(view.eye_G, p_G[at], normal_G[at])
        lit = view.smooth[row, column] > view.lit_above
        found[at[seen & lit]] = SEEN_LIT
        found[at[seen & ~lit]] = SEEN_UNLIT
    return found


def with_classes(
    surface: SurfaceModel, views: Sequence[FrameView], rig: RectifiedRig, caster: Caster
) -> Classes:
    """(V,) classes of the vertices: measured ones were seen lit; the others are tested in every frame."""
    classes = np.full(len(surface.mesh.vertices), SEEN_LIT, dtype=np.uint8)
    unmeasured = np.flatnonzero(surface.views == 0)
    if len(unmeasured):
        p_G = np.asarray(surface.mesh.vertices)[unmeasured]
        normal_G = np.asarray(surface.mesh.vertex_normals)[unmeasured]
        classes[unmeasured] = classes_of(p_G, normal_G, caster, views, rig)
    return classes


def coverage_of(mesh: trimesh.Trimesh, views: Sequence[FrameView], rig: RectifiedRig) -> Coverage:
    """Shares of the closed mesh's area, or of its hull's."""
    closed = bool(mesh.is_volume)
    body = mesh if closed else mesh.convex_hull
    p_G, normal_G = sample_surface(body, SAMPLES)
    classes = classes_of(p_G, normal_G, Caster(body), views, rig)
    share = [float(np.mean(classes == kind)) for kind in (SEEN_LIT, SEEN_UNLIT, UNSEEN)]
    around = _common_direction(normal_G, classes == UNSEEN)
    return Coverage(
        seen=share[0],
        seen_unlit=share[1],
        unseen=share[2],
        of="mesh" if closed else "hull",
        unseen_direction_G=None if around is None else (around[0], around[1], around[2]),
        words=_words(share, around, _common_direction(normal_G, classes == SEEN_UNLIT), closed),
    )


def warnings_of(coverage: Coverage) -> list[str]:
    """One, where much of the body was never seen or never lit."""
    return [coverage.words] if max(coverage.unseen, coverage.seen_unlit) > 0.15 else []


def _common_direction(normals: Array, part: Bools) -> list[float] | None:
    """The unit vector around which a part of the points (n,) faces, or None: it faces all around."""
    if not part.any():
        return None
    mean = normals[part].mean(axis=0)
    length = float(np.linalg.norm(mean))
    return (
        None
        if length < max(MIN_ONE_SIDED * (1.0 - float(np.mean(part))), 1e-9)
        else [float(part) for part in mean / length]
    )


def _words(
    share: Sequence[float], unseen: list[float] | None, unlit: list[float] | None, closed: bool
) -> str:
    of = "surface" if closed else "convex hull (the mesh is open)"
    parts: list[str] = []
    for part, around, what in ((share[2], unseen, "never seen"), (share[1], unlit, "seen but never lit")):
        if part >= 0.005:
            where = (
                f", mostly around {describe_direction(np.array(around))} of G" if around is not None else ""
            )
            parts.append(f"{part:.0%} {'' if parts else f'of the {of} '}was {what}{where}")
    return "; ".join(parts) if parts else f"all of the {of} was seen in light"


MIN_AXIS_SHARE = 0.5
"""Share of its length that a direction must have along an axis for the axis to be named."""


def describe_direction(direction: Array) -> str:
    """``+x``, or ``+x and -z`` where the direction (3,) lies between axes; the largest part first."""
    unit = np.asarray(direction) / max(float(np.linalg.norm(direction)), 1e-300)
    named = [k for k in np.argsort(-np.abs(unit), kind="stable") if abs(unit[k]) >= MIN_AXIS_SHARE]
    return " and ".join(f"{'+' if unit[k] > 0 else '-'}{'xyz'[k]}" for k in named)
