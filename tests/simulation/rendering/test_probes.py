"""Where probes are, and what they see."""

import numpy as np
import trimesh

from polhode.simulation.bodies.part import Part, assemble
from polhode.simulation.rendering.probes import BELOW, DARK, SKY, Probes, place_probes
from polhode.simulation.rendering.raycast import RayCaster
from polhode.simulation.surface.materials import PAINT_WHITE


def _probes(*meshes: trimesh.Trimesh) -> Probes:
    body = assemble([Part(mesh, PAINT_WHITE) for mesh in meshes])
    return place_probes(body.mesh, RayCaster(body), 1200)


def test_probes_are_where_light_reaches() -> None:
    """Two boxes through each other, one of them wound inside out."""
    probes = _probes(trimesh.creation.icosphere(subdivisions=3, radius=0.1))
    assert (np.einsum("nk,nk->n", probes.p_G, probes.normal_G) > 0).all()
    assert set(np.unique(probes.sees)) == {SKY, BELOW}
    assert 900 < len(probes.p_G) < 1500
    inner = trimesh.creation.box([0.1, 0.1, 0.4])
    inner.invert()
    probes = _probes(trimesh.creation.box([0.3, 0.3, 0.2]), inner)
    within_box = (np.abs(probes.p_G) < [0.149, 0.149, 0.099]).all(axis=1)
    within_rod = (np.abs(probes.p_G) < [0.049, 0.049, 0.199]).all(axis=1)
    assert not (within_box | within_rod).any()
    outward = np.einsum("nk,nk->n", probes.p_G, probes.normal_G)
    assert (outward > 0).all()
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    probes = _probes(sheet)
    share = (probes.normal_G[:, 2] > 0).mean()
    assert 0.45 < share < 0.55


def test_probes_keep_their_distance_and_are_the_same_for_the_same_body() -> None:
    probes = _probes(trimesh.creation.box([0.2, 0.2, 0.2]))
    top = probes.p_G[probes.normal_G[:, 2] > 0.9]
    gap = np.linalg.norm(top[:, None] - top, axis=2) + np.eye(len(top))
    area_per_probe = 6 * 0.2**2 / len(probes.p_G)
    assert gap.min() > 0.7 * np.sqrt(area_per_probe)
    first, second = (_probes(trimesh.creation.box([0.2, 0.1, 0.2])) for _ in range(2))
    np.testing.assert_array_equal(first.p_G, second.p_G)
    np.testing.assert_array_equal(first.sees, second.sees)


def test_probes_see_each_other_across_a_gap() -> None:
    """The middle of the floor sees the ceiling in the directions that lead there, and names probes of it."""
    ceiling = trimesh.creation.box([0.4, 0.4, 0.01])
    ceiling.apply_translation([0, 0, 0.2])
    probes = _probes(trimesh.creation.box([0.4, 0.4, 0.01]), ceiling)
    floor = np.linalg.norm(probes.p_G - [0, 0, 0.005], axis=1).argmin()
    seen = probes.sees[floor]
    up = probes.directions_G[:, 2]
    reach = 0.19 * np.abs(probes.directions_G[:, :2]) / np.maximum(up, 1e-9)[:, None]
    inside = (up > 0) & (np.abs(probes.p_G[floor, :2]) + reach < 0.19).all(axis=1)
    assert inside.sum() > 100
    assert (seen[inside] >= 0).all()
    met = probes.p_G[seen[inside]]
    np.testing.assert_allclose(met[:, 2], 0.195, atol=1e-6)
    expected = probes.p_G[floor] + probes.directions_G[inside] * (0.19 / up[inside])[:, None]
    assert np.linalg.norm(met - expected, axis=1).max() < 0.03
    assert (seen[up < 0] == BELOW).all()
    assert DARK not in seen
