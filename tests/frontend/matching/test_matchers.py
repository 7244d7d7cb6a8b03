"""Matching: soft assignment can be differentiated; few right matches among many wrong ones are found."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch

from polhode.config.frontend_settings import Features, Frontend, PairMatching
from polhode.frontend.features.keypoints import Descriptors
from polhode.frontend.features.stereo import StereoFeatures
from polhode.frontend.matching.matchers import (
    MIN_PROBABILITY,
    DualSoftmax,
    SoftmaxMatcher,
    _listed_support,
    likely_pairs,
    rigid_fit,
)
from polhode.frontend.matching.methods import one_to_one
from polhode.frontend.matching.nearest import MutualNearest
from polhode.frontend.matching.pairs import match_rows
from polhode.geometry.lie import Array, exp_so3, make_pose, transform_points
from polhode.geometry.rigid_fit import fit_rigid
from tests.frontend.feature_world import RIG, unit

FEATURES: tuple[Literal["rootsift", "polhode"], ...] = ("rootsift", "polhode")
X_AB = make_pose(exp_so3([0.3, -0.7, 0.2]), [0.05, 0.02, -0.03])
"""The motion between the frames of these tests."""


def _axes(rng: np.random.Generator, n: int) -> Array:
    axes = unit(rng.normal(size=(n, 3)))
    return exp_so3(axes * rng.uniform(0, np.pi, (n, 1)))


def _features(p_R: Array, R_RS: Array | None, descriptors: Array | Descriptors) -> StereoFeatures:
    n, z = len(p_R), p_R[:, 2]
    per_px = np.column_stack([z / RIG.focal_px, z**2 / (RIG.focal_px * RIG.baseline_m)])
    sigma, looks = np.full((n, 3), 0.2), descriptors.astype(np.float32)
    return StereoFeatures(RIG.project(p_R), sigma, p_R, np.ones(n), looks, R_RS=R_RS, metres_per_px=per_px)


def _frames(right: int, wrong: int, seed: int = 0) -> tuple[StereoFeatures, StereoFeatures]:
    """Feature k of both frames shows one point for k < right; the others look alike, but are elsewhere."""
    rng = np.random.default_rng(seed)
    n = right + wrong
    p_B = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.7], (n, 3))
    p_A = transform_points(X_AB, p_B)
    p_A[right:] = rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.7], (wrong, 3))
    R_BS = _axes(rng, n)
    tilt = np.array([exp_so3(v) for v in rng.normal(0.0, 0.08, (n, 3))])
    R_AS = X_AB[:3, :3] @ R_BS @ tilt
    R_AS[right:] = _axes(rng, n)[right:]
    looks = unit(rng.normal(size=(n, 128)))
    return _features(p_A, R_AS, looks), _features(p_B, R_BS, unit(looks + 0.03 * rng.normal(size=(n, 128))))


def test_the_dual_softmax_has_the_right_gradient() -> None:
    torch.manual_seed(0)
    assign = DualSoftmax(temperature=0.3).double()
    a, b = (torch.nn.functional.normalize(torch.randn(k, 8, dtype=torch.double), dim=1) for k in (5, 4))
    inputs = (a.requires_grad_(), b.requires_grad_())
    assert torch.autograd.gradcheck(assign, inputs)
    parameters = tuple(p.detach().clone().requires_grad_() for p in assign.parameters())
    names = [name for name, _ in assign.named_parameters()]

    def by_parameters(*values: torch.Tensor) -> torch.Tensor:
        found = torch.func.functional_call(assign, dict(zip(names, values, strict=True)), (a, b))
        assert isinstance(found, torch.Tensor)
        return found

    assert torch.autograd.gradcheck(by_parameters, parameters)


def test_the_dustbin_takes_what_has_no_partner() -> None:
    looks = torch.eye(4)
    probability = DualSoftmax(temperature=0.1)(looks[:3], looks[1:]).exp()
    assert torch.allclose(probability[1, 0], probability[2, 1])
    assert probability[1, 0] > 0.9
    assert probability[0].sum() < 0.05
    with_dustbin = DualSoftmax(temperature=0.1, dustbin=1.2)(looks[:3], looks[1:]).exp()
    assert with_dustbin[1, 0] < 0.1


def test_likely_pairs_are_those_of_the_dual_softmax() -> None:
    torch.manual_seed(1)
    # more rows than are computed together
    a, b = (torch.nn.functional.normalize(torch.randn(k, 16), dim=1) for k in (300, 70))
    for temperature, dustbin in ((0.03, 0.6), (0.2, 0.1)):
        expected = DualSoftmax(temperature, dustbin)(a, b).exp().detach().numpy()
        pairs, root = likely_pairs(a.numpy(), b.numpy(), temperature, dustbin)
        probability = np.zeros_like(expected)
        probability[pairs[:, 0], pairs[:, 1]] = root**2
        kept = probability > 0.0
        assert 0 < kept.sum() < kept.size
        np.testing.assert_allclose(probability[kept], expected[kept], rtol=1e-4)
        assert expected[~kept].max() < 1.001 * MIN_PROBABILITY
        assert expected[kept].min() > 0.999 * MIN_PROBABILITY


def test_the_rigid_fit_is_exact_and_has_the_right_gradient() -> None:
    rng = np.random.default_rng(1)
    p_B = rng.normal(size=(2, 7, 3))
    p_A = torch.from_numpy(np.stack([transform_points(X_AB, p) for p in p_B]))
    weight = torch.from_numpy(rng.uniform(0.1, 1.0, (2, 7)))
    R, t = rigid_fit(p_A, torch.from_numpy(p_B), weight)
    assert torch.allclose(R, torch.from_numpy(X_AB[:3, :3]).expand(2, 3, 3), atol=1e-9)
    assert torch.allclose(t, torch.from_numpy(X_AB[:3, 3]).expand(2, 3), atol=1e-9)
    noisy = p_A + 0.1 * torch.from_numpy(rng.normal(size=(2, 7, 3)))
    twin = np.stack([fit_rigid(*each) for each in zip(noisy.numpy(), p_B, weight.numpy(), strict=True)])
    R, t = rigid_fit(noisy, torch.from_numpy(p_B), weight)
    torch.testing.assert_close(torch.cat([R, t[..., None]], dim=-1), torch.from_numpy(twin[:, :3]))
    inputs = (noisy.requires_grad_(), torch.from_numpy(p_B).requires_grad_(), weight.requires_grad_())
    assert torch.autograd.gradcheck(rigid_fit, inputs)
    # the fit of a mirrored scene is still a rotation
    p = torch.from_numpy(p_B[0])
    R, _ = rigid_fit(p * torch.tensor([1.0, 1.0, -1.0]), p, torch.ones(7, dtype=torch.double))
    assert torch.allclose(torch.det(R), torch.ones((), dtype=torch.double))


def test_a_dozen_right_matches_among_two_hundred_wrong_ones_are_found() -> None:
    a, b = _frames(12, 200)
    matches = SoftmaxMatcher(Frontend())(a, b)
    assert set(matches.features[matches.features[:, 0] < 12, 1]) == set(range(12))
    assert len(matches.features) < 24
    assert len(np.unique(matches.features[:, 0])) == len(matches.features)
    # rough axes propose motions as well
    rough = [replace(frame, R_RS=None, rough_R_RS=frame.R_RS) for frame in (a, b)]
    assert np.array_equal(SoftmaxMatcher(Frontend())(*rough).features, matches.features)
    assert not rough[0].on_surface.any()
    # chance agrees on no motion of any strength
    assert len(SoftmaxMatcher(Frontend())(*_frames(0, 300)).features) < 12


def test_features_without_axes_are_matched_by_looks() -> None:
    a, b = _frames(40, 0)
    plain = [_features(frame.p_R, None, frame.descriptors) for frame in (a, b)]
    matches = SoftmaxMatcher(Frontend())(*plain)
    assert np.array_equal(matches.features, np.column_stack([np.arange(40)] * 2))
    nothing = _features(np.zeros((0, 3)), None, np.zeros((0, 128)))
    assert len(SoftmaxMatcher(Frontend())(plain[0], nothing).features) == 0
    # nearest neighbours know one motion without axes
    nearest = MutualNearest(Frontend())
    (only,) = nearest.hypotheses(plain[0], plain[1], 6)
    assert np.array_equal(only.features, nearest(a, b).features)


def _symmetric_frames(
    fold: int, per_part: int, clutter: int, sigma_px: float, seed: int = 3
) -> tuple[StereoFeatures, StereoFeatures]:
    """Two frames of a body of ``fold`` equal parts around an axis, with noise of ``sigma_px`` in u, v and a
    third of it in disparity. The points of all parts look alike; those of the clutter are elsewhere."""
    rng = np.random.default_rng(seed)
    turns = [exp_so3([0.0, 0.0, 2.0 * np.pi * k / fold]) for k in range(fold)]
    part, axes, looks = (
        rng.uniform([0.03, -0.03, -0.05], [0.1, 0.03, 0.05], (per_part, 3)),
        _axes(rng, per_part),
        unit(rng.normal(size=(per_part, 128))),
    )
    p_G = np.concatenate([part @ turn.T for turn in turns])
    R_GS = np.concatenate([turn @ axes for turn in turns])
    looks = np.tile(looks, (fold, 1))
    elsewhere = unit(rng.normal(size=(clutter, 128)))
    frames = []
    for X_RG in (make_pose(np.eye(3), [0.0, 0.0, 0.6]), make_pose(X_AB[:3, :3].T, [0.01, 0.02, 0.62])):
        p_R = np.concatenate(
            [transform_points(X_RG, p_G), rng.uniform([-0.1, -0.1, 0.5], [0.1, 0.1, 0.7], (clutter, 3))]
        )
        uvd = RIG.project(p_R) + rng.normal(size=(len(p_R), 3)) * sigma_px * [1.0, 1.0, 1.0 / 3.0]
        described = np.concatenate([looks, elsewhere])
        described = unit(described + 0.03 * rng.normal(size=described.shape))
        R_RS = np.concatenate([X_RG[:3, :3] @ R_GS, _axes(rng, clutter)])
        frames.append(_features(RIG.triangulate(uvd), R_RS, described))
    return frames[0], frames[1]


@pytest.mark.parametrize("method", ["nearest", "polhode"])
@pytest.mark.parametrize("fold", [2, 6])
@pytest.mark.parametrize(("clutter", "sigma_px"), [(5, 0.0), (100, 0.3)])
def test_of_a_body_with_equal_parts_every_motion_is_found(
    method: Literal["nearest", "polhode"], fold: int, clutter: int, sigma_px: float
) -> None:
    a, b = _symmetric_frames(fold, 12, clutter, sigma_px)
    config = Frontend(pairs=PairMatching(method=method))
    (found,) = match_rows([a, b], [np.array([1])], RIG, config, 0, 1, [0], fold)
    assert len(found) == fold
    X_AG, X_BG = make_pose(np.eye(3), [0.0, 0.0, 0.6]), make_pose(X_AB[:3, :3].T, [0.01, 0.02, 0.62])
    missed = set(range(fold))
    for match in found:
        turns = [
            X_AG[:3, :3] @ exp_so3([0.0, 0.0, 2.0 * np.pi * k / fold]) @ X_BG[:3, :3].T for k in range(fold)
        ]
        errors = [np.linalg.norm(turn - match.X_RiRj[:3, :3]) for turn in turns]
        assert min(errors) < np.deg2rad(1.0)
        missed.discard(int(np.argmin(errors)))
        # the strongest motions of a body of equal parts have all its points
        assert len(match) > 0.8 * 12 * fold
    assert not missed


def test_unsure_matches_of_rootsift_do_not_count_unless_all_motions_are_kept() -> None:
    a, b = _symmetric_frames(4, 12, 5, 0.0)
    of_rootsift, of_network = (
        SoftmaxMatcher(Frontend(features=Features(method=method))) for method in FEATURES
    )
    # of four equal parts each has a quarter of the probability, in both directions
    sure = of_rootsift(a, b)
    assert len(sure.features) < 24
    assert (sure.confidence >= PairMatching().min_confidence).all()
    assert len(of_network(a, b).features) == 48
    assert len(of_rootsift.hypotheses(a, b, 4)[3].features) == 48


def test_support_is_the_same_by_lists_and_by_products() -> None:
    rng = np.random.default_rng(2)
    agrees = rng.uniform(size=(60, 60)) < 0.2
    agrees = agrees | agrees.T | np.eye(60, dtype=bool)
    weight = rng.uniform(size=60)
    pull = agrees * weight
    np.testing.assert_allclose(
        _listed_support(agrees, weight), np.einsum("nk,nk->n", pull @ agrees, pull), rtol=1e-12
    )


def test_what_stands_still_gives_way_to_what_turns() -> None:
    """More matches at rest than in motion, as highlights and rims make them."""
    a, b = _frames(25, 70, seed=7)
    rest = np.arange(25, 65)
    p_A, R_AS = a.p_R.copy(), np.asarray(a.R_RS).copy()
    p_A[rest], R_AS[rest] = b.p_R[rest], np.asarray(b.R_RS)[rest]
    matcher, both = SoftmaxMatcher(Frontend()), _features(p_A, R_AS, a.descriptors)
    assert np.mean(matcher(both, b).features[:, 0] < 25) > 0.9
    # a target at rest stays at rest
    assert np.array_equal(matcher(b, b).features, np.column_stack([np.arange(95)] * 2))
    # each motion keeps its matches
    still, turning = matcher.hypotheses(both, b, 6)[:2]
    assert np.array_equal(still.features[:, 0], rest)
    assert set(turning.features[:, 0]) >= set(range(25)) and np.mean(turning.features[:, 0] < 25) > 0.9
    assert len(matcher.hypotheses(both, b, 1)) == 1
    # the geometric check of a pair of frames keeps both motions
    config = Frontend(pairs=PairMatching(method="polhode"))
    (found,) = match_rows([both, b], [np.array([1])], RIG, config, 0, 1, [0], 6)
    np.testing.assert_allclose(found[0].X_RiRj, np.eye(4), atol=1e-3)
    np.testing.assert_allclose(found[1].X_RiRj, X_AB, atol=1e-3)
    # without axes of the surface there is one
    plain = [_features(frame.p_R, None, frame.descriptors) for frame in (a, b)]
    assert len(matcher.hypotheses(plain[0], plain[1], 6)) == 1


def test_no_feature_has_two_partners() -> None:
    pairs = np.array([[0, 0], [0, 1], [1, 1], [2, 1]])
    assert np.array_equal(one_to_one(pairs, np.array([0.5, 0.9, 0.8, 0.95])), [0, 3])
