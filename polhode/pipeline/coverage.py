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
from polhode.geometry.lie import Array
from polhode.mapping.visibility import MIN_COSINE, Caster, FrameView, pixels_of, towards_G
from polhode.records.mesh_metrics import sample_surface
from polhode.records.surface import SEEN_LIT, SEEN_UNLIT, UNSEEN, SurfaceModel
from polhode.run_directory.summary_schema import Coverage

Classes = NDArray[np.uint8]
SAMPLES = 6000


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
    mesh, unmeasured = surface.mesh, np.flatnonzero(surface.views == 0)
    classes = np.full(len(mesh.vertices), SEEN_LIT, dtype=np.uint8)
    if len(unmeasured):
        p_G, normal_G = (np.asarray(each)[unmeasured] for each in (mesh.vertices, mesh.vertex_normals))
        classes[unmeasured] = classes_of(p_G, normal_G, caster, views, rig)
    return classes


def coverage_of(mesh: trimesh.Trimesh, views: Sequence[FrameView], rig: RectifiedRig) -> Coverage:
    """Shares of the closed mesh's area, or of its hull's, and around which direction most of it lies."""
    closed = bool(mesh.is_volume)
    body = mesh if closed else mesh.convex_hull
    p_G, normal_G = sample_surface(body, SAMPLES)
    classes = classes_of(p_G, normal_G, Caster(body), views, rig)
    of, words = "surface" if closed else "convex hull (the mesh is open)", list[str]()
    share, around = dict[int, float](), dict[int, list[float] | None]()
    for kind, what in ((SEEN_LIT, ""), (UNSEEN, "never seen"), (SEEN_UNLIT, "seen but never lit")):
        part = classes == kind
        share[kind], around[kind] = float(np.mean(part)), None
        if part.any():
            mean = normal_G[part].mean(axis=0)
            length = float(np.linalg.norm(mean))
            # one direction, if the mean normal is at least 0.6 as long as that of a spherical cap
            if length >= max(0.6 * (1.0 - share[kind]), 1e-9):
                around[kind] = [float(each) for each in mean / length]
        if what and share[kind] >= 0.005:
            direction = around[kind]
            where = (
                "" if direction is None else f", mostly around {describe_direction(np.array(direction))} of G"
            )
            words.append(f"{share[kind]:.0%} {'' if words else f'of the {of} '}was {what}{where}")
    unseen = around[UNSEEN]
    return Coverage(
        seen=share[SEEN_LIT],
        seen_unlit=share[SEEN_UNLIT],
        unseen=share[UNSEEN],
        of="mesh" if closed else "hull",
        unseen_direction_G=None if unseen is None else (unseen[0], unseen[1], unseen[2]),
        words="; ".join(words) if words else f"all of the {of} was seen in light",
    )


def warnings_of(coverage: Coverage) -> list[str]:
    """One, where much of the body was never seen or never lit."""
    return [coverage.words] if max(coverage.unseen, coverage.seen_unlit) > 0.15 else []


def describe_direction(direction: Array) -> str:
    """``+x``, or ``+x and -z`` where the direction (3,) lies between axes; the largest part first."""
    unit = np.asarray(direction) / max(float(np.linalg.norm(direction)), 1e-300)
    named = [k for k in np.argsort(-np.abs(unit), kind="stable") if abs(unit[k]) >= 0.5]
    return " and ".join(f"{'+' if unit[k] > 0 else '-'}{'xyz'[k]}" for k in named)
