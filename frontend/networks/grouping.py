"""Rows of a batch in groups of different sizes, as one rectangular tensor.

A GPU computes all groups in one operation, where a loop over them would start hundreds.
"""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor


@dataclass(frozen=True)
class Grouping:
    """Places of n rows in ``count`` groups; each group keeps the rows' order."""

    group: Tensor
    """(n,) of each row"""
    rank: Tensor
    """(n,) of each row within its group"""
    count: int
    longest: int
    """Number of rows of the largest group"""

    @classmethod
    def of(cls, group: Tensor, count: int) -> Self:
        """group (n,): the group of each row, from 0 to ``count`` - 1."""
        member = group[:, None] == torch.arange(count, device=group.device)
        before = member.cumsum(dim=0)
        rank = before.gather(1, group[:, None])[:, 0] - 1
        longest = int(before[-1].max()) if len(group) else 0
        return cls(group, rank, count, longest)

    def spread(self, rows: Tensor) -> Tensor:
        """Rows (n, ...) as (count, longest, ...); zero where a group has no further rows."""
        out = rows.new_zeros(self.count, self.longest, *rows.shape[1:])
        return out.index_put((self.group, self.rank), rows)

    def gather(self, groups: Tensor) -> Tensor:
        """Inverse of ``spread``: (count, longest, ...) to (n, ...)."""
        return groups[self.group, self.rank]

    def known(self) -> Tensor:
        """(count, longest): where a group has a row."""
        return self.spread(torch.ones_like(self.group, dtype=torch.bool))

    def sums(self, rows: Tensor) -> Tensor:
        """Sums (count,) of the groups' values (n,)."""
        return rows.new_zeros(self.count).index_add(0, self.group, rows)
