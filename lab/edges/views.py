"""Rendered views of a body for trials of edge trackers: solids, bodies of the simulator, poses, light.

The parts of a body of the simulator overlap and are not joined, as in a CAD model: where two meet there is an
edge in the image but none in the mesh. Faces that share vertices and meet at less than ``SMOOTH_BELOW_DEG``
are shaded smoothly: only sharper edges, and outlines, are edges in the image.

Camera frame C: x right, y down, z forward; pixel centres are integers, no distortion. The Sun's direction is
given in C, from the target to the Sun. The Earth fills the shadows, from the other side of the camera.
The seeds determine everything, and the number of an image its noise: views can be made in any order.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from polhode.config import scene_settings as config
from polhode.files.images import Grey
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.simulation.bodies import Body, build_body
from polhode.simulation.bodies.part import Part, assemble, join
from polhode.simulation.bodies.solids import hull, prism
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, expose
from polhode.simulation.surface.materials import Material


def block() -> trimesh.Trimesh:
    """A box of three different sides with one corner cut off."""
    half = np.array([0.45, 0.3, 0.21])
    corners = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    kept = corners[~(corners > 0).all(axis=1)]
    cut = half - np.diag([0.3, 0.22, 0.2])
    return hull(np.vstack([kept, cut]))


def wedge() -> trimesh.Trimesh:
    """A tapered prism on an uneven quadrangle: few edges are parallel."""
    return _middled(prism([[-0.5, -0.3], [0.5, -0.35], [0.4, 0.3], [-0.35, 0.36]], 0.55, taper=0.62))


def house() -> trimesh.Trimesh:
    """A pentagonal prism with an uneven roof."""
    return _middled(prism([[-0.45, -0.25], [0.45, -0.25], [0.45, 0.1], [0.1, 0.34], [-0.45, 0.16]], 0.6))


def ell() -> trimesh.Trimesh:
    """An L with unequal arms."""
    outline = [[-0.5, -0.3], [0.5, -0.3], [0.5, -0.02], [-0.15, -0.02], [-0.15, 0.4], [-0.5, 0.4]]
    return extruded(outline, [-0.3, -0.15], 0.36)


def tee() -> trimesh.Trimesh:
    """A T whose stem stands aside of its middle."""
    outline = [[-0.5, 0.1], [0.55, 0.1], [0.55, 0.34], [-0.5, 0.34]]
    stem = [[0.05, 0.1], [0.05, -0.42], [-0.2, -0.42], [-0.2, 0.1]]
    return extruded([outline[0], *stem[::-1], *outline[1:]], [-0.1, 0.2], 0.3)


def steps() -> trimesh.Trimesh:
    """A staircase of three unequal steps."""
    outline = [[-0.5, -0.3], [0.5, -0.3], [0.5, -0.14], [0.12, -0.14], [0.12, 0.1], [-0.2, 0.1], [-0.2, 0.3],
               [-0.5, 0.3]]  # fmt: skip
    return extruded(outline, [-0.35, -0.22], 0.5)


def drum() -> trimesh.Trimesh:
    """A tapered drum of seven unequal sides."""
    angle = np.deg2rad([0, 48, 102, 150, 205, 262, 310])
    return _middled(prism(0.38 * np.column_stack([np.cos(angle), np.sin(angle)]), 0.6, taper=0.75))


def satellite() -> trimesh.Trimesh:
    """A box with an instrument on it and two thin panels of unequal length on bars."""
    parts = [
        ([0.5, 0.42, 0.6], [0, 0, 0]),
        ([0.2, 0.16, 0.14], [0.1, 0.05, 0.36]),
        ([0.36, 0.5, 0.012], [0, 0.56, 0.06]),
        ([0.36, 0.36, 0.012], [0, -0.49, 0.06]),
        ([0.03, 0.24, 0.03], [0, 0.27, 0.06]),
        ([0.03, 0.24, 0.03], [0, -0.27, 0.06]),
    ]
    boxes = [trimesh.creation.box(extents) for extents, _ in parts]
    for box, (_, place) in zip(boxes, parts, strict=True):
        box.apply_translation(place)
    return join(boxes)


SOLIDS: dict[str, Callable[[], trimesh.Trimesh]] = {
    solid.__name__: solid for solid in (block, wedge, house, ell, tee, steps, drum, satellite)
}


def extruded(outline: ArrayLike, inside: ArrayLike, height: float) -> trimesh.Trimesh:
    """An outline (n, 2), counter-clockwise, all of it visible from the point ``inside`` (2,), made a solid.

    z from -height / 2 to height / 2; each end is a fan around the point.
    """
    flat = np.vstack([np.asarray(outline, dtype=np.float64), np.asarray(inside, dtype=np.float64)])
    n = len(flat) - 1
    vertices = np.vstack([np.column_stack([flat, np.full(n + 1, z)]) for z in (-0.5 * height, 0.5 * height)])
    faces = []
    for a in range(n):
        b = (a + 1) % n
        up_a, up_b = a + n + 1, b + n + 1
        faces += [[b, a, n], [up_a, up_b, 2 * n + 1], [a, b, up_b], [a, up_b, up_a]]
    return trimesh.Trimesh(vertices, faces, process=False)


def _middled(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_translation(-np.asarray(mesh.bounds).mean(axis=0))
    return mesh


MATTE = Material(0.5, 0.0, 1.0)
"""A diffuse grey without any texture: only shape makes edges."""


@dataclass(frozen=True)
class Kind:
    """A body of the simulator as trials use it."""

    family: str
    size_m: float
    seed: int


KINDS = {
    "bus": Kind("bus", 0.42, 1),
    "cubesat": Kind("cubesat", 0.5, 4),
    "truss": Kind("truss", 1.0, 3),
    "upper_stage": Kind("upper_stage", 1.2, 3),
    "free_flyer": Kind("free_flyer", 0.5, 1),
    "dish": Kind("dish", 0.6, 2),
}
"""Bodies of polhode/simulation/bodies, 0.6 to 1.2 m over all."""


@dataclass(frozen=True)
class EdgeBody:
    """A body to be seen."""

    name: str
    body: Body
    config: config.TargetBody

    @property
    def mesh(self) -> trimesh.Trimesh:
        """What the rays meet, in G [m]."""
        return self.body.mesh


def edge_body(name: str, plain: bool = True) -> EdgeBody:
    """A body of ``NAMES``.

    plain: one matte grey without any texture, so that shape alone makes edges; else the body's own surface
    (paint, cells, foil, stickers), which solids have not.
    """
    if name in SOLIDS:
        body, described = assemble([Part(SOLIDS[name](), MATTE)]), config.TargetBody(contrast=0.0)
    else:
        kind = KINDS[name]
        described = config.TargetBody.model_validate(
            {"family": kind.family, "size_m": kind.size_m, "seed": kind.seed}
        )
        body = build_body(described, kind.seed)
    if plain:
        faces = len(body.mesh.faces)
        body = replace(
            body,
            face_material=np.zeros(faces, dtype=np.int64),
            materials=(MATTE,),
            face_chart=np.full(faces, -1),
            charts=(),
            chart_layers=np.zeros((0, 0), dtype=np.int64),
            colours=None,
        )
    return EdgeBody(name, body, described)


NAMES = (*SOLIDS, *KINDS)


SUN_TO_EARTH_DEG = 100.0
"""Between Sun and Earth, on either side of the direction to the camera."""
SUN_N = (0.0, 0.0, 1.0)
EARTH = 0.35
"""Radiance of its disc relative to a white surface in sunlight"""
EARTH_N = (float(np.sin(np.deg2rad(SUN_TO_EARTH_DEG))), 0.0, float(np.cos(np.deg2rad(SUN_TO_EARTH_DEG))))


class EdgeViews:
    """A body, a camera and its sensor, ready to make images."""

    def __init__(self, target: EdgeBody, rig: RectifiedRig, seed: int, sensor: config.Sensor) -> None:
        """``seed`` determines the noise, together with the number of the view."""
        self._seed, self._sensor = seed, sensor
        # four rays a pixel, shifted at random: on a grid, edges of some slopes are displaced as a whole
        render = config.Render.model_validate({"samples": 4, "bounces": 0, "scattered": True})
        light = config.Light(sun=1.0, earth=EARTH, sun_direction_N=SUN_N, earth_direction_N=EARTH_N)
        section = config.Rig(width_px=rig.width_px, height_px=rig.height_px, focal_px=rig.focal_px)
        scene = config.Scene(body=target.config, light=light, rig=section, render=render, sensor=sensor)
        self._camera = Camera(rig.K, np.zeros(4), np.eye(4), rig.width_px, rig.height_px)
        self._renderer = Renderer(target.body, scene, 0)

    def image(self, X_CG: Array, sun_C: Array, number: int = 0) -> Grey:
        """uint8 (H, W) of the target at X_CG (4, 4), the Sun towards sun_C (3,), of any length."""
        X_NC = inverse_pose(make_pose(lights_to_camera(sun_C), np.zeros(3)))
        picture = self._renderer.picture(self._camera, X_NC, X_NC @ X_CG)
        noise = np.random.default_rng([self._seed, 0xED6E, number])
        return np.asarray(expose(picture.level, self._sensor, noise), dtype=np.uint8)


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
    centre_G = np.asarray(np.mean(mesh.bounds, axis=0))
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
    """A rotation (3, 3), uniform over all: from a normally distributed quaternion."""
    return np.asarray(Rotation.from_quat(rng.standard_normal(4), scalar_first=True).as_matrix())


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
