"""The shading agrees with Mitsuba's path tracer (extra ``peers``).

``python -m lab.rendering.against_mitsuba`` compares a scene with drawings, and times.

Full scale is the level that the default sensor brings to 255. Compared are pixels lit in both and two pixels
or more from silhouettes and shadows' edges.
"""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.bodies.solids import box, drum
from polhode.simulation.dataset.frame_renderer import render_products
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import build_cameras
from polhode.simulation.surface.materials import Material

mi.set_variant("scalar_rgb")

WIDTH = 120
X_NG = make_pose(exp_so3([2.35, 0.0, 0.0]) @ exp_so3([0.0, 0.0, 0.4]), [0.01, 0.01, 0.66])
SUN_N, EARTH_N = np.array([0.7, -0.55, -0.45]), np.array([-0.6, 0.5, -0.6])
MATT, METAL = Material(0.5, specular=0.0), Material(0.16, specular=0.55, roughness=0.42)
DECK = (
    Part(box([0.4, 0.3, 0.02], bevel=0.0, at=[0, 0, -0.01]), MATT),
    Part(box([0.1, 0.08, 0.09], bevel=0.0, at=[-0.08, 0.04, 0.045]), Material(0.7, specular=0.0)),
    Part(drum(0.05, 0.12, 48, bevel=0.0, at=[0.1, -0.03, 0]), METAL),
    Part(box([0.09, 0.12, 0.03], bevel=0.0, at=[-0.02, -0.07, 0.015]), Material(0.6, 0.04, 0.45)),
)
CASES: dict[str, tuple[dict[str, float], int]] = {
    "point Sun": ({"sun_diameter_deg": 0.0, "earth": 0.0}, 0),
    "Sun of 5 deg": ({"sun_diameter_deg": 5.0, "earth": 0.0}, 0),
    "Earth alone": ({"sun": 0.0, "earth": 0.4}, 0),
    "Sun, one bounce": ({"sun_diameter_deg": 0.533, "earth": 0.0}, 1),
}


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value)] * 3}


def _disc(toward_G: Array, radius_rad: float, radiance: float) -> dict[str, Any]:
    """A far sphere of even radiance."""
    sine = np.sin(radius_rad)
    # Mitsuba works out the cone of the sphere in single precision: 0.3 % too wide for the Sun.
    single = 1.0 - float(np.sqrt(np.float32(1.0) - np.float32(sine) ** 2))
    even = {"type": "area", "radiance": _grey(radiance * (1.0 - np.cos(radius_rad)) / single)}
    centre = (1e3 * toward_G).tolist()
    return {"type": "sphere", "center": centre, "radius": float(1e3 * sine), "emitter": even}


def _mesh(part: Part) -> mi.Mesh:
    """Triangles that share no vertex, so that each corner has its own normal."""
    m, n = part.material, len(part.mesh.faces)
    diffuse = {"type": "diffuse", "reflectance": _grey(m.albedo)}
    gloss = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": m.roughness**2}
    mixed = {"type": "blendbsdf", "weight": m.specular, "diffuse": diffuse, "gloss": gloss}
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict({"type": "twosided", "bsdf": mixed if m.specular else diffuse})
    mesh = mi.Mesh("part", 3 * n, n, properties, has_vertex_normals=True)
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = np.asarray(part.mesh.triangles).ravel().tolist()
    fields["vertex_normals"] = assemble([part]).corner_normals.ravel().tolist()
    fields["faces"] = list(range(3 * n))
    fields.update()
    return mesh


def _by_mitsuba(parts: list[Part], light: config.Light, bounces: int, samples: int) -> Array:
    """Levels (H, W) of light that has met the deck at most ``bounces`` times more."""
    X_GN = inverse_pose(X_NG)
    sun_G, earth_G = (X_GN[:3, :3] @ d / np.linalg.norm(d) for d in (SUN_N, EARTH_N))
    radius_rad = np.deg2rad(0.5 * light.sun_diameter_deg)
    film = {"type": "hdrfilm", "width": WIDTH, "height": WIDTH * 3 // 4, "rfilter": {"type": "box"},
            "pixel_format": "rgb", "component_format": "float32"}  # fmt: skip
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2 + bounces, "rr_depth": 100, "hide_emitters": True},
        "camera": {
            "type": "perspective", "fov_axis": "x", "fov": float(np.rad2deg(2 * np.arctan(0.5 / 1.15))),
            "near_clip": 1e-3, "far_clip": 1e4, "film": film,
            # Mitsuba's camera has x to the left and y up.
            "to_world": mi.ScalarTransform4f((X_GN @ np.diag([-1.0, -1.0, 1.0, 1.0])).tolist()),
            "sampler": {"type": "multijitter", "sample_count": samples},
        },
    }  # fmt: skip
    if light.sun > 0 and radius_rad == 0:
        irradiance = _grey(np.pi * light.sun)
        scene["sun"] = {"type": "directional", "direction": (-sun_G).tolist(), "irradiance": irradiance}
    elif light.sun > 0:
        scene["sun"] = _disc(sun_G, radius_rad, light.sun / np.sin(radius_rad) ** 2)
    if light.earth > 0:
        scene["earth"] = _disc(earth_G, np.deg2rad(light.earth_radius_deg), light.earth)
    scene |= {f"part_{i}": _mesh(part) for i, part in enumerate(parts)}
    return np.asarray(np.array(mi.render(mi.load_dict(scene)), dtype=np.float64)[..., 0])


@pytest.mark.parametrize("name", CASES)
def test_levels_agree_within_three_per_cent_of_full_scale(name: str) -> None:
    """Paint and metal: 99 % of the pixels within 3 %, the mean within 1 %."""
    changes, bounces = CASES[name]
    directions = {"sun_direction_N": tuple(SUN_N), "earth_direction_N": tuple(EARTH_N)}
    light = config.Light.model_validate({**directions, **changes})
    scene = config.Scene(
        light=light,
        render=config.Render(samples=16, bounces=1 if bounces else 0),
        rig=config.Rig(width_px=WIDTH, height_px=WIDTH * 3 // 4, focal_px=1.15 * WIDTH),
    )
    # Highlights that metal throws onto its neighbours are spread over the resolution of the probes.
    parts = [replace(part, material=MATT) if bounces else part for part in DECK]
    camera, _ = build_cameras(scene.rig)
    renderer = Renderer(assemble(parts), scene, 0)
    ours = renderer.picture(camera, np.eye(4), X_NG).level
    theirs = _by_mitsuba(parts, light, bounces, 256 if bounces else 64)
    truth = render_products(renderer, camera, np.eye(4), X_NG, ("normals", "shadow"))
    assert truth.normals is not None and truth.shadow is not None
    even = minimum_filter(np.minimum(ours, theirs) > 1e-3, 5)
    for values in (*np.moveaxis(np.nan_to_num(truth.normals), 2, 0), truth.shadow.astype(float)):
        even &= maximum_filter(values, 5) - minimum_filter(values, 5) < 0.5
    full_scale = 255.0 / config.Sensor().white_dn
    error = np.abs(ours - theirs)[even] / full_scale
    assert len(error) > 1500
    assert (error < 0.03).mean() > 0.99
    assert error.mean() < 0.01
    # The pixels left out agree as a whole: silhouettes and shadows lie where they should.
    lit = np.maximum(ours, theirs) > 1e-3
    assert abs((ours - theirs)[lit].mean()) < 0.003 * theirs[lit].mean()
