"""End to end: descriptors, soft matches, motion. What the matcher makes of the descriptors is judged as well.

Each frame pair of a batch is matched by ``frontend.soft_assignment``: true pairs should be probable, strays
should fall into the dustbin, and the motion that is fitted to the matches should be the true one. The
gradient runs from the motion through the fit and the matches into the network.
"""

import torch
from torch import Tensor

from polhode.frontend.matching.soft_assignment import DualSoftmax, motion_loss
from polhode.frontend.networks.descriptor import Described
from polhode.train.task import Batch

FEWEST = 8
"""Frame pairs with fewer points tell no motion."""
WORST = 2.0
"""Misplacement, over the spread of the points, beyond which a motion is merely wrong: it teaches nothing."""


def matching_loss(described: Described, batch: Batch, matcher: DualSoftmax) -> tuple[Tensor, Tensor]:
    """Loss of the assignment, loss of the motion: means over the frame pairs of a ``PatchBatches`` batch."""
    pair, owner = batch["pair"], batch["strays"]
    m = len(pair)
    a, b, stray = (each.float() for each in described.descriptor.split([m, m, len(owner)]))
    assignments, motions = [], []
    for k, X_AB in enumerate(batch["X_AB"]):
        own, lost = pair == k, owner == k
        if int(own.sum()) < FEWEST:
            continue
        columns = torch.cat([b[own], stray[lost]])
        log_p = matcher(a[own], columns)
        alone = _log_without_partner(a[own], stray[lost], matcher)
        assignments.append(-0.5 * log_p.diagonal().mean() - (alone.mean() if len(alone) else 0.0))
        p_B = torch.cat([batch["p_b"][own], batch["p_stray"][lost]])
        motion = motion_loss(log_p, batch["p_a"][own], p_B, X_AB[:3, :3], X_AB[:3, 3])
        motions.append(motion if bool(motion < WORST) else motion.detach().clamp(max=WORST))
    nothing = a.new_zeros(())
    if not assignments:
        return nothing, nothing
    return torch.stack(assignments).mean(), torch.stack(motions).mean()


def _log_without_partner(a: Tensor, strays: Tensor, matcher: DualSoftmax) -> Tensor:
    """Log probability (k,) that strays fall into the dustbin, rather than to one of a."""
    none = matcher.dustbin * torch.exp(-matcher.log_temperature)
    score = (strays @ a.T) * torch.exp(-matcher.log_temperature)
    return none - torch.logaddexp(torch.logsumexp(score, dim=1), none)
