"""Equipment of spacecraft, and its places on flat walls.

Each item is mounted on z = 0 of its own frame, z away from the wall. Feet extend slightly below z = 0, so
that no two faces of a body are coplanar. The exhaust of thrusters and engines is along z. The root of a solar
wing lies at the origin, the wing runs along x, cells face z.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from polhode.geometry.lie import Array, make_pose
from polhode.simulation.bodies.part import Part, moved, named
from polhode.simulation.bodies.solids import (
    Revolved,
    ball,
    box,
    drum,
    frame,
    pose,
    prism,
    radial,
    revolve,
    ring,
    strut,
    tube,
)
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface import materials as mat


def electronics_box(builder: PartBuilder, width_m: float, depth_m: float, height_m: float) -> list[Part]:
    """A box on a flange, with a labelled face and a row of connectors on one side."""
    rng = builder.rng
    base = float(rng.choice([0.06, 0.2, 0.35, 0.6]))
    # A share of 0.08 of the height lies below the wall.
    body = box([width_m, depth_m, height_m * 1.08], bevel=0.05, at=[0, 0, 0.5 * height_m * (1 - 0.08)])
    draw = builder.textures.panel(base, 0.8) if rng.random() < 0.75 else builder.textures.machined_plate()
    cover = builder.flat_part(body, mat.PAINT_GREY if base > 0.1 else mat.PAINT_BLACK, draw, "equipment")
    flange = box([1.14 * width_m, 1.14 * depth_m, 0.14 * height_m], bevel=0.1)
    count = int(rng.integers(2, 5))
    size = min(0.2 * height_m, 0.5 * width_m / count)
    sockets = []
    for k in range(count):
        socket = drum(0.5 * size, 0.6 * size, 12)
        x = (k + 0.5) / count * 0.8 * width_m - 0.4 * width_m
        socket.apply_transform(pose([0, 1, 0], [x, 0.5 * depth_m - 0.1 * size, 0.5 * height_m]))
        sockets.append((socket, mat.BRUSHED_METAL))
    return [cover, *named("equipment", (flange, mat.ANODISED), *sockets)]


def star_tracker(builder: PartBuilder, size_m: float) -> list[Part]:
    """A tilted, hollow baffle on a small box; size_m is the baffle's length."""
    s = size_m
    block = box([0.62 * s, 0.5 * s, 0.4 * s], bevel=0.08, at=[0, 0, 0.15 * s])
    lean = pose([builder.rng.uniform(-0.5, 0.5), builder.rng.uniform(-0.5, 0.5), 1.0], [0, 0, 0.28 * s])
    outer, wall = 0.34 * s, 0.025 * s
    profile = [(0, 0), (0.2 * s, 0), (0.2 * s, 0.15 * s), (outer, 0.75 * s), (outer, s),
               (outer - wall, s), (outer - wall, 0.74 * s), (0.15 * s, 0.2 * s), (0, 0.2 * s)]  # fmt: skip
    baffle = revolve(profile, 24).mesh
    inside = revolve([(0.149 * s, 0.21 * s), (outer - 1.2 * wall, 0.735 * s), (outer - 1.2 * wall, 0.97 * s),
                      (outer - 2 * wall, 0.97 * s), (outer - 2 * wall, 0.74 * s), (0.12 * s, 0.22 * s)],
                     24, closed=True).mesh  # fmt: skip
    lens = ball(0.13 * s, 16, 8, at=[0, 0, 0.13 * s])
    tube = named("star_tracker", (baffle, mat.PAINT_WHITE), (inside, mat.PAINT_BLACK), (lens, mat.GLASS))
    base = builder.flat_part(block, mat.PAINT_BLACK, builder.textures.panel(0.1, 0.5), "star_tracker")
    return [base, *moved(tube, lean)]


def sun_sensor(size_m: float) -> list[Part]:
    """A small box with a glass window."""
    body = box([size_m, size_m, 0.5 * size_m], bevel=0.12, at=[0, 0, 0.2 * size_m])
    window = drum(0.3 * size_m, 0.1 * size_m, 16, at=[0, 0, 0.4 * size_m])
    return named("sensor", (body, mat.BRUSHED_METAL), (window, mat.GLASS))


def camera_lens(size_m: float) -> list[Part]:
    """A barrel with a hood and a lens deep inside; size_m is the diameter."""
    s = 0.5 * size_m
    barrel = [(0, -0.2 * s), (s, -0.2 * s), (s, 0.9 * s), (1.12 * s, 0.95 * s), (1.12 * s, 1.7 * s),
              (1.04 * s, 1.7 * s), (0.82 * s, 0.6 * s), (0, 0.6 * s)]  # fmt: skip
    lens = [(0, 0.5 * s), (0.8 * s, 0.58 * s), (0.6 * s, 0.74 * s), (0.3 * s, 0.82 * s), (0, 0.85 * s)]
    collar = [(0.98 * s, 0.3 * s), (1.06 * s, 0.32 * s), (1.06 * s, 0.5 * s), (0.98 * s, 0.52 * s)]
    return named(
        "lens",
        (revolve(barrel, 32).mesh, mat.PAINT_BLACK),
        (revolve(lens, 32).mesh, mat.GLASS),
        (revolve(collar, 32, closed=True).mesh, mat.BRUSHED_METAL),
    )


def handrail(length_m: float, radius_m: float) -> list[Part]:
    """A bar on two posts, along x."""
    h, up = 0.5 * length_m, 5.0 * radius_m
    path = [[-h, 0, -radius_m], [-h, 0, 0.8 * up], [-h + 0.2 * up, 0, up], [h - 0.2 * up, 0, up],
            [h, 0, 0.8 * up], [h, 0, -radius_m]]  # fmt: skip
    return named("handrail", (tube(path, radius_m, 10), mat.PAINT_WHITE))


def grapple_pin(size_m: float) -> list[Part]:
    """A grapple fixture for a robot arm: a round base with a pin on three legs."""
    base = drum(0.5 * size_m, 0.12 * size_m, 28, bevel=0.2, at=[0, 0, -0.03 * size_m])
    top = np.array([0, 0, 0.45 * size_m])
    feet = [np.array([0.32 * np.cos(a), 0.32 * np.sin(a), 0.05]) * size_m for a in (0.3, 2.4, 4.5)]
    legs = [(strut(foot, top, 0.03 * size_m), mat.ANODISED) for foot in feet]
    pin = drum(0.06 * size_m, 0.35 * size_m, 14, at=[0, 0, 0.4 * size_m])
    knob = ball(0.09 * size_m, 14, 8, at=[0, 0, 0.77 * size_m])
    return named("grapple", (base, mat.BRUSHED_METAL), *legs, (pin, mat.ANODISED), (knob, mat.PAINT_WHITE))


def umbilical(builder: PartBuilder, size_m: float) -> list[Part]:
    """A plate with two round connectors and a few sockets."""
    plate = box([size_m, 0.7 * size_m, 0.12 * size_m], bevel=0.2)
    parts = [builder.flat_part(plate, mat.ANODISED, builder.textures.machined_plate(), "connector")]
    for x in (-0.24, 0.24):
        shell = ring(0.1 * size_m, 0.17 * size_m, 0.0, 0.16 * size_m, 20).mesh
        core = drum(0.09 * size_m, 0.12 * size_m, 16)
        for mesh in (shell, core):
            mesh.apply_translation([x * size_m, 0, -0.01 * size_m])
        parts += named("connector", (shell, mat.BRUSHED_METAL), (core, mat.PAINT_BLACK))
    return parts


def cable(points: Array, radius_m: float) -> list[Part]:
    """A harness along points (n, 3) with clamps at every other one."""
    parts = named("harness", (tube(points, radius_m, 8), mat.PAINT_BLACK))
    for point, ahead in zip(points[1:-1:2], points[2::2], strict=False):
        clamp = box([3.4 * radius_m, 3.4 * radius_m, 1.6 * radius_m], bevel=0.1)
        parts += moved(named("harness", (clamp, mat.BRUSHED_METAL)), pose(ahead - point, point))
    return parts


def hexagonal_can(builder: PartBuilder, size_m: float) -> list[Part]:
    """A six-sided canister with a lid."""
    angle = np.arange(6) * np.pi / 3
    outline = 0.5 * size_m * np.column_stack([np.cos(angle), np.sin(angle)])
    height = size_m * float(builder.rng.uniform(0.4, 0.8))
    can = prism(outline, 1.06 * height, taper=0.92, at=[0, 0, -0.06 * height])
    lid = drum(0.3 * size_m, 0.14 * size_m, 20, at=[0, 0, 0.96 * height])
    base = float(builder.rng.choice([0.08, 0.4, 0.7]))
    side = builder.flat_part(can, mat.PAINT_GREY, builder.textures.panel(base, 1.0), "equipment")
    return [side, *named("equipment", (lid, mat.COMPOSITE if base > 0.3 else mat.BRUSHED_METAL))]


def patch(builder: PartBuilder, size_m: float) -> list[Part]:
    """A flat square antenna: a ceramic tile on a plate, four screws."""
    plate = box([size_m, size_m, 0.12 * size_m], bevel=0.2)
    tile = box([0.72 * size_m, 0.72 * size_m, 0.12 * size_m], bevel=0.15, at=[0, 0, 0.1 * size_m])
    feed = drum(0.04 * size_m, 0.05 * size_m, 10, at=[0.1 * size_m, 0.06 * size_m, 0.14 * size_m])
    draw = builder.textures.plain(float(builder.rng.choice([0.3, 0.7])))
    bare = named("antenna", (plate, mat.ANODISED), (feed, mat.BRUSHED_METAL))
    return [bare[0], builder.flat_part(tile, mat.PAINT_GREY, draw, "antenna"), bare[1]]


def helix(length_m: float, radius_m: float) -> list[Part]:
    """A helix around a post on a round ground plate."""
    turns = max(3, int(length_m / (0.9 * radius_m)))
    angle = np.linspace(0, 2 * np.pi * turns, 10 * turns)
    path = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle),
                            0.06 * length_m + 0.92 * length_m * angle / angle[-1]])  # fmt: skip
    plate = drum(1.8 * radius_m, 0.14 * length_m, 28, at=[0, 0, -0.1 * length_m])
    post = strut([0, 0, -0.02 * length_m], [0, 0, length_m], 0.16 * radius_m)
    wire = tube(path, 0.1 * radius_m, 6)
    return named("antenna", (plate, mat.BRUSHED_METAL), (wire, mat.BRUSHED_METAL), (post, mat.PAINT_WHITE))


def whip(length_m: float, radius_m: float) -> list[Part]:
    """A rod on an insulator."""
    foot = drum(4.0 * radius_m, 8.0 * radius_m, 12, bevel=0.2, at=[0, 0, -2.0 * radius_m])
    rod = strut([0, 0, -0.9 * radius_m], [0, 0, length_m], radius_m, 6)
    return named("antenna", (foot, mat.PAINT_BLACK), (rod, mat.BRUSHED_METAL))


def horn(size_m: float) -> list[Part]:
    """A conical horn with corrugations; size_m is its height."""
    s = size_m
    profile = [(0, -0.05 * s), (0.16 * s, -0.05 * s), (0.16 * s, 0.2 * s), (0.32 * s, 0.7 * s),
               (0.35 * s, 0.72 * s), (0.35 * s, 0.78 * s), (0.4 * s, s),
               (0.375 * s, s), (0.28 * s, 0.66 * s), (0.12 * s, 0.25 * s), (0, 0.25 * s)]  # fmt: skip
    return named("antenna", (revolve(profile, 32).mesh, mat.ANODISED))


def paraboloid(diameter_m: float, focal_m: float, wall_m: float, sections: int, steps: int) -> Revolved:
    """A dish about z that opens towards +z, the vertex of its front at the origin, its rim folded back.

    Points 0 .. steps of the profile are the back from the axis to the rim, the last steps + 1 the front.
    """
    r = np.linspace(0.0, 0.5 * diameter_m, steps + 1)
    front = np.column_stack([r, r * r / (4.0 * focal_m)])
    back = np.column_stack([r, front[:, 1] - wall_m])
    rim = [(0.5 * diameter_m + wall_m, back[-1, 1] - wall_m), (0.5 * diameter_m + wall_m, front[-1, 1])]
    return revolve(np.vstack([back, rim, front[::-1]]), sections)


def small_dish(builder: PartBuilder, diameter_m: float) -> list[Part]:
    """A high-gain antenna on a gimballed mast: reflector with gores, feed on three struts."""
    rng, d, steps = builder.rng, diameter_m, 6
    focal, mast = 0.38 * d, 0.32 * d
    solid = paraboloid(d, focal, 0.012 * d, 40, steps)
    base = float(rng.choice([0.75, 0.75, 0.3]))
    last = len(solid.profile) - 1
    draw = builder.textures.reflector(base, int(rng.integers(6, 13)))
    parts = [builder.revolved_part(solid, [(last - steps, last - 1, draw)], mat.PAINT_WHITE, "dish")]
    for angle in np.arange(3) * 2 * np.pi / 3 + rng.uniform(0, 2):
        edge = 0.42 * d * radial(angle)
        edge[2] = 0.42**2 * d**2 / (4 * focal)
        parts += named("dish", (strut(edge, [0, 0, focal], 0.008 * d), mat.PAINT_WHITE))
    feed = drum(0.05 * d, 0.12 * d, 16, bevel=0.2, at=[0, 0, focal - 0.06 * d])
    hub = ball(0.07 * d, 16, 8, at=[0, 0, -0.07 * d])
    parts += named("dish", (feed, mat.COMPOSITE), (hub, mat.ANODISED))
    X = pose([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), 1.0], [0, 0, mast + 0.07 * d])
    post = strut([0, 0, -0.04 * d], [0, 0, mast], 0.03 * d, 14)
    return moved(parts, X) + named("mast", (post, mat.BRUSHED_METAL))


def bell(
    throat_m: float, exit_m: float, length_m: float, wall_m: float, sections: int, steps: int
) -> Revolved:
    """A nozzle from its throat at z = 0 to its exit, with a wall of real thickness and a closed throat.

    Radii and length [m]. The contour is a parabola that leaves the throat steeply (Rao's approximation).
    """
    t = np.linspace(0.0, 1.0, steps)
    radius = throat_m + (exit_m - throat_m) * (1.55 * t - 0.55 * t * t)
    outer = np.column_stack([radius + wall_m, length_m * t])
    inner = np.column_stack([radius, length_m * t])[::-1]
    neck = [(0.0, -0.3 * length_m), (throat_m + 1.5 * wall_m, -0.3 * length_m),
            (throat_m + wall_m, -0.08 * length_m)]  # fmt: skip
    return revolve(np.vstack([neck, outer, inner, [(0.0, 0.0)]]), sections)


def thruster(size_m: float) -> list[Part]:
    """A small thruster: valve, chamber, bell; size_m is the diameter of the exit."""
    r = 0.5 * size_m
    nozzle = bell(0.3 * r, r, 2.2 * r, 0.12 * r, 20, 6).mesh
    nozzle.apply_translation([0, 0, 1.4 * r])
    valve = drum(0.75 * r, 1.1 * r, 14, bevel=0.15, at=[0, 0, -0.2 * r])
    return named("thruster", (nozzle, mat.DARK_METAL), (valve, mat.BRUSHED_METAL))


def thruster_block(builder: PartBuilder, size_m: float) -> list[Part]:
    """A block with thrusters on its sides and one on top; size_m is the block's width."""
    block = box([size_m, size_m, 0.85 * size_m], bevel=0.12, at=[0, 0, 0.34 * size_m])
    draw = builder.textures.panel(float(builder.rng.choice([0.1, 0.6])), 0.6)
    parts = [builder.flat_part(block, mat.PAINT_BLACK, draw, "thruster")]
    directions = np.array([[1.0, 0, 0.15], [-1.0, 0, 0.15], [0, 1.0, 0.15]])
    for direction in directions[: int(builder.rng.integers(2, 4))]:
        at = np.array([0, 0, 0.42 * size_m]) + 0.48 * size_m * direction
        parts += moved(thruster(0.42 * size_m), pose(direction, at))
    return parts


def engine(builder: PartBuilder, exit_m: float, length_m: float) -> list[Part]:
    """A main engine with the throat at z = 0: bell, chamber, pumps, feed lines, gimbal struts.

    exit_m is the radius of the exit, length_m the length of the bell; all ends at z = -length_m / 2.
    """
    rng, t, ell = builder.rng, 0.2 * exit_m, length_m
    solid = bell(t, exit_m, ell, 0.022 * exit_m, 56, 11)
    # Points 3 .. 13 of the profile are the outer skin from the throat down to the exit.
    wall = [(3, 13, builder.textures.nozzle_wall())]
    parts = [builder.revolved_part(solid, wall, mat.DARK_METAL, "nozzle", 2.0)]
    chamber = revolve([(0, -0.5 * ell), (1.3 * t, -0.5 * ell), (1.9 * t, -0.42 * ell), (1.9 * t, -0.22 * ell),
                       (1.1 * t, -0.04 * ell), (0, -0.04 * ell)], 32).mesh  # fmt: skip
    parts += named("engine", (chamber, mat.DARK_METAL), density_factor=2.0)
    for angle in rng.uniform(0, 2 * np.pi) + np.array([0.0, 2.2, 4.0]):
        out = radial(angle)
        pump = drum(0.9 * t, 0.3 * ell, 20, bevel=0.25)
        pump.apply_transform(pose([0, 0, 1.0], 2.6 * t * out + [0, 0, -0.48 * ell]))
        pump_material = mat.BRUSHED_METAL if rng.random() < 0.6 else mat.PAINT_BLACK
        line = np.array([2.6, 2.7, 2.0, 1.0])[:, None] * t * out
        line[:, 2] = np.array([-0.2, -0.1, 0.02, 0.06]) * ell
        feed_line = tube(line, 0.22 * t, 10)
        foot, top = 4.2 * t * out + [0, 0, -0.5 * ell], 1.8 * t * out + [0, 0, -0.25 * ell]
        metal = [(mesh, mat.BRUSHED_METAL) for mesh in (feed_line, strut(foot, top, 0.16 * t))]
        parts += named("engine", (pump, pump_material), *metal)
    rim = ring(1.12 * exit_m, 1.17 * exit_m, 0.0, 0.035 * exit_m, 56).mesh
    rim.apply_scale([0.885, 0.885, 1.0])
    rim.apply_translation([0, 0, ell - 0.036 * exit_m])
    return parts + named("nozzle", (rim, mat.BRUSHED_METAL), density_factor=2.0)


def bottle(radius_m: float, rng: np.random.Generator) -> list[Part]:
    """A pressure bottle around the origin with a band and two bosses."""
    material = [mat.COMPOSITE, mat.FOIL_GOLD, mat.FOIL_BLACK, mat.BRUSHED_METAL][int(rng.integers(4))]
    sphere = ball(radius_m, 28, 16)
    band = ring(0.99 * radius_m, 1.03 * radius_m, -0.08 * radius_m, 0.08 * radius_m, 28).mesh
    boss = drum(0.16 * radius_m, 2.2 * radius_m, 12, at=[0, 0, -1.1 * radius_m])
    return named("bottle", (sphere, material), (band, mat.BRUSHED_METAL), (boss, mat.BRUSHED_METAL))


def solar_wing(
    builder: PartBuilder,
    length_m: float,
    width_m: float,
    thickness_m: float,
    panels: int,
    yoke_m: float,
    cell: int,
) -> list[Part]:
    """A wing of several panels, length_m long without the yoke; ``cell``: length of a cell in texels."""
    rng, w, thick = builder.rng, width_m, thickness_m
    gap = 0.02 * length_m
    each = (length_m - (panels - 1) * gap) / panels
    parts = []
    for k in range(panels):
        middle = yoke_m + k * (each + gap) + 0.5 * each
        # Hinges do not all open by exactly the same angle.
        angle = rng.normal(0, 0.012)
        c, s = np.cos(angle), np.sin(angle)
        bend = make_pose(np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]), [middle, 0, 0])
        parts += moved(_panel(builder, each, w, thick, cell), bend)
        for side in (-0.3, 0.3) if k > 0 else ():
            hinge = drum(1.4 * thick, 0.12 * w, 12)
            at = [middle - 0.5 * (each + gap), side * w - 0.06 * w, -0.5 * thick]
            hinge.apply_transform(pose([0, 1.0, 0], at))
            parts += named("hinge", (hinge, mat.BRUSHED_METAL))
    # A V of two bars from the drive to the first panel's edge.
    radius = max(0.6 * thick, 0.012 * w)
    drive = drum(0.05 * w + radius, 0.2 * w, 20)
    drive.apply_transform(pose([1.0, 0, 0], [-0.1 * w, 0, 0]))
    parts += named("hinge", (drive, mat.ANODISED))
    for side in (-0.36, 0.36):
        root, tip = [0.0, 0.06 * np.sign(side) * w, 0], [yoke_m + 0.01 * w, side * w, 0]
        material = mat.COMPOSITE if rng.random() < 0.5 else mat.BRUSHED_METAL
        parts += named("hinge", (strut(root, tip, radius, 10), material))
    return parts


def _panel(builder: PartBuilder, length_m: float, w: float, thick: float, cell: int) -> list[Part]:
    """A panel: cells in front; stiffeners and a harness on the back, so that it is not a bare sheet."""
    board = box([length_m, w, thick], bevel=0.15)
    front = builder.textures.cells(cell)
    back = builder.textures.panel(float(builder.rng.choice([0.12, 0.25, 0.35, 0.6])), 0.45)
    sheets = [None, None, None, None, back, front]
    parts = [builder.flat_part(board, mat.SOLAR_CELL, sheets, "panel", 0.6, np.array([0.0, 1.0, 0.0]))]
    extents = [0.94 * length_m, 0.035 * w, 1.2 * thick]
    ribs = [box(extents, bevel=0.2, at=[0, y * w, -0.9 * thick]) for y in (-0.32, 0.32)]
    lead = strut([-0.48 * length_m, 0.05 * w, -0.7 * thick], [0.48 * length_m, 0.02 * w, -0.7 * thick],
                 0.35 * thick)  # fmt: skip
    backs = [*((rib, mat.COMPOSITE) for rib in ribs), (lead, mat.PAINT_BLACK)]
    return parts + named("panel", *backs, density_factor=0.6)


Catalogue = list[tuple[Callable[[], list[Part]], float]]
"""Functions that make an item, and the radius [m] that it needs."""


class Deck:
    """A rectangular wall in the frame X_G (4, 4): origin at its centre, z outward."""

    def __init__(self, X_G: Array, width_m: float, height_m: float) -> None:
        self.X_G, self.width_m, self.height_m = X_G, width_m, height_m
        self._taken: list[tuple[float, float, float]] = []

    def reserve(self, x_m: float, y_m: float, radius_m: float) -> None:
        """Reserve a disc."""
        self._taken.append((x_m, y_m, radius_m))

    def put(self, parts: list[Part], x_m: float, y_m: float, turn: float = 0.0) -> list[Part]:
        """The parts at a position on the wall, rotated about its normal [rad]."""
        return moved(parts, self.X_G @ pose([0, 0, 1.0], [x_m, y_m, 0.0], turn))

    def place(self, make: Callable[[], list[Part]], radius_m: float, rng: np.random.Generator) -> list[Part]:
        """The parts of ``make`` at a free position, rotated by multiples of 90 degrees; none if 24 tries find
        no room."""
        reach = 0.5 * np.array([self.width_m, self.height_m]) - radius_m
        for _ in range(24 if (reach > 0).all() else 0):
            x, y = rng.uniform(-reach, reach).tolist()
            if all(np.hypot(x - a, y - b) > radius_m + r for a, b, r in self._taken):
                self.reserve(x, y, radius_m)
                return self.put(make(), x, y, turn=float(rng.integers(4)) * np.pi / 2)
        return []


def decks_of_box(size_m: Array, centre_G: Array) -> dict[str, Deck]:
    """The six walls of a box by the names +x, -x, +y, -y, +z, -z."""
    decks = {}
    for axis in range(3):
        for sign in (1.0, -1.0):
            z = sign * np.eye(3)[axis]
            X = frame(np.eye(3)[(axis + 1) % 3], z, centre_G + 0.5 * size_m[axis] * z)
            name = ("+" if sign > 0 else "-") + "xyz"[axis]
            decks[name] = Deck(X, float(size_m[(axis + 1) % 3]), float(size_m[(axis + 2) % 3]))
    return decks


def fit_out(deck: Deck, size_m: float, builder: PartBuilder, boxes: int, small: int) -> list[Part]:
    """At most that many boxes and small items on a wall, sized relative to the body, size_m [m]; then tie
    points for cables."""
    rng, s = builder.rng, size_m
    parts = []
    for _ in range(boxes):
        w, d, h = s * rng.uniform((0.12, 0.12, 0.05), (0.26, 0.26, 0.1))
        parts += deck.place(partial(electronics_box, builder, w, d, h), 0.6 * float(np.hypot(w, d)), rng)
    catalogue: Catalogue = [
        (partial(star_tracker, builder, 0.17 * s), 0.12 * s),
        (partial(thruster_block, builder, 0.08 * s), 0.1 * s),
        (partial(sun_sensor, 0.05 * s), 0.04 * s),
        (partial(patch, builder, 0.11 * s), 0.08 * s),
        (partial(handrail, 0.2 * s, 0.006 * s), 0.12 * s),
        (partial(hexagonal_can, builder, 0.12 * s), 0.08 * s),
        (partial(umbilical, builder, 0.14 * s), 0.1 * s),
        (partial(helix, 0.16 * s, 0.03 * s), 0.06 * s),
        (partial(whip, 0.3 * s, 0.004 * s), 0.03 * s),
        (partial(grapple_pin, 0.12 * s), 0.08 * s),
    ]
    for _ in range(small):
        parts += deck.place(*catalogue[int(rng.integers(len(catalogue)))], rng)
    clamp = named("fitting", (box([0.03 * s, 0.012 * s, 0.02 * s], bevel=0.2), mat.BRUSHED_METAL))
    for _ in range(2 * small):
        parts += deck.place(lambda: clamp, 0.03 * s, rng)
    return parts
