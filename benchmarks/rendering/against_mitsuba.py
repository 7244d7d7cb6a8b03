"""Our shading against Mitsuba's path tracer, on one scene with every kind of surface that both can show.

    python -m benchmarks.rendering.against_mitsuba [-o docs/images/mitsuba.png] [--width 320] [--samples 1600]

A deck of boxes, drawings, solar cells, a mast, a metal tank and a nozzle, which cast shadows on each other.
Prints one row for each light; draws ours, Mitsuba's and ten times the difference for the last. The peer is
the extra ``peers``. Full scale is the level that the default sensor brings to 255. The last columns compare
processor times [s] of an image with 16 samples a pixel, scene and compiled code at hand, and tell the mean
error that Mitsuba's has then: its light is drawn at random, where ours is integrated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time
from typing import Annotated, Literal

import numpy as np
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter
from tyro.conf import arg

from benchmarks.command import Png, command
from benchmarks.rendering.mitsuba_scene import PeerLights, deck, load, render
from polhode.config import scene as config
from polhode.lie import Array, exp_so3, inverse_pose, make_pose
from polhode.records import Bools
from polhode.simulation.bodies.part import assemble
from polhode.simulation.dataset.frame_renderer import Products, render_products
from polhode.simulation.rendering.render import Renderer
from polhode.simulation.stereo_camera import Camera, build_cameras

FULL_SCALE = 255.0 / config.Sensor().white_dn
"""Level of a saturated pixel."""
EDGE_PX = 2
"""Pixels so near to a silhouette or a shadow's edge are left out: they measure where the samples fall."""
SAME_FACE_M, SAME_FACE_COSINE = 2e-3, 0.9
"""Neighbours on one face: so near to its plane, with normals so alike."""
SAMPLES = 16
"""A pixel, of our image and of both when their times are compared."""
X_NG = make_pose(exp_so3([2.35, 0.0, 0.0]) @ exp_so3([0.0, 0.0, 0.4]), [0.01, 0.01, 0.66])
SUN_N = (0.7, -0.55, -0.45)
EARTH_N = (-0.6, 0.5, -0.6)


@dataclass(frozen=True)
class RenderingCase:
    """What lights the deck."""

    name: str
    sun: float = 1.0
    sun_diameter_deg: float = 0.0
    earth: float = 0.0
    bounces: Literal[0, 1] = 0


CASES = (
    RenderingCase("point Sun"),
    RenderingCase("Sun of 0.533 deg", sun_diameter_deg=0.533),
    RenderingCase("Sun of 5 deg", sun_diameter_deg=5.0),
    RenderingCase("Earth alone", sun=0.0, earth=0.4),
    RenderingCase("Sun, one bounce", sun_diameter_deg=0.533, bounces=1),
    RenderingCase("Sun and Earth, one bounce", sun_diameter_deg=0.533, earth=0.15, bounces=1),
)


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

    def row(self) -> str:
        """Statistics in per cent of full scale."""
        error = 100 * np.abs(self.difference)
        p95, p99 = np.percentile(error, [95, 99])
        return (
            f"{100 * self.difference.mean():+.3f} | {error.mean():.3f} | {p95:.3f} | {p99:.3f} | "
            f"{error.max():.2f} | {100 * (error < 3).mean():.2f} | {self.compared.sum()} | "
            f"{self.ours_s:.2f} | {self.theirs_s:.2f} | "
            f"{100 * np.abs(self.noise[self.compared]).mean() / FULL_SCALE:.3f}"
        )


HEAD = (
    "bias | mean | 95 % | 99 % | max | share within 3 [%] | pixels | ours [s] | Mitsuba [s] | its error then"
)


def compare(case: RenderingCase, width_px: int = 96, samples: int = 64) -> ImageComparison:
    """Render the deck with both programs: ours with SAMPLES a pixel, Mitsuba's with ``samples``."""
    rig = config.Rig(width_px=width_px, height_px=width_px * 3 // 4, focal_px=1.15 * width_px)
    camera, _ = build_cameras(rig)
    parts, X_GN = deck(), inverse_pose(X_NG)
    light = config.Light(
        sun=case.sun,
        sun_direction_N=SUN_N,
        sun_diameter_deg=case.sun_diameter_deg,
        earth_direction_N=EARTH_N,
        earth=case.earth,
    )
    scene = config.Scene(light=light, render=config.Render(samples=SAMPLES, bounces=case.bounces))
    renderer = Renderer(assemble(parts), scene, 0)
    ours = renderer.picture(camera, np.eye(4), X_NG).level
    to_sun, to_earth = (X_GN[:3, :3] @ np.array(d) / np.linalg.norm(d) for d in (SUN_N, EARTH_N))
    lights = PeerLights(to_sun, case.sun, case.sun_diameter_deg, to_earth, case.earth, light.earth_radius_deg)
    peer = load(parts, lights, camera, X_GN, samples, case.bounces)
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
    panels = [ours, theirs, np.clip(0.5 + 10 * (ours - theirs), 0, 1)]
    gap = np.ones((ours.shape[0], 4))
    row = np.hstack([panels[0], gap, panels[1], gap, panels[2]])
    return Image.fromarray(np.rint(255 * row).astype(np.uint8))


def main(
    output: Png = None,
    width: Annotated[int, arg(help="Width of the image [px]; the height is 3/4 of it.")] = 320,
    samples: Annotated[int, arg(help="Samples a pixel of Mitsuba; fewer for direct light.")] = 1600,
) -> None:
    """Print the table; draw the last case when asked."""
    print(f"| light | {HEAD} |\n|{'---|' * (HEAD.count('|') + 2)}")
    for case in CASES:
        # Direct light is almost free of noise; light by way of a mirror is not.
        rays = samples if case.bounces else min(samples, 144)
        comparison = compare(case, width, rays)
        print(f"| {case.name} | {comparison.row()} |", flush=True)
        if output and case == CASES[-1]:
            picture(comparison).save(output, optimize=True)


if __name__ == "__main__":
    command(main)
