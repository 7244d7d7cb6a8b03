"""The parts of the learned disparity method: hypotheses, channels, mixture, network; and the whole method."""

from pathlib import Path

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
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Bools

RIG = RectifiedRig(400.0, 99.5, 79.5, 0.1, 200, 160)
DISPARITY = 30.0


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray, Bools]:
    """A flat, textured square at one disparity before black sky."""
    rng = np.random.default_rng(3)
    painted = np.clip(rng.normal(120, 40, (90, 90)), 20, 255).repeat(2, 0)[:90].repeat(2, 1)[:, :90]
    left, right = np.full((160, 200), 3, np.uint8), np.full((160, 200), 3, np.uint8)
    left[35:125, 70:160] = painted
    right[35:125, 40:130] = painted
    mask = np.zeros((160, 200), dtype=bool)
    mask[35:125, 70:160] = True
    return left, right, mask


@pytest.fixture(scope="module")
def start(pair: tuple[np.ndarray, np.ndarray, Bools]) -> InitialDisparity:
    found = initial_disparity(cut_crop(*pair, (25.0, 35.0), Depth()), Depth())
    assert found is not None
    return found


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a network that has learned nothing yet."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "disparity.safetensors"
    save_file({name: value.contiguous() for name, value in DisparityNet().state_dict().items()}, path)
    return path


def test_holes_are_filled_from_what_surrounds_them() -> None:
    v, u = np.mgrid[:60, :80].astype(np.float32)
    plane = 20.0 + 0.1 * u - 0.05 * v
    holed = plane.copy()
    holed[20:40, 30:50] = np.nan
    filled = fill_holes(holed)
    known = np.isfinite(holed)
    np.testing.assert_array_equal(filled[known], plane[known])
    assert np.abs(filled - plane).max() < 1.0


def test_holes_of_nothing_known_are_zero() -> None:
    assert (fill_holes(np.full((7, 5), np.nan, dtype=np.float32)) == 0.0).all()


def test_the_rivals_enclose_the_start_where_it_was_matched(start: InitialDisparity) -> None:
    known = np.isfinite(start.sigma)
    assert known[start.target].mean() > 0.8
    assert (start.far <= start.filled + 1e-4)[known].all()
    assert (start.near >= start.filled - 1e-4)[known].all()
    assert all(
        np.isfinite(getattr(start, name)).all()
        for name in ("filled", "far", "near", "unchecked", "facet", "coarse")
    )


def test_the_warp_undoes_the_disparity() -> None:
    right = torch.rand(12, 40, dtype=torch.float64)
    disparity = torch.full((2, 12, 20), 3.0, dtype=torch.float64)
    disparity[1] = 3.5
    warped = warp_right(right, disparity, 10)
    np.testing.assert_allclose(warped[0], right[:, 7:27], atol=1e-12)
    np.testing.assert_allclose(warped[1], 0.5 * (right[:, 7:27] + right[:, 6:26]), atol=1e-12)


def test_the_warp_has_the_gradient_of_its_values() -> None:
    torch.manual_seed(1)
    right = torch.rand(5, 18, dtype=torch.float64, requires_grad=True)
    # Between pixel centres: at them the bilinear image has a kink.
    disparity = (0.25 + 0.5 * torch.rand(3, 5, 8, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda r, d: warp_right(r, d, 5), (right, disparity))


def test_the_evidence_is_least_at_the_true_disparity(start: InitialDisparity) -> None:
    channels = input_channels(start)
    assert channels.shape == (1, CHANNELS, *start.filled.shape)
    assert torch.isfinite(channels).all()
    inside = torch.from_numpy(start.target & np.isfinite(start.sigma))
    costs = [float(channels[0, i][inside].mean()) for i in range(len(OFFSETS_PX))]
    assert OFFSETS_PX[int(np.argmin(costs))] == 0.0
    assert costs[OFFSETS_PX.index(0.0)] < 0.2 * costs[0]


def single(mean: float, scale: float) -> DisparityMixture:
    shape = (1, 1, 2, 2)
    return DisparityMixture(
        torch.zeros(shape), torch.full(shape, mean), torch.full(shape, scale), torch.zeros(1, 2, 2)
    )


def test_sigma_of_one_laplace_distribution_holds_68_percent() -> None:
    mixture = single(5.0, 0.4)
    sigma = mixture.sigma(torch.full((1, 2, 2), 5.0), rounds=12)
    np.testing.assert_allclose(sigma, -0.4 * np.log(1.0 - 0.6827), rtol=1e-3)


def test_mass_agrees_with_the_integral_of_the_density() -> None:
    torch.manual_seed(2)
    raw, guess = torch.randn(1, OUTPUTS, 2, 2), 20.0 + torch.randn(1, 6, 2, 2)
    mixture = mixture_from_outputs(raw, guess)
    grid = torch.linspace(-40.0, 80.0, 24001)
    density = torch.stack([mixture.log_density(x.expand(1, 2, 2)).exp() for x in grid])
    step = float(grid[1] - grid[0])
    assert torch.allclose(density.sum(dim=0) * step, torch.ones(1, 2, 2), atol=2e-3)
    centre, radius = torch.full((1, 2, 2), 20.3), torch.full((1, 2, 2), 0.8)
    inside = ((grid - 20.3).abs() <= 0.8)[:, None, None, None]
    assert torch.allclose(
        (density * inside).sum(dim=0) * step, mixture.mass_within(centre, radius), atol=4e-3
    )


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


def test_the_method_gives_depth_on_the_target_alone(
    pair: tuple[np.ndarray, np.ndarray, Bools], weights: Path
) -> None:
    left, right, mask = pair
    config = Depth(method="network", weights=str(weights), min_visible=0.0, max_sigma_px=10.0)
    depth = compute_depth(left, right, mask, RIG, config)
    known = np.isfinite(depth.depth_m)
    assert known[mask].mean() > 0.6
    assert not known[~mask].any()
    np.testing.assert_array_equal(known, np.isfinite(depth.sigma_m))
    true_m = RIG.focal_px * RIG.baseline_m / DISPARITY
    assert np.median(np.abs(depth.depth_m[known] / true_m - 1.0)) < 0.01


def test_disparities_of_the_whole_image_reach_to_the_rim(
    pair: tuple[np.ndarray, np.ndarray, Bools], weights: Path
) -> None:
    left, right, mask = pair
    config = Depth(method="network", weights=str(weights), min_visible=0.0)
    disparity, sigma = dense_disparity(left, right, mask, RIG, config, (25.0, 35.0))
    assert disparity.shape == left.shape
    assert np.isfinite(disparity)[mask].mean() > 0.95
    assert (sigma[np.isfinite(disparity)] > 0).all()


def test_a_pair_without_texture_has_no_depth(weights: Path) -> None:
    flat = np.full((160, 200), 3, np.uint8)
    mask = np.zeros((160, 200), dtype=bool)
    mask[40:100, 60:150] = True
    config = Depth(method="network", weights=str(weights))
    depth = compute_depth(flat, flat, mask, RIG, config, (10.0, 30.0))
    assert not np.isfinite(depth.depth_m).any()
