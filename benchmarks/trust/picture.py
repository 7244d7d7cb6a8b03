"""A contact sheet of new scenes and bodies of revolution."""

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from benchmarks.trust.new_scenes import KINDS, new_scene
from benchmarks.trust.revolution import SHAPES, SURFACES, body_scene
from polhode.simulation.dataset.frame_renderer import FrameRenderer
from polhode.simulation.dataset.plan import plan_sequence
from polhode.simulation.figures.contact_sheet import Strip, boxes_around, draw_sheet, strip_of_plan, tile_of


def draw_scenes(groups: Sequence[str], draw: int, folder: Path) -> Image.Image:
    """Four frames of each new scene; one of each body of revolution, a strip for each shape."""
    strips = []
    if "new" in groups:
        strips += [strip_of_plan(kind, plan_sequence(*new_scene(kind, draw))) for kind in KINDS]
    if "revolution" in groups:
        strips += [_shape(shape, folder) for shape in SHAPES]
    return draw_sheet(strips)


def _shape(shape: str, folder: Path) -> Strip:
    """The four surfaces of a shape."""
    tiles = []
    for surface in SURFACES:
        plan = plan_sequence(*body_scene(f"{shape}_{surface}", folder))
        image = FrameRenderer(plan).render_image(3, 0)[0]
        tiles.append(tile_of(image, plan.scene, boxes_around(plan, [3])[0]))
    return Strip(shape, SURFACES, tuple(tiles))
