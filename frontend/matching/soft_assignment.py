"""Soft, differentiable matching: dual softmax with a dustbin, and the weighted rigid fit.

Dual softmax: the probability of a match is the product of the probabilities that each feature is the best
match of the other (Rocco et al., "Neighbourhood consensus networks", 2018; LoFTR, Sun et al. 2021). Features
without a match are assigned to the dustbin (SuperGlue, Sarlin et al. 2020). The rigid fit is Kabsch's, by
SVD; gradients pass through it, so descriptors can be trained for the motion (Wang and Solomon, "Deep closest
point", 2019).
"""

import math

import torch
from torch import Tensor, nn

TEMPERATURE = 0.03
"""Divisor of the similarities."""
DUSTBIN = 0.6
"""Similarity to the dustbin."""


class DualSoftmax(nn.Module):
    """Descriptors (n, d) and (m, d) of unit length -> log probability (n, m) of each match; learns both
    constants."""

    def __init__(self, temperature: float = TEMPERATURE, dustbin: float = DUSTBIN) -> None:
        super().__init__()
        self.log_temperature = nn.Parameter(torch.tensor(temperature).log())
        self.dustbin = nn.Parameter(torch.tensor(dustbin))

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Logarithm of the product of the probabilities in both directions."""
        score = (a @ b.T) * torch.exp(-self.log_temperature)
        none = self.dustbin * torch.exp(-self.log_temperature)
        along_rows = torch.logaddexp(torch.logsumexp(score, dim=1), none)
        along_columns = torch.logaddexp(torch.logsumexp(score, dim=0), none)
        return 2.0 * score - along_rows[:, None] - along_columns[None, :]


def root_probabilities(a: Tensor, b: Tensor, temperature: float, dustbin: float) -> Tensor:
    """Square root (n, m) of the probabilities of ``DualSoftmax`` for descriptors (n, d) and (m, d) of unit
    length.

    Without a gradient, and several times as fast: one exponential per pair.
    """
    with torch.inference_mode():
        root = torch.addmm(torch.tensor(-1.0), a, b.T).div_(temperature).exp_()
        none = math.exp((dustbin - 1.0) / temperature)
        along_rows, along_columns = root.sum(dim=1) + none, root.sum(dim=0) + none
        return root.mul_(along_rows.rsqrt()[:, None]).mul_(along_columns.rsqrt()[None, :])


def rigid_fit(p_A: Tensor, p_B: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """R_AB (..., 3, 3) and t (..., 3) that minimise sum w |p_A - R p_B - t|^2 over points (..., n, 3).

    weight (..., n) >= 0. The points must not be collinear. This is the differentiable twin of
    ``polhode.rigid_fit.fit_rigid``; a test compares the two.
    """
    w = weight / weight.sum(dim=-1, keepdim=True)
    mean_A, mean_B = (torch.einsum("...n,...nk->...k", w, p) for p in (p_A, p_B))
    away_A, away_B = p_A - mean_A[..., None, :], p_B - mean_B[..., None, :]
    U, _, Vh = torch.linalg.svd(torch.einsum("...n,...ni,...nj->...ij", w, away_A, away_B))
    # On noisy planar points a reflection may fit better than a rotation: it is excluded.
    sign = torch.det(U @ Vh).detach().sign()
    flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], dim=-1)
    R = (U * flip[..., None, :]) @ Vh
    return R, mean_A - torch.einsum("...ij,...j->...i", R, mean_B)
