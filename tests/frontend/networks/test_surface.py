"""The surface network: one look at an image, rings that turn with the surface, places within pixels."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from polhode.frontend.features.surface_network import SurfaceLook, cut_rings
from polhode.frontend.networks.surface import (
    ANGLES,
    CHANNELS,
    RINGS,
    DenseOutput,
    SurfaceNet,
    find_places,
    image_channels,
    sample_rings,
)

Grey = NDArray[np.uint8]


def untrained(bias: float | None = None) -> SurfaceNet:
    """bias: of the scores; with a large one it takes every maximum for a landmark."""
    torch.manual_seed(1)
    network = SurfaceNet().eval()
    if bias is not None:
        with torch.no_grad():
            network.heads.get_parameter("bias")[0] = bias
    return network


NETWORK = untrained()


def clouds(seed: int, height: int = 96, width: int = 112) -> Grey:
    """Smooth random grey values."""
    rough = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    return np.asarray(np.clip(120 + 400 * cv2.GaussianBlur(rough, (0, 0), 2.5), 1, 255), dtype=np.uint8)


def turned(half_px: float, angles_rad: Tensor) -> Tensor:
    """Maps (n, 2, 2) of patches that are turned in the image."""
    c, s = torch.cos(angles_rad), torch.sin(angles_rad)
    return half_px * torch.stack([c, -s, s, c], dim=1).reshape(-1, 2, 2)


def test_all_outputs_are_of_the_resolution_of_the_image() -> None:
    images = torch.from_numpy(np.stack([clouds(1), clouds(2)]).astype(np.float32))[:, None]
    with torch.inference_mode():
        dense = NETWORK.dense(images)
    assert dense.score.shape == dense.log_sigma.shape == (2, 96, 112)
    assert dense.offset_px.shape == (2, 2, 96, 112)
    assert dense.channels.shape == (2, CHANNELS, 96, 112)
    torch.testing.assert_close(dense.channels[:, :2], image_channels(images))


def test_rings_are_sampled_where_the_map_of_the_patch_says() -> None:
    # a channel whose values are the places themselves
    v, u = torch.meshgrid(torch.arange(80.0), torch.arange(90.0), indexing="ij")
    affine, at = torch.tensor([[[10.0, 2.0], [-1.0, 6.0]]]), torch.tensor([[40.25, 35.5]])
    rings = sample_rings(torch.stack([u, v])[None], torch.tensor([0]), at, affine)
    angle = 2.0 * np.pi * 5 / ANGLES
    expected = affine[0] @ torch.tensor([0.97 * np.cos(angle), 0.97 * np.sin(angle)]).float()
    torch.testing.assert_close(rings[0, :, RINGS - 1, 5] - at[0], expected, atol=1e-3, rtol=0.0)


def test_the_compiled_sampling_of_a_run_is_that_of_the_training() -> None:
    torch.manual_seed(2)
    channels = torch.randn(1, CHANNELS, 60, 70)
    uv = torch.rand(20, 2) * torch.tensor([80.0, 70.0]) - 5.0
    affine = turned(11.0, torch.rand(20) * 6.0) * (0.8 + 0.3 * torch.rand(20))[:, None, None]
    expected = sample_rings(channels, torch.zeros(20, dtype=torch.long), uv, affine)
    found = cut_rings(channels[0], uv.numpy().astype(np.float64), affine.numpy().astype(np.float64))
    np.testing.assert_allclose(found, expected.numpy(), atol=2e-4)


def test_a_turn_by_one_sample_changes_nothing_but_the_direction() -> None:
    torch.manual_seed(3)
    rings = torch.randn(4, CHANNELS, RINGS, ANGLES)
    # two samples: the last layers see every second one
    with torch.no_grad():
        straight, shifted = NETWORK.describe(rings), NETWORK.describe(torch.roll(rings, 2, dims=3))
    assert torch.allclose(straight.descriptor, shifted.descriptor, atol=1e-4)
    angle = [torch.atan2(each.direction[:, 1], each.direction[:, 0]) for each in (straight, shifted)]
    assert torch.sin(angle[1] - angle[0] - 2.0 * 2.0 * torch.pi / ANGLES).abs().max() < 1e-3


def test_descriptors_ignore_the_exposure() -> None:
    described = []
    for factor in (0.3, 0.9):
        grey = torch.from_numpy(clouds(4).astype(np.float32) * factor)[None, None]
        # the learned channels of an untrained network know nothing of exposure
        channels = torch.cat([image_channels(grey), torch.zeros(1, CHANNELS - 2, 96, 112)], dim=1)
        at = torch.tensor([[50.0, 45.0]])
        with torch.no_grad():
            rings = sample_rings(channels, torch.tensor([0]), at, turned(12.0, torch.zeros(1)))
            described.append(NETWORK.describe(rings).descriptor)
    assert float((described[0] * described[1]).sum()) > 0.98


def test_places_are_maxima_of_the_score_moved_by_the_offset() -> None:
    score = torch.full((32, 40), -9.0)
    score[10, 20], score[10, 21], score[25, 7], score[3, 3] = 2.0, 1.0, 3.0, 5.0
    offset = torch.zeros(1, 2, 32, 40)
    offset[0, :, 10, 20] = torch.tensor([0.3, -0.4])
    none = torch.zeros(1, 8, 32, 40)
    dense = DenseOutput(score[None], offset, none[:, 0], none[:, :4], none)
    mask = torch.ones(32, 40, dtype=torch.bool)
    mask[:5] = False
    found = find_places(dense, 0, mask, 10)
    torch.testing.assert_close(found.uv_px, torch.tensor([[7.0, 25.0], [20.3, 9.6]]))
    assert found.score.tolist() == [3.0, 2.0]
    assert len(find_places(dense, 0, mask, 1).uv_px) == 1


def test_a_look_finds_the_same_places_wherever_the_target_is() -> None:
    eager, found = untrained(bias=5.0), []
    for corner in ((24, 40), (33, 61)):
        image, mask = np.zeros((160, 200), np.uint8), np.zeros((160, 200), bool)
        rows, columns = slice(corner[0], corner[0] + 64), slice(corner[1], corner[1] + 64)
        image[rows, columns], mask[rows, columns] = clouds(6, 64, 64), True
        candidates, sigma = SurfaceLook(eager, image, mask).candidates(50)
        assert len(candidates) == len(sigma) > 20
        found.append(candidates.uv_px - [corner[1], corner[0]])
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)
    nothing, sigma = SurfaceLook(NETWORK, clouds(1), np.zeros((96, 112), bool)).candidates(50)
    assert len(nothing) == len(sigma) == 0
    # a large target is reduced; many, as those of equal scores may come in the order of their places
    look = SurfaceLook(eager, clouds(7, 700, 960), np.ones((700, 960), bool))
    candidates, _ = look.candidates(2000)
    assert candidates.uv_px[:, 0].max() > 900 and (candidates.uv_px < [960, 700]).all()
    described = look.describe(candidates.uv_px[:5], np.tile(12.0 * np.eye(2), (5, 1, 1)))
    np.testing.assert_allclose(np.linalg.norm(described.descriptors, axis=1), 1.0, rtol=1e-4)
