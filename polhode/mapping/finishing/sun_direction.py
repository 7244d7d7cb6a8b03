"""Direction of the Sun from how the surface of a rotating body brightens and darkens.

Lambert's law: at vertex v in frame f the image shows ``a_v (max(0, n_fv . s) + e)``, with the albedo a_v, the
normal n_fv in N, one Sun direction s in N for the whole run and ambient light ``e = e0 + b . n_fv`` (a planet
fills one side); in the body's own shadow, e alone. The albedos are eliminated (variable projection), which
leaves six unknowns. The loss is robust, because highlights do not follow Lambert's law.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints
from polhode.mapping.visibility import directions

Lit = Callable[[Array], Bools]
"""Sun direction in N (3,) -> which observations (m,) are not in the body's own shadow"""

CLEARLY_BETTER = 0.5
"""Minimum share of the variation over the frames that Lambert's law must explain."""
_AMBIENT = (0.03, 0.15, 0.5)
_ROUNDS, _STEPS = 3, 6
_MIN_SIGMA_RAD = np.deg2rad(0.5)
"""Minimum, for errors common to all normals and a nonlinear camera."""
_MIN_VERTICES = 60


@dataclass(frozen=True)
class Observations:
    """What frames saw of sampled vertices: m observations of n vertices."""

    vertex: Ints
    """(m,) 0..n-1"""
    frame: Ints
    """(m,) 0..f-1"""
    normal_N: Array
    """(m, 3) the vertex's normal in N at that frame"""
    intensity: Array
    """(m,)"""
    group: Ints
    """(m,) part of the data with common errors, for instance a side of the body"""
    n_frames: int
    """f"""


@dataclass(frozen=True)
class Sunlight:
    """The light that explains the images."""

    direction_N: Array
    """(3,) unit vector from the target towards the Sun"""
    sigma_rad: float
    """Standard deviation of the direction along each of two axes across it; inf where it is not determined"""
    ambient: Array
    """(4,) ambient light over that of the Sun: the mean over all directions, then its gradient along N"""
    explained: float
    """Share of the variation of the vertices' intensities over the frames"""
    sunny: Bools
    """(f,) frames in which the Sun shone"""

    def ambient_on(self, normal_N: Array) -> Array:
        """(n,) ambient light on surfaces with these normals (n, 3), over that of the Sun."""
        return np.asarray(np.maximum(self.ambient[0] + normal_N @ self.ambient[1:], 0.0))


def find_sun(seen: Observations, lit: Lit) -> Sunlight | None:
    """The Sun's direction, or None: too few observations, or no rotation."""
    kept = np.bincount(seen.vertex)[seen.vertex] >= 4
    if len(np.unique(seen.vertex[kept])) < _MIN_VERTICES:
        return None
    problem, sunny = _Problem(seen, kept), np.ones(seen.n_frames, dtype=bool)
    s, e0 = problem.best_of_grid()
    e = np.array([e0, 0.0, 0.0, 0.0])
    for round_ in range(_ROUNDS):
        shone = lit(s)[kept]
        s, e = problem.refined(s, e, shone)
        if round_ == 0:
            # frames in the shadow of a planet say nothing about the direction
            sunny = problem.sunny(s, e, shone)
            kept &= sunny[seen.frame]
            if len(np.unique(seen.vertex[kept])) < _MIN_VERTICES:
                return None
            problem = _Problem(seen, kept)
    shone = lit(s)[kept]
    sigma_rad = float(np.hypot(problem.sigma_rad(s, e, shone), _MIN_SIGMA_RAD))
    return Sunlight(s, sigma_rad, e, problem.explained(s, e, shone), sunny)


class _Problem:
    def __init__(self, seen: Observations, kept: Bools) -> None:
        self.seen, self.kept = seen, kept
        _, self.vertex = np.unique(seen.vertex[kept], return_inverse=True)
        self.n = int(self.vertex.max()) + 1
        self.normal, self.intensity = seen.normal_N[kept], seen.intensity[kept]
        mean = self._sum(self.intensity) / self._sum(np.ones(len(self.vertex)))
        self.change = self.intensity - mean[self.vertex]
        self.scale = max(1.4826 * float(np.median(np.abs(self.change))), 2.0)

    def _sum(self, values: Array) -> Array:
        return np.asarray(np.bincount(self.vertex, weights=values, minlength=self.n), dtype=np.float64)

    def best_of_grid(self) -> tuple[Array, float]:
        """The best of many directions and three shares of ambient light, on some of the vertices."""
        some = self.vertex % max(1, self.n // 700) == 0
        vertex, intensity, normal = self.vertex[some], self.intensity[some], self.normal[some]
        best, least = (np.array([0.0, 0.0, -1.0]), _AMBIENT[0]), np.inf
        for s in directions(320):
            facing = np.maximum(normal @ s, 0.0)
            for e in _AMBIENT:
                light = facing + e
                up = np.bincount(vertex, weights=light * intensity, minlength=self.n)
                down = np.bincount(vertex, weights=light * light, minlength=self.n)
                albedo = up / np.maximum(down, 1e-12)
                loss = float(np.minimum(np.abs(intensity - albedo[vertex] * light), 3.0 * self.scale).sum())
                if loss < least:
                    best, least = (s, e), loss
        return best

    def _light(self, s: Array, e: Array, shone: Bools) -> tuple[Array, Bools]:
        facing = self.normal @ s
        on = (facing > 0.0) & shone
        return np.where(on, facing, 0.0) + np.maximum(e[0] + self.normal @ e[1:], 1e-3), on

    def _albedo(self, light: Array, weight: Array) -> Array:
        up, down = self._sum(weight * light * self.intensity), self._sum(weight * light * light)
        return up / np.maximum(down, 1e-12)

    def _residual(self, light: Array) -> tuple[Array, Array, Array]:
        """Residuals, their robust weights and the albedos that go with them."""
        weight = np.ones(len(self.vertex))
        for _ in range(3):
            albedo = self._albedo(light, weight)
            residual = self.intensity - albedo[self.vertex] * light
            scale = max(1.4826 * float(np.median(np.abs(residual))), 1.0)
            weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2) ** 2
        return residual, weight, albedo

    def refined(self, s: Array, e: Array, shone: Bools) -> tuple[Array, Array]:
        """Gauss-Newton on direction and ambient light, the albedos projected out."""
        for _ in range(_STEPS):
            light, on = self._light(s, e, shone)
            residual, weight, albedo = self._residual(light)
            J, across = self._jacobian(s, light, on, albedo, weight)
            H = J.T @ (weight[:, None] * J)
            prior = np.diag([0.0, 0.0, 0.0, *[float(np.trace(H)) * 1e-4] * 3])
            gradient = J.T @ (weight * residual) - prior @ np.append([0.0, 0.0], e)
            step = np.linalg.solve(H + prior + 1e-9 * np.eye(6), gradient)
            step *= min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-12))
            s = s + across @ step[:2]
            s = s / np.linalg.norm(s)
            e = e + step[2:]
            e[0] = np.clip(e[0], 1e-3, 2.0)
        return s, e

    def _jacobian(
        self, s: Array, light: Array, on: Bools, albedo: Array, weight: Array
    ) -> tuple[Array, Array]:
        """(m, 6) of the prediction by two rotations of s and by e, and the directions (3, 2) across s."""
        across = np.linalg.svd(s[None, :])[2][1:].T
        rotations = np.where(on[:, None], self.normal @ across, 0.0)
        J = np.column_stack([rotations, np.ones(len(light)), self.normal])
        J = J * albedo[self.vertex][:, None]
        down = np.maximum(self._sum(weight * light * light), 1e-12)
        for k in range(6):
            J[:, k] -= light * (self._sum(weight * light * J[:, k]) / down)[self.vertex]
        return J, across

    def sunny(self, s: Array, e: Array, shone: Bools) -> Bools:
        """(f,) frames in which sunlit vertices are about as bright as in the other frames."""
        light, on = self._light(s, e, shone)
        _, _, albedo = self._residual(light)
        bright = on & (light > 0.4)
        ratio = self.intensity / np.maximum(albedo[self.vertex] * light, 1e-9)
        frame = self.seen.frame[self.kept]
        lit = [ratio[bright & (frame == k)] for k in range(self.seen.n_frames)]
        gain = np.array([np.median(values) if len(values) else np.nan for values in lit])
        typical = np.nanmedian(gain) if np.isfinite(gain).any() else 0.0
        return np.asarray(~(gain < 0.5 * typical))

    def sigma_rad(self, s: Array, e: Array, shone: Bools) -> float:
        """By the jackknife over the groups of the data.

        Deviations from the law (gloss, a nonlinear camera, biased normals) are common to a group; the scatter
        of the residuals alone would give a sigma ten times too small.
        """
        group = self.seen.group[self.kept]
        labels, size = np.unique(group, return_counts=True)
        # minimum share of the data in a group
        labels = labels[size >= 0.01 * len(group)]
        if len(labels) < 4:
            return float("inf")
        found = []
        for label in labels:
            rest = group != label
            kept = self.kept.copy()
            kept[self.kept] = rest
            found.append(_Problem(self.seen, kept).refined(s, e, shone[rest])[0])
        away = np.array(found) - np.mean(found, axis=0)
        return float(np.sqrt(0.5 * (len(labels) - 1.0) / len(labels) * np.sum(away**2)))

    def explained(self, s: Array, e: Array, shone: Bools) -> float:
        light, _ = self._light(s, e, shone)
        residual, _, _ = self._residual(light)
        most = (3.0 * self.scale) ** 2
        left = float(np.minimum(residual**2, most).sum())
        return 1.0 - left / max(float(np.minimum(self.change**2, most).sum()), 1e-12)
