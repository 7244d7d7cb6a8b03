"""Range images of a plan: what a flash LIDAR or a depth camera with the left camera's lens measures.

One ray goes through the centre of each pixel at the time of the timestamp. To its depth come the noise of
the model, rounding to the unit of the file, and what such sensors do where a pixel sees two surfaces or none
well:

- at an edge (a neighbour is on another surface, or beside the target) a share of the pixels has no
  measurement, and a share of the others has a depth between the two surfaces (a mixed pixel);
- a surface that is seen at a flatter angle than ``max_incidence_deg`` returns nothing.

Left out: multipath (light that arrives over another surface), crosstalk between pixels, and errors that
depend on the reflectance.
"""

import numpy as np
from numpy.typing import NDArray

from polhode.config.scene_settings import RangeSensor
from polhode.geometry.lie import Array, Bools
from polhode.records.range_images import RangeModel
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.stereo_camera import Camera

MAX_UNITS = 2**16 - 1
EDGE_STEP_PX = 6.0
"""Neighbours whose depths differ by more than the width of so many pixels there are on two surfaces, since
one surface would be seen at 80 degrees or flatter."""


def model_of(sensor: RangeSensor) -> RangeModel:
    """What the range images of a scene state of themselves."""
    return RangeModel(sensor.scale_m, sensor.sigma_m, sensor.growth_per_m)


def render_ranges(
    caster: RayCaster,
    camera: Camera,
    X_GK: Array,
    sensor: RangeSensor,
    rng: np.random.Generator,
    behind: tuple[Array, Array] | None = None,
) -> NDArray[np.uint16]:
    """The range image (H, W) of a camera at X_GK (4, 4) as stored.

    behind: depth [m] and cosine (H, W), as of ``true_depth``, of what stands behind the target.
    """
    depth_m, cosine = true_depth(caster, camera, X_GK)
    if behind is not None:
        off = ~np.isfinite(depth_m)
        depth_m, cosine = np.where(off, behind[0], depth_m), np.where(off, behind[1], cosine)
    return measure(depth_m, cosine, float(camera.K[0, 0]), sensor, rng)


def true_depth(caster: RayCaster, camera: Camera, X_GK: Array) -> tuple[Array, Array]:
    """Depth along the optical axis [m], and the cosine between ray and normal (H, W); NaN off the target."""
    rays_K = camera.pixel_directions
    hits = caster.first_hits(X_GK[:3, 3], rays_K @ X_GK[:3, :3].T)
    shape = camera.height_px * camera.width_px
    depth_m, cosine = np.full(shape, np.nan), np.full(shape, np.nan)
    depth_m[hits.ray] = hits.distance_m * rays_K[hits.ray, 2]
    normal_K = hits.flat_normal_G @ X_GK[:3, :3]
    cosine[hits.ray] = np.abs(np.einsum("nk,nk->n", normal_K, rays_K[hits.ray]))
    size = camera.height_px, camera.width_px
    return depth_m.reshape(size), cosine.reshape(size)


def measure(
    depth_m: Array, cosine: Array, focal_px: float, sensor: RangeSensor, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """True depths (H, W) as the sensor gives them, in units of its scale; 0: no measurement."""
    shape = depth_m.shape
    draws = {name: rng.random(shape) for name in ("neighbour", "share", "mixed", "dropped")}
    noise = rng.standard_normal(shape)
    other_m, at_edge = _other_surface(depth_m, EDGE_STEP_PX * depth_m / focal_px, draws["neighbour"])
    mixed = at_edge & np.isfinite(other_m) & (draws["mixed"] < sensor.mixed_pixels)
    seen_m = np.where(mixed, depth_m + draws["share"] * (other_m - depth_m), depth_m)
    measured_m = seen_m + noise * model_of(sensor).sigma_at(np.nan_to_num(seen_m))
    with np.errstate(invalid="ignore"):
        units = np.round(measured_m / sensor.scale_m)
        returned = cosine >= np.cos(np.deg2rad(sensor.max_incidence_deg))
        valid = returned & (units >= 1) & (units <= MAX_UNITS)
    valid &= ~(at_edge & (draws["dropped"] < sensor.edge_dropouts))
    return np.where(valid, np.nan_to_num(units), 0).astype(np.uint16)


def _other_surface(depth_m: Array, least_step_m: Array, choice: Array) -> tuple[Array, Bools]:
    """Depth (H, W) of a neighbour on another surface, one of them by ``choice`` in [0, 1), NaN beside the
    target; and whether there is one."""
    # Beyond the image, that of the border.
    padded, (height, width) = np.pad(depth_m, 1, mode="edge"), depth_m.shape
    neighbours = np.stack(
        [padded[v : v + height, u : u + width] for v, u in ((1, 2), (1, 0), (2, 1), (0, 1))]
    )
    with np.errstate(invalid="ignore"):
        jump = np.abs(neighbours - depth_m) > least_step_m
    is_other = np.isfinite(depth_m) & (jump | ~np.isfinite(neighbours))
    count, rank = is_other.sum(axis=0), np.cumsum(is_other, axis=0)
    chosen = (is_other & (rank == 1 + np.floor(choice * count))).argmax(axis=0)
    other_m = np.take_along_axis(neighbours, chosen[None], axis=0)[0]
    return np.where(count > 0, other_m, np.nan), count > 0
