"""Solar wings: hinged panels on a yoke. The root lies at the origin, the wing runs along x, cells face z."""

import numpy as np

from polhode.lie import Array
from polhode.simulation.bodies.parts.part import Part
from polhode.simulation.bodies.parts.solids import box, drum, pose, strut
from polhode.simulation.bodies.textures.canvas import Draw
from polhode.simulation.bodies.textures.part_builder import PartBuilder
from polhode.simulation.surface.materials import ANODISED, BRUSHED_METAL, COMPOSITE, PAINT_BLACK, SOLAR_CELL


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
    rng = builder.rng
    gap = 0.02 * length_m
    each = (length_m - (panels - 1) * gap) / panels
    parts = []
    for k in range(panels):
        middle = yoke_m + k * (each + gap) + 0.5 * each
        # Hinges do not all open by exactly the same angle.
        bend = pose([0, 0, 1.0], [middle, 0, 0])
        bend[:3, :3] = _turn_y(rng.normal(0, 0.012))
        parts += [part.moved(bend) for part in _panel(builder, each, width_m, thickness_m, cell)]
        if k > 0:
            for side in (-0.3, 0.3):
                hinge = drum(1.4 * thickness_m, 0.12 * width_m, 12)
                at = [middle - 0.5 * (each + gap), side * width_m - 0.06 * width_m, -0.5 * thickness_m]
                hinge.apply_transform(pose([0, 1.0, 0], at))
                parts.append(Part(hinge, BRUSHED_METAL, name="hinge"))
    return parts + _yoke(builder, width_m, thickness_m, yoke_m)


def _panel(
    builder: PartBuilder, length_m: float, width_m: float, thickness_m: float, cell: int
) -> list[Part]:
    board = box([length_m, width_m, thickness_m], bevel=0.15)
    front, back, edge = builder.textures.cells(cell), _back(builder), 0.9

    def draw(normal: Array) -> Draw | None:
        if normal[2] > edge:
            return front
        return back if normal[2] < -edge else None

    parts = [
        builder.flat_part_by_side(board, SOLAR_CELL, draw, "panel", 0.6, down_G=np.array([0.0, 1.0, 0.0]))
    ]
    # Stiffeners and a harness on the back, so that it is not a bare sheet.
    for y in (-0.32, 0.32):
        rib = box(
            [0.94 * length_m, 0.035 * width_m, 1.2 * thickness_m],
            bevel=0.2,
            at=[0, y * width_m, -0.9 * thickness_m],
        )
        parts.append(Part(rib, COMPOSITE, name="panel", density_factor=0.6))
    lead = strut([-0.48 * length_m, 0.05 * width_m, -0.7 * thickness_m],
                 [0.48 * length_m, 0.02 * width_m, -0.7 * thickness_m], 0.35 * thickness_m)  # fmt: skip
    return [*parts, Part(lead, PAINT_BLACK, name="panel", density_factor=0.6)]


def _back(builder: PartBuilder) -> Draw:
    rng = builder.rng
    return builder.textures.panel(float(rng.choice([0.12, 0.25, 0.35, 0.6])), 0.45)


def _yoke(builder: PartBuilder, width_m: float, thickness_m: float, yoke_m: float) -> list[Part]:
    """A V of two bars from the drive to the first panel's edge."""
    radius = max(0.6 * thickness_m, 0.012 * width_m)
    drive = drum(0.05 * width_m + radius, 0.2 * width_m, 20)
    drive.apply_transform(pose([1.0, 0, 0], [-0.1 * width_m, 0, 0]))
    parts = [Part(drive, ANODISED, name="hinge")]
    for side in (-0.36, 0.36):
        bar = strut(
            [0.0, 0.06 * np.sign(side) * width_m, 0], [yoke_m + 0.01 * width_m, side * width_m, 0], radius, 10
        )
        parts.append(Part(bar, COMPOSITE if builder.rng.random() < 0.5 else BRUSHED_METAL, name="hinge"))
    return parts


def _turn_y(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
