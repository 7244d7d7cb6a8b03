"""The parts of the learned disparity method: hypotheses, channels, mixture, network; and the whole method."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from polhode.config.frontend_settings import Depth
from polhode.frontend.disparity.depth import compute_depth, dense_disparity
from polhode.frontend.disparity.learned import (
    InitialDisparity,
    fill_holes,
    initial_disparity,
    input_channels,
    refine,
    warp_right,
)
from polhode.frontend.disparity.sgbm import cut_crop
from polhode.frontend.networks.disparity import (
    CHANNELS,
    OFFSETS_PX,
    OUTPUTS,
    DisparityMixture,
    DisparityNet,
    mixture_from_outputs,
)
from polhode.frontend.rectification import Image
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Bools

RIG = RectifiedRig(400.0, 99.5, 79.5, 0.1, 200, 160)
DISPARITY = 30.0


def square_pair() -> tuple[Image, Image, Bools]:
    """A flat, textured square at one disparity before black sky; with its mask."""
    rng = np.random.default_rng(3)
    painted = np.clip(rng.normal(120, 40, (90, 90)), 20, 255).repeat(2, 0)[:90].repeat(2, 1)[:, :90]
    left, right = np.full((160, 200), 3, np.uint8), np.full((160, 200), 3, np.uint8)
    left[35:125, 70:160] = painted
    right[35:125, 40:130] = painted
    mask = np.zeros((160, 200), dtype=bool)
    mask[35:125, 70:160] = True
    return left, right, mask


@pytest.fixture(scope="module")
def start() -> InitialDisparity:
    found = initial_disparity(cut_crop(*square_pair(), (25.0, 35.0), Depth()), Depth())
    assert found is not None
    return found


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Depth:
    """With the weights of a network that has learned nothing yet."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "disparity.safetensors"
    save_file({name: value.contiguous() for name, value in DisparityNet().state_dict().items()}, path)
    return Depth(weights=str(path), min_visible=0.0, max_sigma_px=10.0)


def test_holes_are_filled_from_what_surrounds_them() -> None:
    v, u = np.mgrid[:60, :80].astype(np.float32)
    plane = 20.0 + 0.1 * u - 0.05 * v
    holed = plane.copy()
    holed[20:40, 30:50] = np.nan
    filled, known = fill_holes(holed), np.isfinite(holed)
    np.testing.assert_array_equal(filled[known], plane[known])
    assert np.abs(filled - plane).max() < 1.0
    assert (fill_holes(np.full((7, 5), np.nan, dtype=np.float32)) == 0.0).all()


def test_the_rivals_enclose_the_start_where_it_was_matched(start: InitialDisparity) -> None:
    known = np.isfinite(start.sigma)
    assert known[start.target].mean() > 0.8
    assert (start.far <= start.filled + 1e-4)[known].all()
    assert (start.near >= start.filled - 1e-4)[known].all()
    for name in ("filled", "far", "near", "unchecked", "facet", "coarse"):
        assert np.isfinite(getattr(start, name)).all()


def test_the_warp_undoes_the_disparity_and_has_the_gradient_of_its_values() -> None:
    torch.manual_seed(1)
    right = torch.rand(12, 40, dtype=torch.float64)
    disparity = torch.full((2, 12, 20), 3.0, dtype=torch.float64)
    disparity[1] = 3.5
    for wanted in (False, True):  # the compiled loop, and the differentiable one
        warped = warp_right(right, disparity.requires_grad_(wanted), 10).detach()
        np.testing.assert_allclose(warped[0], right[:, 7:27], atol=1e-12)
        np.testing.assert_allclose(warped[1], 0.5 * (right[:, 7:27] + right[:, 6:26]), atol=1e-12)
    right = torch.rand(3, 14, dtype=torch.float64, requires_grad=True)
    # Between pixel centres: at them the bilinear image has a kink.
    disparity = (0.25 + 0.5 * torch.rand(2, 3, 4, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda r, d: warp_right(r, d, 5), (right, disparity))


def test_the_evidence_is_least_at_the_true_disparity(start: InitialDisparity) -> None:
    channels = input_channels(start)
    assert channels.shape == (1, CHANNELS, *start.filled.shape)
    assert torch.isfinite(channels).all()
    inside = torch.from_numpy(start.target & np.isfinite(start.sigma))
    costs = [float(channels[0, i][inside].mean()) for i in range(len(OFFSETS_PX))]
    assert OFFSETS_PX[int(np.argmin(costs))] == 0.0
    assert costs[OFFSETS_PX.index(0.0)] < 0.2 * costs[0]


def test_sigma_of_one_laplace_distribution_holds_68_percent() -> None:
    shape = (1, 1, 2, 2)
    mixture = DisparityMixture(
        torch.zeros(shape), torch.full(shape, 5.0), torch.full(shape, 0.4), torch.zeros(1, 2, 2)
    )
    sigma = mixture.sigma(torch.full((1, 2, 2), 5.0), rounds=12)
    np.testing.assert_allclose(sigma, -0.4 * np.log(1.0 - 0.6827), rtol=1e-3)


def test_mass_agrees_with_the_integral_of_the_density() -> None:
    torch.manual_seed(2)
    raw, guess = torch.randn(1, OUTPUTS, 2, 2), 20.0 + torch.randn(1, 6, 2, 2)
    mixture = mixture_from_outputs(raw, guess)
    grid = torch.linspace(-40.0, 80.0, 12001)
    density = torch.stack([mixture.log_density(x.expand(1, 2, 2)).exp() for x in grid])
    step = float(grid[1] - grid[0])
    assert torch.allclose(density.sum(dim=0) * step, torch.ones(1, 2, 2), atol=2e-3)
    mass = mixture.mass_within(torch.full((1, 2, 2), 20.3), torch.full((1, 2, 2), 0.8))
    inside = ((grid - 20.3).abs() <= 0.8)[:, None, None, None]
    assert torch.allclose((density * inside).sum(dim=0) * step, mass, atol=8e-3)


def test_the_mode_lies_on_a_surface_never_between_two() -> None:
    shape = (1, 2, 1, 1)
    weight = torch.tensor([0.55, 0.45]).log().reshape(shape)
    mean = torch.tensor([10.0, 18.0]).reshape(shape)
    mixture = DisparityMixture(weight, mean, torch.full(shape, 0.2), torch.zeros(1, 1, 1))
    assert float(mixture.mode()) == 10.0
    assert float(mixture.sigma(mixture.mode())) > 5.0


def test_a_network_that_has_learned_nothing_keeps_the_start(start: InitialDisparity) -> None:
    torch.manual_seed(0)
    refined = refine(DisparityNet().eval(), start)
    assert refined.disparity.shape == start.filled.shape
    flat = start.target & (np.abs(start.near - start.far) < 0.3) & (np.abs(start.coarse - start.filled) < 0.3)
    assert flat.sum() > 500
    assert np.abs(refined.disparity - start.filled)[flat].max() < 0.5
    assert (refined.sigma[start.target] > 0).all()
    assert np.isnan(refined.disparity[~start.target]).all()


def test_the_method_gives_depth_on_the_target_alone_and_disparities_to_its_rim(untrained: Depth) -> None:
    left, right, mask = square_pair()
    depth = compute_depth(left, right, mask, RIG, untrained)
    known = np.isfinite(depth.depth_m)
    assert known[mask].mean() > 0.6 and not known[~mask].any()
    np.testing.assert_array_equal(known, np.isfinite(depth.sigma_m))
    true_m = RIG.focal_px * RIG.baseline_m / DISPARITY
    assert np.median(np.abs(depth.depth_m[known] / true_m - 1.0)) < 0.01
    disparity, sigma = dense_disparity(left, right, mask, RIG, untrained, (25.0, 35.0))
    assert disparity.shape == left.shape
    assert np.isfinite(disparity)[mask].mean() > 0.95
    assert (sigma[np.isfinite(disparity)] > 0).all()
    # without texture there is no depth
    flat = np.full_like(left, 3)
    assert not np.isfinite(compute_depth(flat, flat, mask, RIG, untrained, (10.0, 30.0)).depth_m).any()
