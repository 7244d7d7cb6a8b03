"""What the command finds: the metric along a trajectory, and what each edge contributes."""

from dataclasses import dataclass

import numpy as np

from polhode.lie import Array
from polhode.pipeline.products.observability.choice import Choice
from polhode.pipeline.products.observability.subject import Subject
from polhode.planning.edges.metric.contributions import Contributions
from polhode.planning.edges.metric.information import EdgeView


@dataclass(frozen=True)
class Assessment:
    """The metric along a trajectory, for noise of sigma_px across the edges."""

    subject: Subject
    views: list[EdgeView]
    edges: Contributions
    choice: Choice
    spacing_px: float
    sigma_px: float

    @property
    def sigma(self) -> Array:
        """(k, 6) standard deviations [m, rad], inf where a view does not tell."""
        return self.sigma_px * np.stack([view.found.sigma for view in self.views])
