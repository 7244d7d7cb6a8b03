"""Bodies of revolution that spin about their axis of symmetry, as scenes: six shapes, four surfaces.

Their outline, rings and nozzles stand still in the image while the skin turns: whatever of them is taken for
a landmark contradicts the spin. Each body is a mesh file, all of it symmetric about z, the marks of its
surface included in an image around it; the density is uniform, so two principal moments are the same.

Surfaces: ``rich`` (shapes of all sizes), ``sparse`` (a few marks on plain paint), ``glitter`` (crumpled
foil), ``bare`` (reflectance without any variation, on which nothing shows the spin).
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from polhode.config.scene_settings import Scene
from polhode.lie import Array, log_so3

SECTIONS = 96
FRAMES, INTERVAL_S = 30, 0.5
RIG = {"width_px": 480, "height_px": 360, "focal_px": 350.0, "baseline_m": 0.09}
Grey = NDArray[np.uint8]
Profile = list[tuple[float, float]]


@dataclass(frozen=True)
class Piece:
    """A solid of revolution about z: profile of radius and height [m], its pieces named after materials."""

    profile: Profile
    """On the axis at both ends, or closed"""
    plain: str
    """Name, which stands for a material, of the piece where it has no texture"""
    closed: bool = False


def _ring(radius: float, height: float, width: float, thickness: float, plain: str = "grey ring") -> Piece:
    low, high = height - 0.5 * width, height + 0.5 * width
    inner, outer = 0.96 * radius, radius + thickness
    return Piece([(inner, low), (outer, low), (outer, high), (inner, high)], plain, True)


def _bell(throat: float, exit_m: float, top: float, length: float) -> Piece:
    """A nozzle that opens downwards, a thin wall."""
    s = np.linspace(0.0, 1.0, 9)
    radius = throat + (exit_m - throat) * np.sqrt(s)
    wall = 0.05 * exit_m
    outer = [(float(r), float(top - length * t)) for r, t in zip(radius, s, strict=True)]
    inner = [(float(r - wall), float(top - length * t)) for r, t in zip(radius, s, strict=True)]
    return Piece(outer[::-1] + inner, "nozzle", True)


def _cap(radius: float, height: float, z: float, up: bool) -> Profile:
    """Half an ellipse from the axis to the wall (up: from the wall to the axis)."""
    angle = np.linspace(0.0, np.pi / 2, 8)
    sign = 1.0 if up else -1.0
    line = [(float(radius * np.cos(a)), float(z + sign * height * np.sin(a))) for a in angle]
    line[-1] = (0.0, line[-1][1])
    return line if up else line[::-1]


def _stage() -> list[Piece]:
    """A tank with domes, a forward cone, flanges and a nozzle."""
    tank = Piece(_cap(0.11, 0.04, -0.12, False) + _cap(0.11, 0.04, 0.13, True), "white wall")
    cone = Piece([(0.112, 0.12), (0.07, 0.22), (0.06, 0.22), (0.1, 0.12)], "white cone", True)
    return [tank, cone, _ring(0.11, -0.11, 0.02, 0.008), _ring(0.07, 0.218, 0.012, 0.006),
            _bell(0.02, 0.065, -0.14, 0.11)]  # fmt: skip


def _tank() -> list[Piece]:
    """Two domes with a short wall, a weld band at the middle and a port at each end."""
    shell = Piece(_cap(0.14, 0.12, -0.05, False) + _cap(0.14, 0.12, 0.05, True), "white tank")
    ports = [
        Piece([(0, z), (0.025, z), (0.025, z + 0.03), (0, z + 0.03)], "grey port") for z in (-0.19, 0.16)
    ]
    return [shell, _ring(0.14, 0.0, 0.016, 0.004), *ports]


def _cone() -> list[Piece]:
    """A payload adapter: a frustum, open above, with two flanges."""
    wall = Piece(
        [(0.17, -0.1), (0.12, 0.02), (0.09, 0.14), (0.084, 0.14), (0.114, 0.02), (0.16, -0.1)],
        "white adapter", True,
    )  # fmt: skip
    return [wall, _ring(0.168, -0.095, 0.015, 0.008), _ring(0.09, 0.135, 0.012, 0.006)]


def _nozzle() -> list[Piece]:
    """A bell with stiffening rings and its combustion chamber."""
    bell = _bell(0.03, 0.15, 0.05, 0.24)
    chamber = Piece(
        [(0, 0.05), (0.03, 0.05), (0.055, 0.09), (0.055, 0.17), (0.03, 0.19), (0, 0.19)], "grey chamber"
    )
    rings = [_ring(r, z, 0.01, 0.006) for r, z in ((0.098, -0.02), (0.122, -0.08), (0.143, -0.15))]
    return [bell, chamber, *rings]


def _dish() -> list[Piece]:
    """A paraboloid with its feed on the axis and a drum behind."""
    r = np.linspace(0.0, 0.17, 12)
    front = [(float(x), float(x * x / 0.28)) for x in r]
    back = [(float(x), float(x * x / 0.28 - 0.005)) for x in r[::-1]]
    reflector = Piece(back[::-1] + front[::-1], "white reflector")
    feed = Piece([(0, 0.0), (0.008, 0.0), (0.008, 0.07), (0.02, 0.09), (0, 0.09)], "grey feed")
    drum = Piece([(0, -0.11), (0.07, -0.11), (0.07, -0.01), (0, -0.01)], "white drum")
    return [reflector, feed, drum]


def _cylinder() -> list[Piece]:
    """A cylinder with five rings and flat ends."""
    wall = Piece([(0, -0.17), (0.09, -0.17), (0.09, 0.17), (0, 0.17)], "white cylinder")
    return [wall, *(_ring(0.09, z, 0.012, 0.007) for z in np.linspace(-0.16, 0.16, 5))]


SHAPES: dict[str, Callable[[], list[Piece]]] = {
    "stage": _stage,
    "tank": _tank,
    "cone": _cone,
    "nozzle": _nozzle,
    "dish": _dish,
    "cylinder": _cylinder,
}
SURFACES = ("rich", "sparse", "glitter", "bare")
BODIES = tuple(f"{shape}_{surface}" for shape in SHAPES for surface in SURFACES)


def body_scene(name: str, folder: Path) -> tuple[Scene, int]:
    """The scene of a body and its seed; its mesh file is written to the folder unless it is there.

    The axis of symmetry is 35 to 80 degrees from the line of sight; it turns at 1 to 6 RPM. Every third body
    nutates: 5 to 25 % of its rate is across the axis.
    """
    shape, _, surface = name.partition("_")
    seed = crc32(name.encode())
    rng = np.random.default_rng([seed, 0x5E70])
    file = folder / f"{name}.glb"
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        file.write_bytes(mesh_file(SHAPES[shape](), surface, rng))
    rate_rpm = float(rng.uniform(1.0, 6.0) * rng.choice([-1.0, 1.0]))
    across = rate_rpm * float(rng.uniform(0.05, 0.25)) if BODIES.index(name) % 3 == 2 else 0.0
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    toward_sun = rng.normal(size=3) * [0.5, 0.4, 0.1] + [0.0, -0.3, -0.8]
    return Scene.model_validate(
        {
            "frames": FRAMES,
            "interval_s": INTERVAL_S,
            "truth_horizon_s": 5.0,
            "body": {
                "family": "mesh",
                "path": str(file),
                "metres_per_unit": 1.0,
                "contrast": 0.0 if surface == "bare" else 1.0,
            },
            "motion": {
                "position_m": (0.045, 0.0, float(rng.uniform(0.55, 0.7))),
                "velocity_mm_s": rng.uniform(-1.0, 1.0, 3).tolist(),
                "attitude_deg": _attitude_deg(rng).tolist(),
                "spin_rpm": (across * np.cos(turn), across * np.sin(turn), rate_rpm),
            },
            "rig": RIG,
            "light": {"sun_direction_N": toward_sun.tolist()},
            "sensor": {"white_dn": 250.0 if surface == "glitter" else 330.0},
        }
    ), seed


def _attitude_deg(rng: np.random.Generator) -> Array:
    """Rotation vector (3,) of R_NG: z of G 35 to 80 degrees from the line of sight, any turn about it."""
    away, around = np.deg2rad(rng.uniform(35.0, 80.0)), rng.uniform(0.0, 2.0 * np.pi)
    z = np.array([np.sin(away) * np.cos(around), np.sin(away) * np.sin(around), np.cos(away)])
    z *= rng.choice([-1.0, 1.0])
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    return np.rad2deg(log_so3(np.stack([x, np.cross(z, x), z], axis=1)))


def mesh_file(pieces: list[Piece], surface: str, rng: np.random.Generator) -> bytes:
    """A GLB of the pieces; images around them where the surface has marks, else names of materials."""
    scene = trimesh.Scene()
    for number, piece in enumerate(pieces):
        mesh, uv = turned(piece)
        label = (
            "foil gold blanket" if surface == "glitter" and piece.plain.startswith("white") else piece.plain
        )
        if surface in ("rich", "sparse"):
            ground = 0.75 if piece.plain.startswith("white") else 0.3
            marks = painted(_proportion(piece), ground, surface == "rich", rng)
            picture = Image.fromarray(marks).convert("RGB")
            material = PBRMaterial(
                name=label, baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=0.6
            )
            mesh.visual = TextureVisuals(uv=uv, material=material)
        scene.add_geometry(mesh, node_name=f"{label} {number}", geom_name=f"{label} {number}")
    content: bytes = scene.export(file_type="glb")
    return content


def turned(piece: Piece) -> tuple[trimesh.Trimesh, Array]:
    """The mesh of a piece and (n, 2) coordinates of its image: u around the axis, v along the profile."""
    line = np.array([*piece.profile, piece.profile[0]] if piece.closed else piece.profile)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    # the last meridian repeats the first one at u = 1
    u, v = np.meshgrid(np.linspace(0.0, 1.0, SECTIONS + 1), length / length[-1])
    angle, radius = 2.0 * np.pi * (u % 1.0), line[:, :1]
    vertices = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.repeat(line[:, 1:], SECTIONS + 1, 1)], -1
    )
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(each, -1).reshape(-1, 3) for each in ((a, b, c), (a, c, d))])
    mesh = trimesh.Trimesh(vertices.reshape(-1, 3), faces, process=False)
    mesh.update_faces(mesh.area_faces > 1e-12)
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh, np.stack([u, v], axis=-1).reshape(-1, 2)


def _proportion(piece: Piece) -> float:
    """Circumference over the length of the profile."""
    line = np.array(piece.profile)
    return float(2.0 * np.pi * line[:, 0].max() / np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def painted(proportion: float, ground: float, rich: bool, rng: np.random.Generator) -> Grey:
    """An image around a body (rows along the profile), grey values as sRGB: marks of any size, or a few."""
    width = 1536
    height = int(np.clip(width / proportion, 64, 2048))
    image = np.full((height, width), ground)
    rows, columns = np.mgrid[0:height, 0:width]
    count = int(rng.integers(250, 400)) if rich else int(rng.integers(3, 7))
    for _ in range(max(2, int(count * min(1.0, height / 700.0)))):
        size = float(np.exp(rng.uniform(np.log(8.0), np.log(160.0)))) if rich else float(rng.uniform(30, 90))
        row, column = rng.uniform(0, height), rng.uniform(0, width)
        # marks go around the seam
        across = (columns - column + 0.5 * width) % width - 0.5 * width
        along, tilt = rows - row, rng.uniform(0.0, np.pi)
        x, y = across * np.cos(tilt) + along * np.sin(tilt), along * np.cos(tilt) - across * np.sin(tilt)
        stretch = float(rng.uniform(0.3, 1.0))
        inside = (
            (np.abs(x) < size) & (np.abs(y) < stretch * size)
            if rng.random() < 0.6
            else x**2 + (y / stretch) ** 2 < size**2
        )
        image[inside] = np.clip(ground + rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.6), 0.05, 0.9)
    encoded = np.where(image <= 0.0031308, 12.92 * image, 1.055 * image ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)
