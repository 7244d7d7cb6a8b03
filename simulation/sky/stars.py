"""A field of stars, fixed in N, and its image: points blurred by the lens, at sub-pixel positions.

Numbers follow the counts over the whole sky, log10 N(< m) = 0.51 m + 0.64: 4 stars to magnitude 0, 1550 to 5,
9000 to 6.5 (Bright Star Catalogue, Hoffleit and Warren 1991: 9096). Directions are uniform: no Milky Way.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from polhode.errors import InputError
from polhode.lie import Array
from polhode.simulation.camera.cameras import Camera

SLOPE, AT_ZERO = 0.51, 0.64
MAX_MAGNITUDE = 10.0
"""The law of star counts is valid up to this magnitude, and fainter stars are invisible."""


@dataclass(frozen=True)
class Stars:
    """n stars, the brightest first."""

    direction_N: Array
    """(n, 3) unit"""
    magnitude: Array
    """(n,)"""


def star_field(faintest_magnitude: float, seed: int) -> Stars:
    """The stars down to a magnitude; a fainter limit adds stars without changing the others.

    Raises InputError: the limit is beyond magnitude 10.
    """
    if faintest_magnitude > MAX_MAGNITUDE:
        raise InputError(
            f"scene.background.faintest_magnitude: {faintest_magnitude:g} is fainter than {MAX_MAGNITUDE:g}, "
            "where star counts follow another law; give a smaller number"
        )
    # A Poisson process of the cumulative number: its n-th event is the n-th brightest star.
    expected = 10 ** (SLOPE * faintest_magnitude + AT_ZERO)
    most = int(expected + 8 * np.sqrt(expected) + 8)
    number = np.cumsum(np.random.default_rng([seed, 0x4, 0]).exponential(size=most))
    magnitude = (np.log10(number) - AT_ZERO) / SLOPE
    direction = np.random.default_rng([seed, 0x4, 1]).normal(size=(most, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    kept = magnitude <= faintest_magnitude
    return Stars(direction[kept], magnitude[kept])


def image_of_stars(stars: Stars, camera: Camera, X_NK: Array, blur_px: float, covered: Array) -> Array:
    """Light (H, W) of the stars: 1 in the brightest pixel of one of magnitude 0 at the pixel's centre.

    X_NK (S, 4, 4): camera poses during the exposure, each with its share of the light. ``covered`` (H, W):
    share of each pixel that hides the stars. The lens spreads a star over a Gaussian of ``blur_px``.
    """
    image = np.zeros((camera.height_px, camera.width_px))
    flux = 10 ** (-0.4 * stars.magnitude) / _peak(blur_px)
    reach = int(np.ceil(4.0 * blur_px + 1.0))
    for X in X_NK:
        uv, index = camera.project_visible(stars.direction_N @ X[:3, :3], margin_px=reach)
        nearest = np.clip(np.rint(uv).astype(int), 0, [camera.width_px - 1, camera.height_px - 1])
        seen = 1.0 - covered[nearest[:, 1], nearest[:, 0]]
        _add_points(image, uv, flux[index] * seen / len(X_NK), blur_px, reach)
    return image


def _add_points(image: Array, uv: Array, flux: Array, blur_px: float, reach: int) -> None:
    """Add points of light at uv (n, 2) to the image, each pixel with the light that falls on its square."""
    steps = np.arange(-reach, reach + 1)
    places, shares = [], []
    for axis in (0, 1):
        place = np.rint(uv[:, axis, None]).astype(int) + steps
        places.append(place)
        shares.append(_share(place - uv[:, axis, None], blur_px))
    u, v = places[0][:, None, :], places[1][:, :, None]
    light = flux[:, None, None] * shares[0][:, None, :] * shares[1][:, :, None]
    height, width = image.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    np.add.at(image.reshape(-1), (v * width + u)[inside], light[inside])


def _share(offset_px: Array, blur_px: float) -> Array:
    """Share of a Gaussian line of light that falls on pixels whose centres lie at offsets from it."""
    sigma = max(blur_px, 1e-6)
    return np.asarray(ndtr((offset_px + 0.5) / sigma) - ndtr((offset_px - 0.5) / sigma))


def _peak(blur_px: float) -> float:
    """Share of a star's light in its pixel when it stands at the centre."""
    return float(_share(np.zeros(1), blur_px)[0] ** 2)
