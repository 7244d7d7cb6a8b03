"""Our shading against Mitsuba's path tracer, on one scene with every kind of surface that both can show.

    python -m lab.rendering.against_mitsuba [-o docs/images/mitsuba.png] [--width 320] [--samples 1600]

A deck of boxes, drawings, solar cells, a mast, a metal tank and a nozzle, which cast shadows on each other.
Prints one row for each light; draws ours, Mitsuba's and ten times the difference for the last. The peer is
the extra ``peers``. Full scale is the level that the default sensor brings to 255. The last columns compare
processor times [s] of an image with 16 samples a pixel, scene and compiled code at hand, and tell the mean
error that Mitsuba's has then: its light is drawn at random, where ours is integrated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time
from typing import Annotated, Any, Literal

import cv2
import mitsuba as mi
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter
from tyro.conf import arg

from lab.command import Png, command
from lab.presentation import print_table
from polhode.config import scene_settings as config
from polhode.geometry.lie import Array, Bools, Ints, exp_so3, inverse_pose, make_pose
from polhode.simulation.bodies.part import Chart, Part, assemble
from polhode.simulation.dataset.frame_renderer import Products, render_products
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, build_cameras
from polhode.simulation.surface.materials import Material

mi.set_variant("scalar_rgb")

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's camera has x to the left and y up."""
FAR_M = 1e3
FULL_SCALE = 255.0 / config.Sensor().white_dn
"""Level of a saturated pixel."""
EDGE_PX = 2
"""Pixels so near to a silhouette or a shadow's edge are left out: they measure where the samples fall."""
SAME_FACE_M, SAME_FACE_COSINE = 2e-3, 0.9
"""Neighbours on one face: so near to its plane, with normals so alike."""
SAMPLES = 16
"""A pixel, of our image and of both when their times are compared."""
X_NG = make_pose(exp_so3([2.35, 0.0, 0.0]) @ exp_so3([0.0, 0.0, 0.4]), [0.01, 0.01, 0.66])
SUN_N, EARTH_N = (0.7, -0.55, -0.45), (-0.6, 0.5, -0.6)
HEAD = (
    "light | bias | mean | 95 % | 99 % | max | share within 3 [%] | pixels | ours [s] | Mitsuba [s] | "
    "its error then"
)


@dataclass(frozen=True)
class RenderingCase:
    """What lights the deck."""

    name: str
    sun: float = 1.0
    """Level of a white surface that faces it"""
    sun_diameter_deg: float = 0.0
    """0: a point at infinity"""
    earth: float = 0.0
    """Radiance of the disc, relative to a white surface in sunlight"""
    bounces: Literal[0, 1] = 0

    @property
    def light(self) -> config.Light:
        """As the simulator gets it."""
        return config.Light(
            sun=self.sun,
            sun_direction_N=SUN_N,
            sun_diameter_deg=self.sun_diameter_deg,
            earth_direction_N=EARTH_N,
            earth=self.earth,
        )


CASES = (
    RenderingCase("point Sun"),
    RenderingCase("Sun of 0.533 deg", sun_diameter_deg=0.533),
    RenderingCase("Sun of 5 deg", sun_diameter_deg=5.0),
    RenderingCase("Earth alone", sun=0.0, earth=0.4),
    RenderingCase("Sun, one bounce", sun_diameter_deg=0.533, bounces=1),
    RenderingCase("Sun and Earth, one bounce", sun_diameter_deg=0.533, earth=0.15, bounces=1),
)

# The deck

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
    rng, create = np.random.default_rng(5), trimesh.creation
    return [
        _box([0.5, 0.38, 0.02], _pose([0, 0, -0.01]), MATT, _patches, rng),
        _box([0.12, 0.1, 0.08], _pose([-0.13, -0.05, 0.04]), MATT, _patches, rng),
        _box([0.07, 0.09, 0.05], _pose([0.16, 0.1, 0.025]), PAINT, _patches, rng),
        _box([0.2, 0.1, 0.004], _pose([0.05, -0.11, 0.09], [0.45, 0.35, 0.3]), CELLS, _cells, rng),
        _plain(create.icosphere(subdivisions=4, radius=0.05), _pose([0.0, 0.06, 0.05]), METAL),
        _plain(
            create.cylinder(radius=0.03, height=0.1, sections=64),
            _pose([-0.14, 0.11, 0.03], [0.0, np.pi / 2, 0.0]),
            PAINT,
        ),
        _plain(create.cylinder(radius=0.004, height=0.16, sections=24), _pose([0.17, -0.02, 0.08]), DARK),
        _plain(create.box([0.006, 0.006, 0.09]), _pose([0.05, -0.11, 0.045]), DARK),
    ]


def _pose(p_G: ArrayLike, turn_rad: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    return make_pose(exp_so3(turn_rad), p_G)


def _plain(mesh: trimesh.Trimesh, X_GO: Array, material: Material) -> Part:
    mesh.apply_transform(X_GO)
    return Part(mesh, material)


def _box(extents_m: ArrayLike, X_GO: Array, material: Material, draw: Draw, rng: np.random.Generator) -> Part:
    """A box, centred in its own frame O, with a drawing of its own on each side."""
    mesh = trimesh.creation.box(extents_m)
    half, R_GO, charts = 0.5 * np.asarray(extents_m), X_GO[:3, :3], []
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (-1.0, 1.0)):
        normal, right, down = sign * np.eye(3)[axis], np.eye(3)[axis - 2], np.eye(3)[axis - 1]
        width, height = (int(np.ceil(2 * half @ side / TEXEL_M)) + 1 for side in (right, down))
        corner_G = R_GO @ (half * (normal - right - down)) + X_GO[:3, 3]
        chart = Chart(corner_G, R_GO @ right, R_GO @ down, TEXEL_M, draw(height, width, rng))
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


# Mitsuba's scene


def load(case: RenderingCase, camera: Camera, samples: int) -> Any:
    """The deck in G, for a path tracer of light that has met the body at most ``bounces`` times more."""
    X_GN = inverse_pose(X_NG)
    to_sun_G, to_earth_G = (X_GN[:3, :3] @ np.array(d) / np.linalg.norm(d) for d in (SUN_N, EARTH_N))
    integrator = {"type": "path", "max_depth": 2 + case.bounces, "rr_depth": 100, "hide_emitters": True}
    scene: dict[str, Any] = {
        "type": "scene",
        "camera": _sensor(camera, X_GN, samples),
        "integrator": integrator,
    }
    if case.sun > 0 and case.sun_diameter_deg == 0:
        irradiance = _grey(np.pi * case.sun)
        scene["sun"] = {"type": "directional", "direction": (-to_sun_G).tolist(), "irradiance": irradiance}
    elif case.sun > 0:
        radius_rad = np.deg2rad(0.5 * case.sun_diameter_deg)
        scene["sun"] = _disc(to_sun_G, radius_rad, case.sun / np.sin(radius_rad) ** 2)
    if case.earth > 0:
        scene["earth"] = _disc(to_earth_G, np.deg2rad(case.light.earth_radius_deg), case.earth)
    for i, part in enumerate(deck()):
        for j, mesh in enumerate(_meshes(part)):
            scene[f"part_{i}_{j}"] = mesh
    return mi.load_dict(scene)


def render(scene: Any, samples: int = 0) -> Array:
    """Levels (H, W); ``samples`` a pixel, 0 for the scene's own number."""
    return np.asarray(np.array(mi.render(scene, spp=samples), dtype=np.float64)[..., 0])


def _sensor(camera: Camera, X_GK: Array, samples: int) -> dict[str, Any]:
    """A pinhole whose principal point is the middle of the image, square pixels, a box over each pixel."""
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
    normals, plain = assemble([part]).corner_normals, np.ones(len(part.mesh.faces), np.bool_)
    meshes = []
    for chart, faces in part.charts:
        plain[faces] = False
        meshes.append(_mesh(part, normals, np.asarray(faces), chart))
    if plain.any():
        meshes.append(_mesh(part, normals, np.flatnonzero(plain), None))
    return meshes


def _mesh(part: Part, corner_normals: Array, faces: Ints, chart: Chart | None) -> mi.Mesh:
    """Triangles that share no vertex, so that each corner has its own normal."""
    corners_G = np.asarray(part.mesh.triangles)[faces].reshape(-1, 3)
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(_bsdf(part.material, chart))
    has = {"has_vertex_normals": True, "has_vertex_texcoords": True}
    mesh = mi.Mesh("part", len(corners_G), len(faces), properties, **has)
    fields = mi.traverse(mesh)
    fields["vertex_positions"] = corners_G.ravel().tolist()
    fields["vertex_normals"] = corner_normals[faces].ravel().tolist()
    fields["faces"] = list(range(len(corners_G)))
    if chart is not None:
        # in [0, 1]: our texels have their centres at integers, Mitsuba's at halves
        offset = (corners_G - chart.origin_G) / chart.texel_m
        texels = np.stack([offset @ chart.right_G, offset @ chart.down_G], axis=1) + 0.5
        fields["vertex_texcoords"] = (texels / chart.image.shape[::-1]).ravel().tolist()
    fields.update()
    return mesh


def _bsdf(material: Material, chart: Chart | None) -> dict[str, Any]:
    reflectance: dict[str, Any] = _grey(material.albedo)
    if chart is not None:
        bitmap = mi.Bitmap(np.ascontiguousarray(chart.image[..., None], dtype=np.float32))
        reflectance = {"type": "bitmap", "bitmap": bitmap, "raw": True, "wrap_mode": "clamp"}
    diffuse = {"type": "diffuse", "reflectance": reflectance}
    if material.specular == 0:
        return {"type": "twosided", "bsdf": diffuse}
    metal: dict[str, Any] = {"type": "roughconductor", "material": "none", "distribution": "ggx"}
    metal["alpha"] = material.roughness**2
    mixed = {"type": "blendbsdf", "weight": material.specular, "diffuse": diffuse, "metal": metal}
    return {"type": "twosided", "bsdf": mixed}


def _grey(value: float) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value)] * 3}


# The comparison


@dataclass(frozen=True)
class ImageComparison:
    """Levels of both, and where they are compared."""

    ours: Array
    """(H, W)"""
    theirs: Array
    """(H, W)"""
    compared: Bools
    """(H, W) lit in both, and not at an edge"""
    ours_s: float
    theirs_s: float
    """Processor time of an image with SAMPLES a pixel"""
    noise: Array
    """(H, W) their image with SAMPLES a pixel minus the one with more"""

    @property
    def difference(self) -> Array:
        """Ours minus theirs (n,) where compared, in shares of full scale."""
        return np.asarray((self.ours - self.theirs)[self.compared] / FULL_SCALE)

    def row(self) -> list[object]:
        """Statistics in per cent of full scale."""
        error, bias = 100 * np.abs(self.difference), 100 * self.difference.mean()
        middle = (f"{value:.3f}" for value in (error.mean(), *np.percentile(error, [95, 99])))
        within, noise = 100 * (error < 3).mean(), 100 * np.abs(self.noise[self.compared]).mean() / FULL_SCALE
        times = (f"{seconds:.2f}" for seconds in (self.ours_s, self.theirs_s))
        last = (f"{error.max():.2f}", f"{within:.2f}", self.compared.sum(), *times, f"{noise:.3f}")
        return [f"{bias:+.3f}", *middle, *last]


def compare(case: RenderingCase, width_px: int = 96, samples: int = 64) -> ImageComparison:
    """Render the deck with both programs: ours with SAMPLES a pixel, Mitsuba's with ``samples``."""
    rig = config.Rig(width_px=width_px, height_px=width_px * 3 // 4, focal_px=1.15 * width_px)
    camera, _ = build_cameras(rig)
    scene = config.Scene(light=case.light, render=config.Render(samples=SAMPLES, bounces=case.bounces))
    renderer = Renderer(assemble(deck()), scene, 0)
    ours = renderer.picture(camera, np.eye(4), X_NG).level
    peer = load(case, camera, samples)
    theirs = render(peer)
    _, ours_s = _timed(lambda: renderer.picture(camera, np.eye(4), X_NG).level)
    few, theirs_s = _timed(lambda: render(peer, SAMPLES))
    truth = render_products(renderer, camera, np.eye(4), X_NG, ("depth", "normals", "shadow"))
    lit = minimum_filter(np.minimum(ours, theirs) > 1e-3, 2 * EDGE_PX + 1)
    edges = maximum_filter(_edges(truth, camera), 2 * EDGE_PX - 1)
    return ImageComparison(ours, theirs, np.asarray(lit & ~edges), ours_s, theirs_s, few - theirs)


def _timed(image: Callable[[], Array]) -> tuple[Array, float]:
    start = process_time()
    return image(), process_time() - start


def _edges(truth: Products, camera: Camera) -> Bools:
    """Pixels (H, W) whose right or lower neighbour shows another face, nothing, or another kind of shadow."""
    assert truth.depth is not None and truth.normals is not None and truth.shadow is not None
    rays = camera.pixel_directions.reshape(*truth.depth.shape, 3)
    p_K = np.nan_to_num(rays * (truth.depth / rays[..., 2])[..., None], nan=1e3)
    normals = np.nan_to_num(truth.normals)
    edges = np.zeros(truth.depth.shape, np.bool_)
    for axis in (0, 1):
        n, p, shadow = (np.roll(values, -1, axis) for values in (normals, p_K, truth.shadow))
        step_m = np.abs(np.einsum("hwk,hwk->hw", p - p_K, normals))
        bent = np.einsum("hwk,hwk->hw", n, normals) < SAME_FACE_COSINE
        edges |= (step_m > SAME_FACE_M) | bent | (shadow != truth.shadow)
    return edges


def picture(comparison: ImageComparison) -> Image.Image:
    """Ours, Mitsuba's, and the difference times ten around grey, side by side."""
    ours, theirs = (np.clip(level / FULL_SCALE, 0, 1) for level in (comparison.ours, comparison.theirs))
    gap = np.ones((ours.shape[0], 4))
    row = np.hstack([ours, gap, theirs, gap, np.clip(0.5 + 10 * (ours - theirs), 0, 1)])
    return Image.fromarray(np.rint(255 * row).astype(np.uint8))


def main(
    output: Png = None,
    width: Annotated[int, arg(help="Width of the image [px]; the height is 3/4 of it.")] = 320,
    samples: Annotated[int, arg(help="Samples a pixel of Mitsuba; fewer for direct light.")] = 1600,
) -> None:
    """Print the table; draw the last case when asked."""
    # Direct light is almost free of noise; light by way of a mirror is not.
    rays = {case.name: samples if case.bounces else min(samples, 144) for case in CASES}
    print_table(HEAD, ([case.name, *compare(case, width, rays[case.name]).row()] for case in CASES))
    if output:
        picture(compare(CASES[-1], width, samples)).save(output, optimize=True)


if __name__ == "__main__":
    command(main)
