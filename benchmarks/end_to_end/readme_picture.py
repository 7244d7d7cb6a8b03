"""The README's picture: what a camera saw, the surface in the same view, the polhode. Made from a run alone.

    python benchmarks/end_to_end/readme_picture.py RUN SEQ -o docs/images/overview.png [--frame K]

Left: the left image with the stereo measurements of one frame (inliers), and streaks along which the
estimated motion has carried them. Middle: RUN/mesh.ply seen by the same camera from the estimated pose.
Right: the path of the angular velocity on the ellipsoid of equal energy; fine lines: other angular momenta.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from trimesh.ray.ray_pyembree import RayMeshIntersector
from trimesh.triangles import points_to_barycentric
from tyro.conf import Positional, arg

from benchmarks.command import command
from polhode.camera import RectifiedRig
from polhode.dataset import open_sequence
from polhode.errors import InputError
from polhode.frontend.rectification import Crop, make_rectifier, rectified_pair, target_crop
from polhode.lie import Array, exp_so3, inverse_pose, transform_points
from polhode.pipeline.report.plot_style import TIME_SCALE
from polhode.pipeline.report.polhode_and_inertia_figures import look_at, torque_free_path
from polhode.pipeline.report.shape_figures import stretch_contrast, vertex_rgb
from polhode.pipeline.report.tables import finding
from polhode.pipeline.run_directory.stored_run import StoredMotion, StoredRun, read_stored_run
from polhode.records import Bools

SIDE_PX, GAP_PX, CAPTION_PX, FINE = 520, 18, 64, 2
"""Panel, space, text below; panels are drawn FINE times larger and shrunk, which smooths every edge."""
PAPER, INK, SOFT = (13, 17, 23), (230, 237, 243), (139, 148, 158)
STREAK_S = 0.12
INLIER_WEIGHT = 0.5

Picture = NDArray[np.uint8]


def main(
    run: Positional[Path],
    sequence: Positional[Path],
    output: Annotated[Path, arg(aliases=["-o"], metavar="PNG", help="Picture.")] = Path(
        "docs/images/overview.png"
    ),
    frame: Annotated[
        int | None, arg(help="Frame to show; without it the one with the most measurements.")
    ] = None,
) -> None:
    """Read a run and its sequence, draw, write."""
    content = read_stored_run(run, run.name)
    output.parent.mkdir(parents=True, exist_ok=True)
    overview(content, sequence, frame).save(output, optimize=True)
    print(f"{output}: {output.stat().st_size / 1e3:.0f} kB")


def overview(content: StoredRun, sequence: Path, frame: int | None) -> Image.Image:
    """The three panels with their captions. Raises InputError when the run has no estimate or no surface."""
    if content.motion is None or content.tracks is None or content.surface is None:
        raise InputError(f"{content.name}: the picture needs a run with an estimate and a surface")
    counts = np.bincount(content.tracks.frame, minlength=content.tracks.n_frames)
    k = int(np.argmax(counts)) if frame is None else frame
    images = open_sequence(sequence)
    rectifier = make_rectifier(images.calibration)
    pair = rectified_pair(images, rectifier, k)
    whole = Crop(0, 0, pair.left.shape[1], pair.left.shape[0])
    crop = square_around(target_crop(pair.mask_left, margin_px=14) or whole)
    panels = [
        _tracks(content, k, pair.left, crop),
        surface_panel(content, k, rectifier.rig, crop),
        _polhode(content.motion),
    ]
    return _sheet(panels, content)


def _sheet(panels: Sequence[Picture], content: StoredRun) -> Image.Image:
    assert content.motion is not None and content.surface is not None
    titles = ("stereo measurements", "reconstructed surface, same view", "polhode")
    summary, time_s = content.summary, content.motion.trajectory.time_s
    details = (
        f"{summary.observations} measurements of {summary.landmarks} landmarks in {summary.frames} frames",
        f"{len(content.surface.mesh.faces)} triangles, fused with the estimated motion",
        f"path of the angular velocity in the body, 0 s (dark) to {time_s[-1]:.0f} s (bright)",
    )
    width, top = 3 * SIDE_PX + 4 * GAP_PX, GAP_PX + 34
    sheet = Image.new("RGB", (width, top + SIDE_PX + CAPTION_PX), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text(
        (GAP_PX, 14), finding(content.summary, content.motion.trajectory), INK, ImageFont.load_default(19)
    )
    for column, (panel, title, detail) in enumerate(zip(panels, titles, details, strict=True)):
        left = GAP_PX + column * (SIDE_PX + GAP_PX)
        small = cv2.resize(panel, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
        sheet.paste(Image.fromarray(small), (left, top))
        draw.text((left + 2, top + SIDE_PX + 8), title, INK, ImageFont.load_default(19))
        draw.text((left + 2, top + SIDE_PX + 33), detail, SOFT, ImageFont.load_default(16))
    return sheet


def square_around(crop: Crop) -> Crop:
    """The square around a crop, which may reach beyond the image."""
    side = max(crop.width_px, crop.height_px)
    u0 = (crop.u0 + crop.u1 - side) // 2
    v0 = (crop.v0 + crop.v1 - side) // 2
    return Crop(u0, v0, u0 + side, v0 + side)


def _tracks(content: StoredRun, k: int, left: Picture, crop: Crop) -> Picture:
    """The crop of the left image with its inliers and their streaks."""
    assert content.motion is not None and content.tracks is not None
    tracks, zoom = content.tracks, FINE * SIDE_PX / crop.width_px
    pad = max(0, -crop.u0, -crop.v0, crop.u1 - left.shape[1], crop.v1 - left.shape[0])
    padded = cv2.copyMakeBorder(left, pad, pad, pad, pad, cv2.BORDER_CONSTANT)
    patch = padded[crop.v0 + pad : crop.v1 + pad, crop.u0 + pad : crop.u1 + pad]
    size = (FINE * SIDE_PX, FINE * SIDE_PX)
    canvas = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_CUBIC), cv2.COLOR_GRAY2RGB)
    here = tracks.frame == k
    if content.residuals is not None:
        here &= content.residuals.inlier_weight > INLIER_WEIGHT
    p_N = transform_points(tracks.X_NR[k], tracks.rig.triangulate(tracks.uvd_px[here]))
    for step in np.linspace(-STREAK_S, 0.0, 7):
        start = _pixels(_carried(content.motion, k, p_N, step - STREAK_S / 6), content, k, crop, zoom)
        end = _pixels(_carried(content.motion, k, p_N, step), content, k, crop, zoom)
        color = np.multiply((80, 235, 150), 0.35 + 0.65 * (1 + step / STREAK_S)).astype(int).tolist()
        for a, b in zip(start.tolist(), end.tolist(), strict=True):
            cv2.line(canvas, a, b, color, FINE, cv2.LINE_AA)
    for place in _pixels(p_N, content, k, crop, zoom).tolist():
        cv2.circle(canvas, place, 2 * FINE, (190, 255, 215), -1, cv2.LINE_AA)
    # Black sky takes the colour of the ground.
    return np.maximum(canvas, np.array(PAPER, dtype=np.uint8))


def _carried(motion: StoredMotion, k: int, p_N: Array, dt_s: float) -> Array:
    """Points (n, 3) of the body where the estimated motion has them dt_s later."""
    path = motion.trajectory
    w_N = path.R_NP[k] @ path.w_P[k]
    turned = (p_N - path.r_N[k]) @ exp_so3(w_N * dt_s).T
    return np.asarray(path.r_N[k] + path.v_N[k] * dt_s + turned)


def _pixels(p_N: Array, content: StoredRun, k: int, crop: Crop, zoom: float) -> NDArray[np.int64]:
    assert content.tracks is not None
    uv = content.tracks.rig.project(transform_points(inverse_pose(content.tracks.X_NR[k]), p_N))[:, :2]
    return np.asarray(np.round((uv - [crop.u0, crop.v0] + 0.5) * zoom - 0.5), dtype=np.int64)


def surface_panel(
    content: StoredRun, k: int, rig: RectifiedRig, crop: Crop, side: int = FINE * SIDE_PX
) -> Picture:
    """The mesh in its colours, lit a little from the camera, by one ray per fine pixel."""
    assert content.motion is not None and content.tracks is not None and content.surface is not None
    mesh = content.surface.mesh
    X_GR = inverse_pose(content.motion.X_NG[k]) @ content.tracks.X_NR[k]
    place = (np.arange(side) + 0.5) * crop.width_px / side - 0.5
    u, v = np.meshgrid(crop.u0 + place, crop.v0 + place)
    ray_R = np.stack(
        [(u - rig.cx_px) / rig.focal_px, (v - rig.cy_px) / rig.focal_px, np.ones_like(u)], axis=-1
    )
    ray_G = ray_R.reshape(-1, 3) @ X_GR[:3, :3].T
    ray_G /= np.linalg.norm(ray_G, axis=1, keepdims=True)
    eye_G = np.broadcast_to(X_GR[:3, 3], ray_G.shape)
    caster = RayMeshIntersector(mesh, scale_to_box=False)
    face, index, hit = caster.intersects_id(eye_G, ray_G, multiple_hits=False, return_locations=True)
    corners = np.clip(points_to_barycentric(mesh.triangles[face], hit), 0.0, 1.0)
    corners /= corners.sum(axis=1, keepdims=True)
    rgb = stretch_contrast(vertex_rgb(mesh)) / 255.0
    color = np.einsum("nc,nck->nk", corners, rgb[mesh.faces[face]])
    normal = np.einsum("nc,nck->nk", corners, mesh.vertex_normals[mesh.faces[face]])
    facing = np.abs(np.sum(normal * ray_G[index], axis=1)) / np.linalg.norm(normal, axis=1)
    canvas = np.full((side * side, 3), PAPER, dtype=np.uint8)
    canvas[index] = np.clip(255 * (0.06 + 0.94 * color**1.3) * (0.4 + 0.6 * facing)[:, None], 0, 255)
    return canvas.reshape(side, side, 3)


@dataclass(frozen=True)
class EllipsoidPicture:
    """The ellipsoid of equal energy, and how points of the body are drawn on it."""

    picture: Picture
    semi: Array
    """(3,) half axes [rad/s]"""
    R_VP: Array
    """(3, 3) axes of the view: to the right, up, to the eye"""
    scale: float
    """Fine pixels for 1 rad/s"""

    def project(self, w_P: Array) -> tuple[NDArray[np.int64], Bools]:
        """Fine pixels (n, 2) of angular velocities (n, 3), and whether they are on the near side."""
        on_surface = w_P / np.sqrt(np.sum((w_P / self.semi) ** 2, axis=1, keepdims=True))
        in_front = (on_surface / self.semi**2) @ self.R_VP[2] > 0.0
        return _on_paper(on_surface, self.R_VP, self.scale, len(self.picture)), in_front


def energy_ellipsoid(
    w_P: Array, moments: Array, eye_P: Array, side: int = FINE * SIDE_PX
) -> EllipsoidPicture:
    """With lines of constant angular momentum and the axes that face the eye.

    w_P (F, 3) [rad/s] gives the energy; moments (3,); eye_P (3,) is the direction from which it is
    seen; side: of the picture [px].
    """
    energy = 0.5 * float(np.mean(np.sum(w_P**2 * moments, axis=1)))
    semi = np.sqrt(2.0 * energy / moments)
    R_VP = _view(eye_P)
    scale = 0.34 * side / float(semi.max())
    canvas = _ellipsoid(semi, moments, R_VP, scale, side)
    for k, name in enumerate("xyz"):
        for sign in (-1.0, 1.0):
            tip = sign * np.eye(3)[k] * semi[k]
            ends = _on_paper(np.stack([tip, 1.17 * tip]), R_VP, scale, side)
            if (R_VP @ tip)[2] < 0:
                continue
            cv2.line(canvas, ends[0].tolist(), ends[1].tolist(), SOFT, 2 * FINE - 1, cv2.LINE_AA)
            _letter(canvas, f"{'-' if sign < 0 else ''}{name}", ends[1])
    return EllipsoidPicture(canvas, semi, R_VP, scale)


def _polhode(motion: StoredMotion) -> Picture:
    """The energy ellipsoid with lines of constant angular momentum, and the path of the run on it."""
    path = motion.trajectory
    ellipsoid = energy_ellipsoid(path.w_P, motion.moments, look_at(path.w_P))
    places, in_front = ellipsoid.project(torque_free_path(path.time_s, path.w_P, motion.moments))
    colors, canvas = _time_colors(np.linspace(0.0, 1.0, len(places) - 1)), ellipsoid.picture.copy()
    for a, b, near, color in zip(
        places[:-1].tolist(), places[1:].tolist(), in_front[:-1].tolist(), colors, strict=True
    ):
        behind = 0.3 * np.array(color) + 0.7 * np.array((86, 84, 110))
        shade = color if near else behind.astype(int).tolist()
        cv2.line(canvas, a, b, shade, (5 if near else 2) * FINE, cv2.LINE_AA)
    return canvas


def _ellipsoid(semi: Array, moments: Array, R_VP: Array, scale: float, side: int) -> Picture:
    """An orthographic view along -z of V; fine lines where h^2 / 2E takes evenly spaced values."""
    place = (np.arange(side) + 0.5 - side / 2) / scale
    x, y = np.meshgrid(place, -place)
    # Points o + t d with o = (x, y, 0) and d = (0, 0, 1) in V on |p / semi| = 1: a quadratic in t.
    origin = np.stack([x, y, np.zeros_like(x)], axis=-1) @ R_VP / semi
    d = R_VP[2] / semi
    a, b, c = d @ d, origin @ d, np.sum(origin**2, axis=-1) - 1.0
    inside = b * b - a * c
    hit = inside > 0.0
    unit = origin + ((-b + np.sqrt(np.maximum(inside, 0.0))) / a)[..., None] * d
    normal = unit / semi
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = np.clip(normal @ (R_VP.T @ np.array([-0.4, 0.55, 0.73])), 0.0, 1.0)
    level = np.sum(unit**2 * moments, axis=-1)
    steps = (level - moments[1]) / (moments[0] - moments[2]) * 14.0
    slope = np.hypot(*np.gradient(steps))
    apart = np.abs(steps - np.round(steps)) / np.maximum(slope, 1e-9)
    line = np.clip(1.6 * FINE - apart, 0.0, 1.0) * np.where(np.round(steps) == 0, 0.75, 0.32)
    body = np.array((74, 66, 122)) * (0.45 + 0.85 * light)[..., None]
    body = body + line[..., None] * (np.array((222, 216, 245)) - body)
    return np.where(hit[..., None], np.clip(body, 0, 255), np.array(PAPER)).astype(np.uint8)


def _view(eye_P: Array) -> Array:
    """R_VP (3, 3) of a viewer V: z toward the eye, y as near to the body's z as can be."""
    z = eye_P / np.linalg.norm(eye_P)
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.95 else np.array([1.0, 0.0, 0.0])
    x = np.cross(up, z) / np.linalg.norm(np.cross(up, z))
    return np.stack([x, np.cross(z, x), z])


def _on_paper(p_P: Array, R_VP: Array, scale: float, side: int) -> NDArray[np.int64]:
    p_V = p_P @ R_VP.T
    return np.asarray(np.round(side / 2 + scale * p_V[:, :2] * [1.0, -1.0]), dtype=np.int64)


def _letter(canvas: Picture, text: str, place: NDArray[np.int64]) -> None:
    picture = Image.fromarray(canvas)
    font = ImageFont.load_default(20 * FINE)
    away = place - canvas.shape[0] / 2
    away = away / max(float(np.linalg.norm(away)), 1.0) * 16 * FINE
    ImageDraw.Draw(picture).text(tuple((place + away).tolist()), text, INK, font, anchor="mm")
    canvas[:] = np.asarray(picture)


def _time_colors(share: Array) -> list[list[int]]:
    stops = np.array([stop for stop, _ in TIME_SCALE], dtype=np.float64)
    values = np.array([[int(str(c)[i : i + 2], 16) for i in (1, 3, 5)] for _, c in TIME_SCALE])
    # The darkest colour of the scale would vanish on this ground.
    values = 0.82 * values + 0.18 * 255
    mixed = np.stack([np.interp(share, stops, values[:, k]) for k in range(3)], axis=1)
    return [[round(c) for c in row] for row in mixed.tolist()]


if __name__ == "__main__":
    command(main)
