"""The project's parts, camera and lights as a scene of Mitsuba 3 (optional extra ``peers``).

Radiances are scaled as the project's levels: 1 for a white diffuse surface that faces the Sun, which an
irradiance of pi gives. The surface is Mitsuba's mixture of a diffuse and a rough metallic reflector. Its
reflectance at normal incidence is ours, but does not grow at grazing angles as Schlick's does; its masking
and shadowing are independent of each other where ours are joint.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from polhode.lie import Array
from polhode.records import Ints
from polhode.simulation.bodies.parts.part import Chart, Part, assemble
from polhode.simulation.camera.cameras import Camera
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


def render(
    parts: Sequence[Part],
    lights: PeerLights,
    camera: Camera,
    X_GK: Array,
    samples: int,
    bounces: int = 0,
    seed: int = 0,
) -> Array:
    """Levels (H, W) of Mitsuba's path tracer: light that has met the body at most ``bounces`` times more."""
    scene: dict[str, Any] = {"type": "scene", "camera": _sensor(camera, X_GK, samples)}
    scene["integrator"] = {"type": "path", "max_depth": 2 + bounces, "rr_depth": 100, "hide_emitters": True}
    scene |= _emitters(lights)
    for i, part in enumerate(parts):
        for j, mesh in enumerate(_meshes(part)):
            scene[f"part_{i}_{j}"] = mesh
    image = np.array(mi.render(mi.load_dict(scene), seed=seed), dtype=np.float64)
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
