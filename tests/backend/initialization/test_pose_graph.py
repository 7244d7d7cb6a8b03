"""Links between frames: groups that agree outvote single ones, triangles tell wrong links from right ones."""

import numpy as np
import pytest

from polhode.backend.initialization.initialize import consistent_links
from polhode.backend.initialization.pose_graph import connect, join_components, smooth_links, triangle_support
from polhode.geometry.lie import Array, Bools, exp_so3, inverse_pose, make_pose
from polhode.records.tracks import RelativePoses


def poses(n: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return make_pose(exp_so3(rng.normal(size=(n, 3))), [0.0, 0.0, 0.6] + 0.05 * rng.normal(size=(n, 3)))


def links(X_RG: Array, pairs: list[tuple[int, int]], inliers: int = 20) -> RelativePoses:
    i, j = np.array(pairs).T
    return RelativePoses(i, j, X_RG[i] @ inverse_pose(X_RG[j]), np.full(len(pairs), inliers))


def still(n: int) -> tuple[Array, Array]:
    """Times and attitudes of a camera at rest."""
    return 0.5 * np.arange(float(n)), np.tile(np.eye(3), (n, 1, 1))


def usable(relative: RelativePoses) -> Bools:
    return np.ones(len(relative.i), bool)


def assert_joined(relative: RelativePoses, X_RG: Array) -> None:
    """From islands, all frames are joined in one frame G."""
    n = len(X_RG)
    X, component = np.tile(np.eye(4), (n, 1, 1)), np.arange(n)
    join_components(relative, usable(relative), np.ones(len(relative.i)), X, component)
    assert np.all(component == component[0])
    G = inverse_pose(X) @ X_RG
    np.testing.assert_allclose(G, np.broadcast_to(G[0], G.shape), atol=1e-12)


def test_a_chain_of_perfect_links_is_joined_and_two_that_agree_outvote_a_stronger_one() -> None:
    X_RG = poses(8, 0)
    # some of the links point backwards
    assert_joined(links(X_RG, [(k, k + 1) if k % 2 else (k + 1, k) for k in range(7)]), X_RG)
    X_RG = poses(4, 1)
    relative = links(X_RG, [(0, 1), (2, 3), (0, 2), (1, 3), (0, 3)])
    X_ij = relative.X_RiRj.copy()
    X_ij[4] = X_ij[4] @ make_pose(exp_so3([0.0, 0.7, 0.0]), [0.0, 0.0, 0.0])
    assert_joined(RelativePoses(relative.i, relative.j, X_ij, np.array([40, 40, 7, 7, 15])), X_RG)


def test_the_triangles_of_a_wrong_link_do_not_close() -> None:
    X_RG = poses(7, 2)
    pairs = [(a, b) for a in range(7) for b in range(a + 1, 7)]
    relative = links(X_RG, pairs)
    relative.X_RiRj[4] = relative.X_RiRj[4] @ make_pose(exp_so3([0.5, 0.0, 0.0]), np.zeros(3))
    support = triangle_support(relative, usable(relative), 7)
    # five triangles on each link; one good and one bad are assumed
    assert support[4] == 1.0 / 7.0
    touching = [n for n, pair in enumerate(pairs) if n != 4 and set(pair) & set(pairs[4])]
    apart = [n for n, pair in enumerate(pairs) if not set(pair) & set(pairs[4])]
    np.testing.assert_allclose(support[touching], 5.0 / 7.0)
    np.testing.assert_allclose(support[apart], 6.0 / 7.0)
    # a wrong link beside a right one between the same frames takes nothing from it, nor from its neighbours
    relative = links(X_RG, pairs)
    wrong = relative.X_RiRj[:1] @ make_pose(exp_so3([0.0, 0.0, 2.0]), np.zeros(3))
    both = RelativePoses(
        *(np.append(relative.i, 0), np.append(relative.j, 1), np.concatenate([relative.X_RiRj, wrong])),
        np.append(relative.inliers, 12),
    )
    alone, beside = (triangle_support(each, usable(each), 7) for each in (relative, both))
    np.testing.assert_array_equal(beside[:-1], alone)
    assert alone.min() >= 0.8 and beside[-1] == pytest.approx(1.0 / 7.0)


def tumbling(n: int, turn_rad: float) -> Array:
    """Poses of a body that turns steadily about an axis that is none of its own."""
    return make_pose(exp_so3(np.outer(np.arange(n), turn_rad * np.array([0.3, 0.9, 0.3]))), [0.0, 0.0, 0.6])


@pytest.mark.parametrize("turn_deg", [12.0, 40.0])
def test_sides_that_look_alike_do_not_alias(turn_deg: float) -> None:
    X_RG = tumbling(24, np.deg2rad(turn_deg))
    near = links(X_RG, [(a, b) for a in range(24) for b in range(a + 1, min(a + 3, 24))], 30)
    # later frames see the other side, which looks like the first: as many links, all agreeing, and stronger
    turned = X_RG.copy()
    turned[14:] = turned[14:] @ make_pose(exp_so3([np.pi, 0.0, 0.0]), np.zeros(3))
    alike = links(turned, [(a, b) for a in range(6, 14) for b in range(16, 24)], 50)
    relative = RelativePoses(
        *(np.concatenate(each) for each in zip(vars(near).values(), vars(alike).values(), strict=True))
    )
    X, connected, accepted = connect(relative, *still(24))
    assert connected.all()
    np.testing.assert_array_equal(accepted, np.arange(len(relative.i)) < len(near.i))
    G = inverse_pose(X) @ X_RG
    np.testing.assert_allclose(G, np.broadcast_to(G[0], G.shape), atol=1e-9)
    undisputed = consistent_links(relative, *still(24))
    np.testing.assert_array_equal(undisputed, accepted)


def test_what_is_smooth_is_the_turn_in_N() -> None:
    X_RG = poses(8, 5)
    relative = links(X_RG, [(a, b) for a in range(8) for b in range(a + 1, min(a + 3, 8))])
    time_s, R_NR = still(8)
    assert not smooth_links(relative, usable(relative), time_s, R_NR).any()
    # a camera that follows those attitudes sees a body that does not turn in N
    follows = np.swapaxes(X_RG[:, :3, :3], 1, 2)
    assert smooth_links(relative, usable(relative), time_s, follows).all()
