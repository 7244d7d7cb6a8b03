"""The project's parts, camera and lights as a scene of Mitsuba 3 (optional extra ``peers``).

Radiances are scaled as the project's levels: 1 for a white diffuse surface that faces the Sun, which an
irradiance of pi gives. The surface is Mitsuba's mixture of a diffuse and a rough metallic reflector. Its
reflectance at normal incidence is ours, but does not grow at grazing angles as Schlick's does; its masking
and shadowing are independent of each other where ours are joint.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import mitsuba as mi
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from polhode.lie import Array, exp_so3, make_pose
from polhode.records import Ints
from polhode.simulation.bodies.part import Chart, Part, assemble
from polhode.simulation.stereo_camera import Camera
from polhode.simulation.surface.materials import Material

mi.set_variant("scalar_rgb")

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's camera has x to the left and y up."""
FAR_M = 1e3


@dataclass(frozen=True)
class PeerLights:
    """Lights in G, as far as Mitsuba is to know them."""

    sun_direction_G: Array
    """(3,) unit, towards the Sun"""
    sun: float = 1.0
    """Level of a white surface that faces it"""
    sun_diameter_deg: float = 0.0
    """0: a point at infinity"""
    earth_direction_G: Array | None = None
    """(3,) unit"""
    earth: float = 0.0
    """Radiance of the disc, relative to a white surface in sunlight"""
    earth_radius_deg: float = 66.0


def load(
    parts: Sequence[Part],
    lights: PeerLights,
    camera: Camera,
    X_GK: Array,
    samples: int,
    bounces: int = 0,
) -> Any:
    """Mitsuba's scene, for a path tracer of light that has met the body at most ``bounces`` times more."""
    scene: dict[str, Any] = {"type": "scene", "camera": _sensor(camera, X_GK, samples)}
    scene["integrator"] = {"type": "path", "max_depth": 2 + bounces, "rr_depth": 100, "hide_emitters": True}
    scene |= _emitters(lights)
    for i, part in enumerate(parts):
        for j, mesh in enumerate(_meshes(part)):
            scene[f"part_{i}_{j}"] = mesh
    return mi.load_dict(scene)


def render(scene: Any, samples: int = 0, seed: int = 0) -> Array:
    """Levels (H, W); ``samples`` a pixel, 0 for the scene's own number."""
    image = np.array(mi.render(scene, seed=seed, spp=samples), dtype=np.float64)
    return np.asarray(image[..., 0])


def _sensor(camera: Camera, X_GK: Array, samples: int) -> dict[str, Any]:
    """A pinhole whose principal point is the middle of the image, square pixels, a box over each pixel."""
    middle = [(camera.width_px - 1) / 2, (camera.height_px - 1) / 2]
    if camera.dist.any() or not np.allclose(camera.K[:2, 2], middle):
        raise ValueError("Mitsuba's camera has no distortion and no offset of the principal point")
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.rad2deg(2 * np.arctan(0.5 * camera.width_px / camera.K[0, 0]))),
        "near_clip": 1e-3,
        "far_clip": 1e4,
        "to_world": mi.ScalarTransform4f((X_GK @ FLIP).tolist()),
        "film": {
            "type": "hdrfilm",
            "width": camera.width_px,
            "height": camera.height_px,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def _emitters(lights: PeerLights) -> dict[str, Any]:
    emitters: dict[str, Any] = {}
    toward = lights.sun_direction_G
    if lights.sun > 0 and lights.sun_diameter_deg == 0:
        irradiance = _grey(np.pi * lights.sun)
        emitters["sun"] = {
            "type": "directional",
            "direction": (-toward).tolist(),
            "irradiance": irradiance,
        }
    elif lights.sun > 0:
        radius_rad = np.deg2rad(0.5 * lights.sun_diameter_deg)
        emitters["sun"] = _disc(toward, radius_rad, lights.sun / np.sin(radius_rad) ** 2)
    if lights.earth > 0 and lights.earth_direction_G is not None:
        emitters["earth"] = _disc(lights.earth_direction_G, np.deg2rad(lights.earth_radius_deg), lights.earth)
    return emitters


def _disc(toward_G: Array, radius_rad: float, radiance: float) -> dict[str, Any]:
    """A far sphere of even radiance."""
    sine = np.sin(radius_rad)
    # Mitsuba works out the cone of the sphere in single precision: 0.3 % too wide for the Sun.
    single = 1.0 - float(np.sqrt(np.float32(1.0) - np.float32(sine) ** 2))
    return {
        "type": "sphere",
        "center": (FAR_M * toward_G).tolist(),
        "radius": float(FAR_M * sine),
        "emitter": {"type": "area", "radiance": _grey(radiance * (1.0 - np.cos(radius_rad)) / single)},
    }


def _meshes(part: Part) -> list[mi.Mesh]:
    """One mesh for each drawing of a part, and one for its faces without a drawing."""
    normals = assemble([part]).corner_normals
    plain = np.ones(len(part.mesh.faces), np.bool_)
    meshes = []
    for chart, faces in part.charts:
        plain[faces] = False
        meshes.append(_mesh(part, normals, np.asarray(faces), chart))
    if plain.any():
        meshes.append(_mesh(part, normals, np.flatnonzero(plain), None))
    return meshes


def _mesh(part: Part, corner_normals: Array, faces: Ints, chart: Chart | None) -> mi.Mesh:
    """Triangles that share no vertex, so that each corner has its own normal."""
    corners = np.asarray(part.mesh.triangles)[faces].reshape(-1, 3)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_bsdf(part.material, chart))
    mesh = mi.Mesh(
        "part", len(corners), len(faces), properties, has_vertex_normals=True, has_vertex_texcoords=True
    )
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = corners.ravel().tolist()
    fields["vertex_normals"] = corner_normals[faces].ravel().tolist()
    fields["faces"] = list(range(len(corners)))
    if chart is not None:
        fields["vertex_texcoords"] = _texture_coordinates(chart, corners).ravel().tolist()
    fields.update()
    return mesh


def _texture_coordinates(chart: Chart, p_G: Array) -> Array:
    """Points (n, 3) -> (n, 2) in [0, 1]: our texels have their centres at integers, Mitsuba's at halves."""
    height, width = chart.image.shape
    offset = (p_G - chart.origin_G) / chart.texel_m
    u, v = (offset @ chart.right_G + 0.5) / width, (offset @ chart.down_G + 0.5) / height
    return np.stack([u, v], axis=1)


def _bsdf(material: Material, chart: Chart | None) -> dict[str, Any]:
    reflectance: dict[str, Any] = _grey(material.albedo)
    if chart is not None:
        reflectance = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(chart.image[..., None], dtype=np.float32)),
            "raw": True,
            "wrap_mode": "clamp",
        }
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    if material.specular == 0:
        return {"type": "twosided", "bsdf": diffuse}
    metal = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
    metal["alpha"] = material.roughness**2  # type: ignore[assignment]
    mixed = {"type": "blendbsdf", "weight": material.specular, "diffuse": diffuse, "metal": metal}
    return {"type": "twosided", "bsdf": mixed}


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value)] * 3}


TEXEL_M = 1e-3
MATT = Material(0.5, specular=0.0)
PAINT = Material(0.6, specular=0.04, roughness=0.45)
METAL = Material(0.16, specular=0.55, roughness=0.42)
CELLS = Material(0.07, specular=0.06, roughness=0.3)
DARK = Material(0.1, specular=0.0)

Drawing = NDArray[np.float32]
Draw = Callable[[int, int, np.random.Generator], Drawing]


def deck() -> list[Part]:
    """The parts in G; z points away from the deck, whose surface is z = 0."""
    rng = np.random.default_rng(5)
    return [
        _box([0.5, 0.38, 0.02], _pose([0, 0, -0.01]), MATT, _patches, rng),
        _box([0.12, 0.1, 0.08], _pose([-0.13, -0.05, 0.04]), MATT, _patches, rng),
        _box([0.07, 0.09, 0.05], _pose([0.16, 0.1, 0.025]), PAINT, _patches, rng),
        _box([0.2, 0.1, 0.004], _pose([0.05, -0.11, 0.09], [0.45, 0.35, 0.3]), CELLS, _cells, rng),
        _plain(trimesh.creation.icosphere(subdivisions=4, radius=0.05), _pose([0.0, 0.06, 0.05]), METAL),
        _plain(
            trimesh.creation.cylinder(radius=0.03, height=0.1, sections=64),
            _pose([-0.14, 0.11, 0.03], [0.0, np.pi / 2, 0.0]),
            PAINT,
        ),
        _plain(
            trimesh.creation.cylinder(radius=0.004, height=0.16, sections=24),
            _pose([0.17, -0.02, 0.08]),
            DARK,
        ),
        _plain(trimesh.creation.box([0.006, 0.006, 0.09]), _pose([0.05, -0.11, 0.045]), DARK),
    ]


def _pose(p_G: ArrayLike, turn_rad: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    return make_pose(exp_so3(turn_rad), p_G)


def _plain(mesh: trimesh.Trimesh, X_GO: Array, material: Material) -> Part:
    mesh.apply_transform(X_GO)
    return Part(mesh, material)


def _box(extents_m: ArrayLike, X_GO: Array, material: Material, draw: Draw, rng: np.random.Generator) -> Part:
    """A box, centred in its own frame O, with a drawing of its own on each side."""
    mesh = trimesh.creation.box(extents_m)
    half = 0.5 * np.asarray(extents_m)
    charts = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal, right, down = sign * np.eye(3)[axis], np.eye(3)[axis - 2], np.eye(3)[axis - 1]
            width, height = (int(np.ceil(2 * half @ side / TEXEL_M)) + 1 for side in (right, down))
            corner = half * (normal - right - down)
            chart = Chart(
                X_GO[:3, :3] @ corner + X_GO[:3, 3],
                X_GO[:3, :3] @ right,
                X_GO[:3, :3] @ down,
                TEXEL_M,
                draw(height, width, rng),
            )
            charts.append((chart, np.flatnonzero(np.asarray(mesh.face_normals) @ normal > 0.5)))
    mesh.apply_transform(X_GO)
    return Part(mesh, material, tuple(charts))


def _patches(height: int, width: int, rng: np.random.Generator) -> Drawing:
    """Plates and discs of random size and reflectance over each other."""
    image = np.full((height, width), rng.uniform(0.4, 0.6), np.float32)
    for _ in range(max(4, height * width // 500)):
        at = rng.uniform((0, 0), (width, height)).astype(int)
        size = rng.uniform(2, 16, 2).astype(int)
        shade = float(rng.uniform(0.05, 0.9))
        if rng.random() < 0.3:
            cv2.circle(image, at.tolist(), int(size[0] // 2 + 1), shade, -1)
        else:
            cv2.rectangle(image, at.tolist(), (at + size).tolist(), shade, -1)
    return cv2.GaussianBlur(image, (0, 0), 0.8).astype(np.float32)


def _cells(height: int, width: int, rng: np.random.Generator) -> Drawing:
    """Dark cells, each of its own shade, in a bright grid."""
    image = np.full((height, width), 0.35, np.float32)
    for top in range(2, height - 2, 20):
        for left in range(2, width - 2, 30):
            image[top : top + 18, left : left + 28] = rng.normal(0.08, 0.015)
    return cv2.GaussianBlur(np.clip(image, 0.02, 0.9), (0, 0), 0.6).astype(np.float32)
