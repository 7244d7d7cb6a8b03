"""Soft, differentiable matching: dual softmax with a dustbin, weighted rigid fit, and the loss of the motion.

Dual softmax: a match is as probable as each is the other's best (Rocco et al., "Neighbourhood consensus
networks", 2018; LoFTR, Sun et al. 2021). The dustbin takes what has no partner (SuperGlue, Sarlin et al.
2020). The rigid fit is Kabsch's, by SVD; gradients run through it, so descriptors can be trained for the
motion (Wang and Solomon, "Deep closest point", 2019).
"""

import math

import torch
from torch import Tensor, nn

TEMPERATURE = 0.03
"""What similarities are divided by, unless it is learned."""
DUSTBIN = 0.6
"""Similarity of what has no partner, unless it is learned."""


class DualSoftmax(nn.Module):
    """Descriptors (n, d) and (m, d) of unit length -> log probability (n, m) that two are a match."""

    def __init__(self, temperature: float = TEMPERATURE, dustbin: float = DUSTBIN) -> None:
        super().__init__()
        self.log_temperature = nn.Parameter(torch.tensor(temperature).log())
        self.dustbin = nn.Parameter(torch.tensor(dustbin))
        """Similarity of what has no partner"""

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Log of the product of both directions' probabilities."""
        score = (a @ b.T) * torch.exp(-self.log_temperature)
        none = self.dustbin * torch.exp(-self.log_temperature)
        along_rows = torch.logaddexp(torch.logsumexp(score, dim=1), none)
        along_columns = torch.logaddexp(torch.logsumexp(score, dim=0), none)
        return 2.0 * score - along_rows[:, None] - along_columns[None, :]


def root_probabilities(a: Tensor, b: Tensor, temperature: float, dustbin: float) -> Tensor:
    """Square root (n, m) of what ``DualSoftmax`` takes the logarithm of, without a gradient, several times
    as fast: one exponential each. Descriptors (n, d) and (m, d) are of unit length."""
    with torch.inference_mode():
        root = torch.addmm(torch.tensor(-1.0), a, b.T).div_(temperature).exp_()
        none = math.exp((dustbin - 1.0) / temperature)
        along_rows, along_columns = root.sum(dim=1) + none, root.sum(dim=0) + none
        return root.mul_(along_rows.rsqrt()[:, None]).mul_(along_columns.rsqrt()[None, :])


def rigid_fit(p_A: Tensor, p_B: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """R_AB (..., 3, 3) and t (..., 3) that minimise sum w |p_A - R p_B - t|^2 over points (..., n, 3).

    weight (..., n) >= 0. Points must not lie on one line; the gradient also needs them off one point.
    """
    w = weight / weight.sum(dim=-1, keepdim=True)
    mean_A, mean_B = (torch.einsum("...n,...nk->...k", w, p) for p in (p_A, p_B))
    away_A, away_B = p_A - mean_A[..., None, :], p_B - mean_B[..., None, :]
    U, _, Vh = torch.linalg.svd(torch.einsum("...n,...ni,...nj->...ij", w, away_A, away_B))
    # A reflection fits noise on flat scenes better than a rotation: forbid it.
    sign = torch.det(U @ Vh).detach().sign()
    flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
    R = (U * flip[..., None, :]) @ Vh
    return R, mean_A - torch.einsum("...ij,...j->...i", R, mean_B)


def motion_loss(
    log_probability: Tensor, p_A: Tensor, p_B: Tensor, R_AB: Tensor, t_AB: Tensor, most: int = 256
) -> Tensor:
    """How wrong the motion of the soft matches is: by how much it misplaces points, over their spread.

    log_probability (n, m) of ``DualSoftmax``; p_A (n, 3), p_B (m, 3) [m]; R_AB, t_AB the true motion. Mutual
    best pairs are fitted, each with its probability as weight; which pairs these are carries no gradient.
    """
    best = log_probability.argmax(dim=1)
    rows = torch.arange(len(best), device=best.device)
    mutual = rows[log_probability.argmax(dim=0)[best] == rows]
    strongest = log_probability[mutual, best[mutual]].argsort(descending=True)[:most]
    i = mutual[strongest]
    j = best[i]
    R, t = rigid_fit(p_A[i], p_B[j], log_probability[i, j].exp() + 1e-6)
    miss = torch.linalg.vector_norm(p_B @ (R - R_AB).T + t - t_AB, dim=1)
    spread = torch.linalg.vector_norm(p_B - p_B.mean(dim=0), dim=1).mean()
    loss: Tensor = miss.mean() / spread
    return loss
