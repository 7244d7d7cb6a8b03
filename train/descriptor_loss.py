"""What makes descriptors good: each finds its partner among all others, and knows when it will not.

InfoNCE (van den Oord et al., "Representation learning with contrastive predictive coding", 2018), both ways.
"""

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from polhode.config.train import DescriptorTraining
from polhode.frontend.matching.soft_assignment import DualSoftmax
from polhode.frontend.networks.descriptor import Described
from polhode.train.matching_loss import matching_loss
from polhode.train.task import Batch

SAME_PX = 4.0
"""Points of one frame pair this close to each other are no negatives of one another [px]."""
START_TEMPERATURE = 0.07


class Heads(nn.Module):
    """What learns beside the network: the contrast's temperature, and the matcher's with its dustbin."""

    def __init__(self) -> None:
        super().__init__()
        self.logarithm = nn.Parameter(torch.tensor(START_TEMPERATURE).log())
        self.matcher = DualSoftmax()

    def temperature(self) -> Tensor:
        """What similarities are divided by; never below 0.02."""
        return self.logarithm.exp().clamp(min=0.02)


def descriptor_loss(
    described: Described, batch: Batch, heads: Heads, config: DescriptorTraining
) -> tuple[Tensor, Mapping[str, Tensor]]:
    """Loss of a batch of ``PatchBatches``, whose n patches are described in its order."""
    temperature = heads.temperature()
    m = len(batch["pair"])
    descriptors = described.descriptor
    a, b, stray = descriptors[:m].float(), descriptors[m : 2 * m].float(), descriptors[2 * m :].float()
    same = _same_place(batch)
    forward = (a @ b.T).masked_fill(same, -1.0)
    backward = forward.T.masked_fill(same.T, -1.0)
    # Strays were found in the second frames: they compete with the second patches.
    logits_ab = torch.cat([forward, a @ stray.T], dim=1) / temperature
    logits_ba = backward / temperature
    truth = torch.arange(m, device=a.device)
    contrast = 0.5 * (functional.cross_entropy(logits_ab, truth) + functional.cross_entropy(logits_ba, truth))
    right = (logits_ab.argmax(dim=1) == truth) & (logits_ba.argmax(dim=1) == truth)
    label = torch.cat([right, right, right.new_zeros(len(stray))]).float()
    trust = functional.binary_cross_entropy_with_logits(described.reliability.float(), label)
    found = (logits_ab.argmax(dim=1) == truth).float().mean()
    direction = described.direction.float()
    astray = (1.0 - turned_alike(direction[:m], direction[m : 2 * m], batch["turn"])).mean()
    assignment, motion = matching_loss(described, batch, heads.matcher)
    loss = contrast + config.reliability_weight * trust + config.direction_weight * astray
    end_to_end = config.matching_weight * assignment + config.motion_weight * motion
    loss = loss + batch["late"] * end_to_end
    return loss, {
        "contrast": contrast,
        "reliability": trust,
        "direction": astray,
        "assignment": assignment,
        "motion": motion,
        "rank_1": found,
        "temperature": temperature,
    }


def turned_alike(first: Tensor, second: Tensor, turn_rad: Tensor) -> Tensor:
    """Cosine (m,) of the error of the second directions (m, 2), the first ones and the true turn given."""
    c, s = torch.cos(turn_rad), torch.sin(turn_rad)
    expected = torch.stack([c * first[:, 0] - s * first[:, 1], s * first[:, 0] + c * first[:, 1]], dim=1)
    return (expected * second).sum(dim=1)


def _same_place(batch: Batch) -> Tensor:
    """(m, m): pairs that show nearly the same point, themselves excepted."""
    together = batch["pair"][:, None] == batch["pair"][None, :]
    near = torch.zeros_like(together)
    for name in ("uv_a", "uv_b"):
        near |= torch.cdist(batch[name], batch[name]) < SAME_PX
    same: Tensor = together & near
    return same.fill_diagonal_(False)
