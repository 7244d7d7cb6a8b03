"""Single views of a body for trials of edge trackers: random poses, sunlight, the sensor's noise.

    python -m benchmarks.edges.views [BODY ...] [--rich] [--views 3] -o DIR  PNGs; prints seconds a view

What a trial needs, in this order:

    target = edge_body("bus", plain=True)          # or edge_body(mesh), edge_body(Path("x.obj"))
    rig = edge_rig()                               # 640x480 px, focal length 640 px
    X_CG = random_poses(target.mesh, rig, 100, seed=1)
    sun_C = random_suns(100, seed=2)
    views = EdgeViews(target, rig, seed=3)
    image = views.image(X_CG[k], sun_C[k], k)      # uint8 (H, W); views.images(X_CG, sun_C) for all
    X_start = perturbed(X_CG, middle(target.mesh), seed=4)
    error = pose_errors(X_found, X_CG, middle(target.mesh))

``target.mesh`` is the very mesh that the rays meet, in G. The parts of a body of the simulator overlap and
are not joined, as those of a CAD model: where two meet there is an edge in the image but none in the mesh.
Faces that share vertices and meet at less than ``CREASE_DEG`` are shaded smoothly: only sharper edges, and
outlines, are edges in the image.

Camera frame C: x right, y down, z forward; pixel centres are integers, no distortion. The Sun's direction is
given in C, from the target to the Sun. The Earth fills the shadows, from the other side of the camera.
Everything is determined by the seeds, an image by its number, too: views can be made in any order.
"""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import trimesh
from tyro.conf import Positional, arg

from benchmarks.command import command
from benchmarks.edges.bodies import NAMES, EdgeBody, edge_body
from polhode.camera import RectifiedRig
from polhode.config import scene as config
from polhode.dataset_writer import write_png
from polhode.images import Grey
from polhode.lie import Array, exp_so3, inverse_pose, log_so3, make_pose
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, expose

SUN_TO_EARTH_DEG = 100.0
"""Between Sun and Earth, on either side of the direction to the camera."""
SUN_N = np.array([0.0, 0.0, 1.0])
EARTH_N = np.array([np.sin(np.deg2rad(SUN_TO_EARTH_DEG)), 0.0, np.cos(np.deg2rad(SUN_TO_EARTH_DEG))])


@dataclass(frozen=True)
class ViewOptions:
    """Light and sensor of the views."""

    sun: float = 1.0
    earth: float = 0.35
    """Radiance of the Earth's disc relative to a white surface in sunlight; 0: black shadows"""
    samples: int = 4
    """Rays a pixel: 1, 4, 9 or 16"""
    scattered: bool = False
    """Each ray a little aside at random: where rays lie in rows, edges of some slopes are displaced whole"""
    bounces: int = 0
    sensor: config.Sensor = field(default_factory=config.Sensor)
    """Blur, noise, gain; nothing moves while the shutter is open"""


class _Scattered(Camera):
    """Rays up to a quarter of a pixel aside, by a seed that is that of their place in the pixel."""

    def directions(self, uv_px: Array) -> Array:
        """Pixels (n, 2) -> unit rays (n, 3) in this camera."""
        place = np.round(4096.0 * (uv_px[0] % 1.0)).astype(np.int64) if len(uv_px) else np.zeros(2, dtype=int)
        aside = np.random.default_rng(place).uniform(-0.25, 0.25, uv_px.shape)
        return super().directions(uv_px + aside)


class EdgeViews:
    """A body, a camera and its sensor, ready to make images."""

    def __init__(
        self, target: EdgeBody, rig: RectifiedRig, seed: int, options: ViewOptions | None = None
    ) -> None:
        """``seed`` determines the noise, together with the number of the view."""
        chosen = options or ViewOptions()
        self.target, self.rig = target, rig
        self._seed, self._sensor = seed, chosen.sensor
        render = config.Render.model_validate({"samples": chosen.samples, "bounces": chosen.bounces})
        light = config.Light(
            sun=chosen.sun,
            earth=chosen.earth,
            sun_direction_N=_triple(SUN_N),
            earth_direction_N=_triple(EARTH_N),
        )
        section = config.Rig(width_px=rig.width_px, height_px=rig.height_px, focal_px=rig.focal_px)
        scene = config.Scene(
            body=target.config, light=light, rig=section, render=render, sensor=chosen.sensor
        )
        kind = _Scattered if chosen.scattered else Camera
        self._camera = kind(rig.K, np.zeros(4), np.eye(4), rig.width_px, rig.height_px)
        self._renderer = Renderer(target.body, scene, 0)

    def image(self, X_CG: Array, sun_C: Array, number: int = 0) -> Grey:
        """uint8 (H, W) of the target at X_CG (4, 4), the Sun towards sun_C (3,), of any length."""
        X_NC = inverse_pose(make_pose(lights_to_camera(sun_C), np.zeros(3)))
        picture = self._renderer.picture(self._camera, X_NC, X_NC @ X_CG)
        noise = np.random.default_rng([self._seed, 0xED6E, number])
        return np.asarray(expose(picture.level, self._sensor, noise), dtype=np.uint8)

    def images(self, X_CG: Array, sun_C: Array) -> list[Grey]:
        """Views (V, 4, 4), (V, 3), numbered from 0."""
        return [self.image(X, sun, k) for k, (X, sun) in enumerate(zip(X_CG, sun_C, strict=True))]


def lights_to_camera(sun_C: Array) -> Array:
    """R_CN (3, 3): turns SUN_N to the Sun's direction (3,), and EARTH_N past the direction to the camera."""
    z = np.asarray(sun_C, dtype=np.float64)
    z = z / np.linalg.norm(z)
    aside = np.array([0.0, 0.0, -1.0]) - (-z[2]) * z
    if np.linalg.norm(aside) < 1e-6:
        # The Sun is right behind the camera, or right ahead: any side will do.
        aside = np.array([0.0, 1.0, 0.0]) - z[1] * z
    x = aside / np.linalg.norm(aside)
    return np.column_stack([x, np.cross(z, x), z])


def edge_rig(focal_px: float = 640.0, width_px: int = 640, height_px: int = 480) -> RectifiedRig:
    """A single camera; its second eye (baseline 0.1 m) is never used."""
    return RectifiedRig(focal_px, (width_px - 1) / 2, (height_px - 1) / 2, 0.1, width_px, height_px)


def middle(mesh: trimesh.Trimesh) -> Array:
    """Middle (3,) of the mesh's box along the axes of G [m]: the point that poses are turned about."""
    return np.asarray(np.mean(mesh.bounds, axis=0), dtype=np.float64)


def random_poses(
    mesh: trimesh.Trimesh,
    rig: RectifiedRig,
    count: int,
    seed: int,
    range_m: tuple[float, float] = (2.0, 4.0),
    offset: float = 0.3,
) -> Array:
    """X_CG (count, 4, 4): any attitude, the mesh's middle at a range within ``range_m``, all of it in view.

    ``offset`` is how far from the image's middle that may be, as a share of the half image; less where the
    body would leave the image. A body too large for the image at the range stays in the image's middle.
    One seed gives all bodies the same attitudes and ranges.
    """
    rng = np.random.default_rng([seed, 0x905E])
    centre_G = middle(mesh)
    radius_m = float(np.linalg.norm(np.asarray(mesh.vertices) - centre_G, axis=1).max())
    half = np.array([rig.width_px, rig.height_px]) / (2.0 * rig.focal_px)
    poses = np.empty((count, 4, 4))
    for k in range(count):
        z = rng.uniform(*range_m)
        # a sphere around the body, as wide as it looks from near by
        room = np.maximum(half - radius_m / np.sqrt(max(z**2 - radius_m**2, 1e-12)), 0.0)
        aside = np.minimum(offset * half, room) * rng.uniform(-1.0, 1.0, 2)
        R_CG = random_rotation(rng)
        poses[k] = make_pose(R_CG, np.append(aside * z, z) - R_CG @ centre_G)
    return poses


def random_rotation(rng: np.random.Generator) -> Array:
    """A rotation (3, 3), evenly over all: from a normally distributed quaternion."""
    w, x, y, z = (q := rng.standard_normal(4)) / np.linalg.norm(q)
    v = np.array([x, y, z])
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * K)


def random_suns(count: int, seed: int, within_deg: tuple[float, float] = (20.0, 75.0)) -> Array:
    """sun_C (count, 3) unit, at angles within ``within_deg`` from the direction to the camera."""
    rng = np.random.default_rng([seed, 0x5051])
    low, high = np.cos(np.deg2rad(within_deg))
    cosine, around = rng.uniform(high, low, count), rng.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    return np.column_stack([sine * np.cos(around), sine * np.sin(around), -cosine])


def perturbed(X_CG: Array, about_G: Array, seed: int, angle_deg: float = 2.0, shift_m: float = 0.02) -> Array:
    """Poses (V, 4, 4) turned and moved at random: sigma about each axis of C, about ``about_G`` (3,)."""
    rng = np.random.default_rng([seed, 0x9E27])
    out = np.array(X_CG, dtype=np.float64)
    for X in out:
        centre_C = X[:3, :3] @ about_G + X[:3, 3]
        turn = exp_so3(np.deg2rad(angle_deg) * rng.standard_normal(3))
        X[:3, :3] = turn @ X[:3, :3]
        X[:3, 3] = centre_C + shift_m * rng.standard_normal(3) - X[:3, :3] @ about_G
    return out


def pose_errors(X_found: Array, X_CG: Array, about_G: Array) -> Array:
    """Errors (V, 6) of poses (V, 4, 4): of the place of ``about_G`` [m], then rotation vector [rad], in C.

    X_found is X_CG turned by the rotation vector about ``about_G`` and moved.
    """
    errors = np.empty((len(X_CG), 6))
    for error, found, true in zip(errors, X_found, X_CG, strict=True):
        error[:3] = (found - true)[:3] @ np.append(about_G, 1.0)
        error[3:] = log_so3(found[:3, :3] @ true[:3, :3].T)
    return errors


def _triple(v: Array) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])


def main(
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR", help="Folder of the images.")],
    bodies: Positional[tuple[str, ...]] = (),
    rich: Annotated[bool, arg(help="The surfaces of the bodies themselves.")] = False,
    views: Annotated[int, arg(help="Views of each body.")] = 3,
    samples: Annotated[int, arg(help="Rays a pixel: 1, 4, 9 or 16.")] = 4,
) -> None:
    """Write PNGs of every body."""
    rig = edge_rig()
    output.mkdir(parents=True, exist_ok=True)
    print("| body | faces | length [m] | s to prepare | s per view |\n|---|---:|---:|---:|---:|")
    for name in bodies or NAMES:
        start = time.process_time()
        target = edge_body(name, plain=not rich)
        scene = EdgeViews(target, rig, 0, ViewOptions(samples=samples))
        poses = random_poses(target.mesh, rig, views + 1, seed=1)
        suns = random_suns(len(poses), seed=2)
        scene.image(poses[-1], suns[-1], views)
        ready = time.process_time()
        images = scene.images(poses[:-1], suns[:-1])
        each_s = (time.process_time() - ready) / views
        length = float(np.ptp(target.mesh.vertices, axis=0).max())
        print(f"| {name} | {len(target.mesh.faces):,} | {length:.2f} | {ready - start:.1f} | {each_s:.2f} |")
        write_png(output / f"{name}{'_rich' if rich else ''}.png", np.hstack(images))


if __name__ == "__main__":
    command(main)
