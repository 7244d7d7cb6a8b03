"""Facets without texture: planes held by their outlines, and no plane where there is none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from polhode.frontend.disparity.classical import fit_facets, fit_planes, textureless_patches
from polhode.geometry.lie import Array

Facet = tuple[NDArray[np.float32], NDArray[np.float32]]
V, U = np.mgrid[:100, :140].astype(np.float64)
PANEL = (V >= 20) & (V < 80) & (U >= 30) & (U < 110)
PLANE = 40.0 + 0.08 * (U - 70) - 0.05 * (V - 50)


def by_windows(true: Array) -> Facet:
    """What windows find: right along the outline, anything inside."""
    rng = np.random.default_rng(1)
    inside = (V >= 24) & (V < 76) & (U >= 34) & (U < 106)
    disparity = true + np.where(inside, rng.normal(1.5, 3.0, true.shape), rng.normal(0.0, 0.05, true.shape))
    disparity, sigma = (np.where(PANEL, each, np.nan) for each in (disparity, np.where(inside, 4.0, 0.08)))
    return disparity.astype(np.float32), sigma.astype(np.float32)


def facets(intensity: Array | float, windows: Facet) -> Facet:
    """Of a panel of the given intensity on a background of another, with sensor noise."""
    noisy = np.where(PANEL, intensity, 25.0) + np.random.default_rng(0).normal(0.0, 1.0, PANEL.shape)
    image = np.clip(np.round(noisy), 0, 255).astype(np.uint8)
    return fit_facets(image, PANEL, *windows, 49.0, darkest=15.0)


def test_the_inside_of_a_panel_follows_from_its_outline() -> None:
    value, sigma = facets(120.0, by_windows(PLANE))
    found = np.isfinite(value)
    assert found[PANEL].mean() > 0.8 and not found[~PANEL].any()
    assert np.abs(value - PLANE)[found].max() < 0.15
    assert np.all(np.abs(value - PLANE)[found] < 3 * sigma[found])
    # one edge that belongs to something nearer does not tilt the plane
    disparity, sigma = by_windows(PLANE)
    disparity[:, 106:] += 6.0
    assert np.nanmax(np.abs(facets(120.0, (disparity, sigma))[0] - PLANE)) < 0.3


@pytest.mark.parametrize(
    ("intensity", "bulge"),
    [(120.0 * np.sqrt(np.clip(1.0 - ((U - 70) / 45.0) ** 2, 0.05, 1.0)), 0.0), (120.0, 0.004), (10.0, 0.0)],
    ids=["shaded surface", "curved outline", "nearly dark"],
)
def test_what_is_no_lit_plane_is_left_out(intensity: Array | float, bulge: float) -> None:
    value, _ = facets(intensity, by_windows(PLANE + bulge * (U - 70) ** 2))
    assert not np.isfinite(value).any()


def test_away_from_its_only_evidence_a_plane_is_less_certain() -> None:
    disparity, sigma = by_windows(PLANE)
    sigma[:, 34:] = 4.0
    sigma[:, :34][np.isfinite(sigma[:, :34])] = 0.08
    disparity[:, 34:] = np.nan
    _, spread = facets(120.0, (disparity, sigma))
    assert spread[50, 100] > 3 * spread[50, 40]


def test_texture_leaves_no_even_patch() -> None:
    rng = np.random.default_rng(3)
    painted = np.repeat(np.repeat(rng.uniform(60, 200, (25, 35)), 4, axis=0), 4, axis=1)
    labels, _ = textureless_patches(painted.astype(np.uint8), np.ones(painted.shape, dtype=bool))
    assert (labels > 0).mean() < 0.02


@pytest.mark.parametrize(("amplitude_px", "limit_px"), [(0.0, 0.03), (0.6, 0.12)])
def test_planes_smooth_a_flat_surface_and_keep_a_rough_one(amplitude_px: float, limit_px: float) -> None:
    true = PLANE + amplitude_px * np.sin(U / 3.5) * np.sin(V / 3.5)
    noisy = true + np.random.default_rng(5).normal(0.0, 0.05, true.shape)
    smooth, _ = fit_planes(noisy.astype(np.float32), np.full(true.shape, 0.05, dtype=np.float32), 6, 1.0)
    assert np.sqrt(np.mean((smooth - true)[15:-15, 15:-15] ** 2)) < limit_px
