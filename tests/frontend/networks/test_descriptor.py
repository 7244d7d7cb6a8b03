"""The descriptor of patches: blind to turns and exposure, its direction turns."""

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from polhode.frontend.features.patch_descriptors import describe
from polhode.frontend.features.patches import cut_patches, rotate_affines, upright_affines
from polhode.frontend.networks.descriptor import DescriptorNet, normalise_patches


@pytest.fixture(scope="module")
def network() -> DescriptorNet:
    torch.manual_seed(1)
    return DescriptorNet().eval()


def patches_at(angles_rad: list[float], seed: int = 5) -> Tensor:
    """The middle of one image of smooth random grey values, turned."""
    rough = np.random.default_rng(seed).normal(size=(120, 120)).astype(np.float32)
    clouds = np.clip(120 + 400 * cv2.GaussianBlur(rough, (0, 0), 3.0), 0, 255).astype(np.uint8)
    n = len(angles_rad)
    affine = rotate_affines(upright_affines(np.full(n, 16.0)), np.array(angles_rad))
    return torch.from_numpy(cut_patches(clouds, np.full((n, 2), 60.0), affine))


def test_quarter_turns_change_nothing_but_the_direction(network: DescriptorNet) -> None:
    patches = patches_at([0.0])
    with torch.no_grad():
        described = [network(torch.rot90(patches, k, (2, 3))) for k in range(4)]
    for k, each in enumerate(described):
        assert torch.allclose(each.descriptor, described[0].descriptor, atol=1e-4)
        assert torch.allclose(each.reliability, described[0].reliability, atol=1e-3)
        # rot90 turns from y (down) to x (right): against the patch's angles.
        angle = torch.atan2(*each.direction[0].flip(0)) - torch.atan2(*described[0].direction[0].flip(0))
        assert abs(float((angle + k * torch.pi / 2 + torch.pi) % (2 * torch.pi) - torch.pi)) < 1e-3


def test_the_direction_turns_with_the_surface(network: DescriptorNet) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    with torch.no_grad():
        direction = network(patches_at(list(angles))).direction.numpy()
    # A patch whose x is at ``angle`` in the image sees a fixed thing at minus that angle.
    fixed = np.arctan2(direction[:, 1], direction[:, 0]) + angles
    off = np.angle(np.exp(1j * (fixed - np.angle(np.exp(1j * fixed).mean()))))
    assert np.rad2deg(np.abs(off)).max() < 6.0


def test_descriptors_of_turned_patches_are_nearer_than_of_others(network: DescriptorNet) -> None:
    others = torch.cat([patches_at([0.0], seed) for seed in range(10, 30)])
    with torch.no_grad():
        own = network(patches_at([0.0, 0.4, 1.1, 2.5])).descriptor
        strange = network(others).descriptor
    assert float((own[1:] @ own[0]).min()) > float((strange @ own[0]).max())


def test_patches_are_seen_without_their_exposure() -> None:
    patches = patches_at([0.0])
    assert torch.allclose(normalise_patches(2.0 * patches + 30.0), normalise_patches(patches), atol=1e-2)
    assert torch.isfinite(normalise_patches(torch.full((1, 1, 32, 32), 7.0))).all()


def test_the_whole_network_is_differentiable(network: DescriptorNet) -> None:
    described = network(patches_at([0.0, 1.0]))
    loss = described.descriptor[0, :5].sum() + described.reliability.sum() + described.direction[0].sum()
    loss.backward()
    for name, weight in network.named_parameters():
        assert weight.grad is not None and torch.isfinite(weight.grad).all(), name
    network.zero_grad()


def test_describe_takes_any_number_of_patches(network: DescriptorNet) -> None:
    patches = patches_at(list(np.linspace(0.0, 3.0, 150))).numpy()
    described = describe(network, patches)
    assert described.descriptors.shape == (150, 128)
    assert np.allclose(np.linalg.norm(described.descriptors, axis=1), 1.0, atol=1e-3)
    assert ((described.reliability > 0) & (described.reliability < 1)).all()
    assert describe(network, patches[:0]).descriptors.shape == (0, 128)
    some = describe(network, patches[140:])
    assert np.allclose(some.descriptors, described.descriptors[140:], atol=1e-2)
