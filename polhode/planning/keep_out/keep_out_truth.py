"""Whether the true body stays inside the keep-out volume: for a simulated sequence, whose truth goes on.

Points sampled on the true mesh move along the true motion after the last pair. Those that no frame saw in
light are counted separately: the volume is for what was measured and what it encloses.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polhode.geometry.lie import Array, Bools
from polhode.planning.keep_out.queries import KeepOut
from polhode.records.mesh_metrics import distance_to_surface
from polhode.records.surface import SurfaceModel
from polhode.report.evaluation import TrueBody, true_body_ahead

POINTS, INSTANTS = 20_000, 120
FEW_POINTS, FEW_INSTANTS = 4_000, 20
"""For the volume at each instant, whose distances take longer."""


@dataclass(frozen=True)
class Excess:
    """Distances from a volume, for each point the farthest of all instants."""

    distance_m: Array
    """(n,) negative inside"""
    seen: Bools
    """(n,) whether any frame saw the point in light"""

    def inside(self, part: Bools) -> float | None:
        """Share of the points of a part (n,) that are inside at all instants; None: there are no points."""
        return float((self.distance_m[part] <= 0.0).mean()) if part.any() else None

    def farthest_m(self, part: Bools) -> float | None:
        """The farthest that one of them comes out, 0 when none does; None: there are no points."""
        return float(max(self.distance_m[part].max(), 0.0)) if part.any() else None


@dataclass(frozen=True)
class KeepOutTruth:
    """Both volumes against the true body."""

    swept: Excess
    instant: Excess
    least_from_mesh_m: float | None
    """Of the points that leave the volume of an instant, the least distance from the run's mesh at the last
    pair: a part that the mesh lacks, or an error of the motion? None: none leaves it."""


def keep_out_truth(found: KeepOut, surface: SurfaceModel, run: Path, sequence: Path) -> KeepOutTruth:
    """Compare. Raises InputError: the sequence has no truth, or none that reaches the horizon."""
    motion = found.instant.motion
    rows = np.unique(np.linspace(0, len(motion.time_s) - 1, INSTANTS).round().astype(int))
    body = true_body_ahead(run, sequence, motion.time_s[rows], POINTS)
    swept = np.full(len(body.p_G), -np.inf)
    for X in body.X_NG:
        places = body.p_G @ X[:3, :3].T + X[:3, 3]
        distance = found.swept.level.at(places)
        # how deep a point is inside does not matter
        outside = distance > 0.0
        distance[outside] = found.swept.signed_distance(places[outside])
        swept = np.maximum(swept, distance)
    few = slice(None, None, POINTS // FEW_POINTS)
    points, instant = body.p_G[few], np.full(len(body.p_G[few]), -np.inf)
    for i in np.unique(np.linspace(0, len(rows) - 1, FEW_INSTANTS).round().astype(int)):
        places = points @ body.X_NG[i, :3, :3].T + body.X_NG[i, :3, 3]
        instant = np.maximum(instant, found.instant.signed_distance(int(rows[i]), places))
    return KeepOutTruth(
        Excess(swept, body.seen),
        Excess(instant, body.seen[few]),
        _least_from_mesh(surface, body, points[instant > 0.0]),
    )


def _least_from_mesh(surface: SurfaceModel, body: TrueBody, p_G: Array) -> float | None:
    """Of points (n, 3) in the true G, where they are at the last pair."""
    if len(p_G) == 0:
        return None
    places = p_G @ body.last_X_NG[:3, :3].T + body.last_X_NG[:3, 3]
    estimated = (places - body.last_estimate_X_NG[:3, 3]) @ body.last_estimate_X_NG[:3, :3]
    return float(distance_to_surface(surface.mesh, estimated).min())


def truth_numbers(found: KeepOutTruth) -> dict[str, bool | float | None]:
    """As a study's table has them: whether the body left each volume, how far, and the distance from the
    mesh of what left that of an instant."""
    numbers: dict[str, bool | float | None] = {"least_from_mesh_m": found.least_from_mesh_m}
    for name, excess in (("swept", found.swept), ("instant", found.instant)):
        whole = np.ones(len(excess.seen), dtype=bool)
        for part, chosen in (("body", whole), ("seen", excess.seen)):
            farthest = excess.farthest_m(chosen)
            numbers[f"{name}_{part}_left"] = None if farthest is None else farthest > 0.0
            numbers[f"{name}_{part}_farthest_m"] = farthest
    return numbers
