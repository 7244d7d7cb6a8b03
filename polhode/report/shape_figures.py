"""Figures of the shape, in the geometric frame G: the sparse map and the surface."""

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.visual.color import ColorVisuals

from polhode.geometry.lie import Array, Ints, inverse_pose
from polhode.report import plot_style as style
from polhode.report.plot_style import Figure, Layout, Trace, color_bar, points3d
from polhode.run_directory.stored_run import StoredRun

MAX_FACES = 14_000
"""A denser mesh is thinned for the page; mesh.ply keeps everything."""


def shape_figures(content: StoredRun) -> list[Figure]:
    """Map and mesh: those that exist."""
    figures = []
    if content.landmarks is not None and len(content.landmarks.p_G):
        figures.append(_map(content, 1e3 * content.landmarks.p_G, 1e3 * content.landmarks.sigma_m))
    if content.surface is not None and len(content.surface.mesh.faces):
        figures.append(_mesh(content, content.surface.mesh))
    return figures


def thin_mesh(mesh: trimesh.Trimesh, max_faces: int) -> tuple[Array, Ints, Ints]:
    """At most ``max_faces`` triangles: the vertices of each cell of a grid merge (Rossignac, Borrel 1993).

    Returns vertices (V, 3) in the mesh's unit, faces (T, 3) and, for each new vertex, one old vertex (V,)
    whose colour it takes. The mesh itself when it is small enough.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) <= max_faces:
        return vertices, faces, np.arange(len(vertices))

    def numbers(rows: Ints) -> Ints:
        """One whole number for each row (n, 3): NumPy sorts numbers ten times faster than rows."""
        return np.asarray(np.ravel_multi_index(tuple(rows.T), tuple(rows.max(axis=0, initial=0) + 1)))

    # A surface has about two triangles a cell that it crosses.
    cell = float(np.sqrt(mesh.area / max_faces))
    while True:
        keys = numbers(np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64))
        _, first, group = np.unique(keys, return_index=True, return_inverse=True)
        merged = group[faces]
        merged = merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)]
        _, keep = np.unique(numbers(np.sort(merged, axis=1)), return_index=True)
        if len(keep) <= max_faces:
            break
        cell *= 1.15
    count = np.bincount(group)
    centres = np.stack([np.bincount(group, weights=vertices[:, k]) / count for k in range(3)], axis=1)
    return centres, merged[np.sort(keep)], first


def cameras_in_target(content: StoredRun) -> Array | None:
    """Poses X_GR (F, 4, 4) of the rectified left camera, one per frame."""
    if content.motion is None or content.tracks is None:
        return None
    return np.asarray(inverse_pose(content.motion.X_NG) @ content.tracks.X_NR)


def _map(content: StoredRun, p_mm: Array, sigma_mm: Array) -> Figure:
    known = np.isfinite(sigma_mm)
    top = float(np.quantile(sigma_mm[known], 0.95)) if np.any(known) else 1.0
    marker = {
        "size": 2.6 if len(p_mm) < 3000 else 1.7,
        "color": np.where(known, np.minimum(sigma_mm, top), top),
        **{"colorscale": style.SIGMA_SCALE, "cmin": 0, "cmax": top, "colorbar": color_bar("σ [mm]")},
    }
    hover = "(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>"
    points = points3d(round_to_binary(p_mm), "landmarks", marker=marker, hovertemplate=hover)
    unknown = f" {int(np.sum(~known))} have no determined σ." if not np.all(known) else ""
    median = f" Median σ {np.median(sigma_mm[known]):.2g} mm." if np.any(known) else ""
    caption = (
        f"The {len(p_mm)} landmarks in the geometric frame G, coloured by their standard deviation (scale "
        f"ends at the 95th percentile).{median}{unknown} The lines start at the centre of mass and follow "
        "the principal axes x (largest moment), y, z (smallest)."
    )
    data = [points, *_body_axes(content, p_mm)]
    return Figure("sparse-map", "Sparse map", caption, data, _body_layout(content, data), height_px=560)


def _mesh(content: StoredRun, mesh: trimesh.Trimesh) -> Figure:
    vertices, faces, source = thin_mesh(mesh, MAX_FACES)
    p_mm = 1e3 * vertices
    brightness = stretch_contrast(vertex_rgb(mesh))[source].mean(axis=1).round().astype(np.uint8)
    look = {
        "colorscale": [[0, "#000000"], [1, "#fefefe"]],
        **{"cmin": 0, "cmax": 255, "showscale": False},
        "lighting": {"ambient": 0.75, "diffuse": 0.55, "specular": 0.05, "roughness": 0.9},
        "lightposition": {"x": 1000, "y": -2000, "z": 3000},
    }
    surface = style.mesh3d(round_to_binary(p_mm), faces, "surface", intensity=brightness, **look)
    data = [surface, *_body_axes(content, p_mm), *_cameras(content, p_mm)]
    shown = f"{len(mesh.faces)} triangles."
    if len(faces) < len(mesh.faces):
        shown = f"The page shows {len(faces)} of {len(mesh.faces)} triangles; mesh.ply has all."
    caption = (
        "Fused from the depth maps, with the brightness of the images (without the Sun's shading where its "
        "direction was found), stretched to the full range; lines: principal axes at the centre of mass. The "
        "legend switches on from where the left camera looked at each frame: its direction, close to the "
        f"body, and its position. {shown}"
    )
    return Figure("mesh", "Surface", caption, data, _body_layout(content, data), height_px=520, wide=False)


def round_to_binary(points: Array) -> Array:
    """Points (n, 3) to a power of two below 1/4000 of their extent: their last digits are zeros."""
    extent = float(np.max(np.ptp(points, axis=0), initial=0.0))
    step = 2.0 ** np.floor(np.log2(extent / 4000.0)) if extent > 0.0 else 1.0
    return np.asarray(np.round(points / step) * step)


def vertex_rgb(mesh: trimesh.Trimesh) -> NDArray[np.uint8]:
    """(V, 3); grey where the mesh has no vertex colours."""
    if not isinstance(mesh.visual, ColorVisuals):
        return np.full((len(mesh.vertices), 3), 160, dtype=np.uint8)
    return np.asarray(mesh.visual.vertex_colors, dtype=np.uint8)[:, :3]


def stretch_contrast(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The colours (V, 3) with their 1st and 99th percentiles moved to black and white, and a gamma of 1.4."""
    low, high = np.percentile(rgb, (1, 99))
    share = ((rgb - low) / max(float(high - low), 1.0)).clip(0.0, 1.0)
    return np.asarray(np.round(255.0 * share ** (1 / 1.4)), dtype=np.uint8)


def _body_axes(content: StoredRun, p_mm: Array) -> list[Trace]:
    """Centre of mass, principal axes and, along those where it is undetermined, the range of the centre."""
    if content.motion is None:
        return []
    com_mm, R_GP, intervals = 1e3 * content.motion.com_G, content.motion.R_GP, content.summary.intervals
    length = 0.75 * float(np.median(np.linalg.norm(p_mm - com_mm, axis=1))) * 2.0
    marker = {"size": 6, "color": style.INK, "symbol": "diamond"}
    traces = [points3d(com_mm[None], "centre of mass", marker=marker)]
    shifts = intervals.com_shift_P if intervals is not None else None
    bar = {"mode": "lines", "line": {"color": style.ACCENT, "width": 9}}
    for axis_G, shift in zip(R_GP.T, shifts or (None,) * 3, strict=True):
        if shift is not None:
            ends_mm = com_mm + 1e3 * np.outer(shift, axis_G)
            traces.append(points3d(ends_mm, "centre of mass: possible range", **bar))
    return [*traces, *style.axis_arrows(com_mm, R_GP, length, "xyz")]


def _cameras(content: StoredRun, p_mm: Array) -> list[Trace]:
    X_GR = cameras_in_target(content)
    if X_GR is None or content.motion is None:
        return []
    com_mm, positions_mm = 1e3 * content.motion.com_G, 1e3 * X_GR[:, :3, 3]
    away = positions_mm - com_mm
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    reach = 1.35 * float(np.max(np.linalg.norm(p_mm - com_mm, axis=1)))
    close = com_mm + away / np.maximum(distance, 1e-9) * np.minimum(distance, reach)
    marker = {"size": 3, "color": content.motion.trajectory.time_s, "colorscale": style.TIME_SCALE}
    with_bar = marker | {"colorbar": color_bar("time [s]")}
    return [
        points3d(close, "camera direction", marker=with_bar, visible="legendonly"),
        points3d(positions_mm, "camera position", marker=marker, visible="legendonly"),
    ]


def _body_layout(content: StoredRun, data: list[Trace]) -> Layout:
    """Seen from where the left camera stood at the first frame, so that a side that was seen is in front."""
    X_GR = cameras_in_target(content)
    away = X_GR[0, :3, 3] - content.motion.com_G if X_GR is not None and content.motion else np.zeros(3)
    return style.scene_layout(data, "mm", eye=away) if np.any(away) else style.scene_layout(data, "mm")
