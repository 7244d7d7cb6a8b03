"""The surface network: places are pixel centres, and each image is judged by itself."""

import pytest
import torch

from polhode.frontend.networks.surface import KINDS_OF_LIGHT, SurfaceNet, known_of_points, sample


@pytest.fixture(scope="module")
def network() -> SurfaceNet:
    torch.manual_seed(4)
    return SurfaceNet().eval()


def test_samples_are_at_pixel_centres() -> None:
    """Of a map in which each number is its own place, at both resolutions."""
    for stride in (1, 2):
        v, u = torch.meshgrid(torch.arange(6.0), torch.arange(8.0), indexing="ij")
        # the centre of a pixel of the map, in pixels of the image
        place = torch.stack([u, v])[None] * stride + (stride - 1) / 2
        uv = torch.tensor([[2.0, 3.0], [1.25, 2.5], [4.5, 1.0]])
        inside = (uv >= (stride - 1) / 2).all(dim=1)
        got = sample(place, torch.zeros(3, dtype=torch.int64), uv, stride)
        torch.testing.assert_close(got[inside], uv[inside])
        beyond = sample(place, torch.zeros(1, dtype=torch.int64), torch.tensor([[-9.0, 99.0]]), stride)
        torch.testing.assert_close(beyond, place[0, :, -1, 0][None])


def test_each_image_is_judged_by_itself(network: SurfaceNet) -> None:
    generator = torch.Generator().manual_seed(1)
    images = 255.0 * torch.rand(2, 1, 64, 48, generator=generator)
    uv = 40.0 * torch.rand(7, 2, generator=generator)
    known = known_of_points(torch.ones(7), torch.ones(7), torch.full((7,), 0.1))
    with torch.no_grad():
        both, light = network(images, torch.ones(7, dtype=torch.int64), uv, known)
        alone, _ = network(images[1:], torch.zeros(7, dtype=torch.int64), uv, known)
    torch.testing.assert_close(both.reliability, alone.reliability, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(both.log_sigma, alone.log_sigma, atol=1e-4, rtol=1e-4)
    assert light.shape == (2, KINDS_OF_LIGHT, 32, 24)


def test_a_dim_image_is_judged_as_a_bright_one(network: SurfaceNet) -> None:
    """The first channel is relative to the brightest pixel; only the logarithm knows the exposure."""
    image = 255.0 * torch.rand(1, 1, 32, 32, generator=torch.Generator().manual_seed(2))
    uv, owner = torch.full((1, 2), 15.0), torch.zeros(1, dtype=torch.int64)
    known = known_of_points(torch.ones(1), torch.ones(1), torch.ones(1))
    with torch.no_grad():
        bright, dim, black = (
            network(image * gain, owner, uv, known)[0].reliability for gain in (1.0, 0.9, 0.0)
        )
    assert abs(float(bright - dim)) < abs(float(bright - black))
    assert torch.isfinite(black).all()
