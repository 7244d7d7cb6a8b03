"""The robust (Cauchy) kernel: cost, weight, curvature, its scale, and the information that remains under it.

A Cauchy kernel of three standard deviations costs 4 % of the information where the noise is Gaussian, and
more than its sandwich covariance says. Once contradicting observations have been removed
(``outliers_and_noise/noise_and_outliers``), the kernel whose estimate scatters least is chosen from the
residuals themselves (Huber's asymptotic variance as the criterion; Hampel et al., "Robust Statistics", 1986,
section 2.4).
"""

import numpy as np

from polhode.geometry.lie import Array

MAX_CURVATURE = 0.6
"""Largest share of the Jacobian that the correction removes. Measured: smaller values converge more slowly
near the solution, larger ones from a cold start."""
RELATIVE_SCALES = (1.0, 1.5, 2.0, 3.0, 5.0)
"""Candidate scales, relative to the configured one."""


def most_efficient_scale(s: Array, scale: float) -> float:
    """The most efficient of ``scale`` and wider scales for whitened residuals with squared norms s (M,)."""
    candidates = [scale * factor for factor in RELATIVE_SCALES]
    return candidates[int(np.argmax([efficiency(s, candidate) for candidate in candidates]))]


def efficiency(s: Array, scale: float) -> float:
    """Information that an observation contributes under the kernel, per degree of freedom.

    Huber's sandwich a^2 / b with a = mean(psi'), b = mean(psi^2), over residuals s (M,), the squared norms of
    three whitened components. Equals 1 for a wide kernel and Gaussian noise. The fit has reduced the
    residuals: they are scaled to the noise level, which is known.
    """
    slope, spread = _slope_and_spread(s, scale)
    return slope**2 / spread


def score_gain(s: Array, scale: float) -> float:
    """Factor a / b of the kernel's gradient: its slope and its variance are then the ``efficiency``."""
    slope, spread = _slope_and_spread(s, scale)
    return slope / spread


def _slope_and_spread(s: Array, scale: float) -> tuple[float, float]:
    s = s * (3.0 / max(float(np.mean(s)), 1e-12))
    w = 1.0 / (1.0 + s / scale**2)
    slope = np.mean(w - (2.0 / 3.0) * s * w**2 / scale**2)
    spread = np.mean(w**2 * s) / 3.0
    return max(float(slope), 0.1), max(float(spread), 1e-12)


def robust_cost(s: Array, scale: float) -> float:
    """Cauchy: sum of 0.5 c^2 ln(1 + s / c^2) over squared norms s (M,)."""
    return float(0.5 * scale**2 * np.log1p(s / scale**2).sum())


def robust_weight(s: Array, scale: float) -> Array:
    """Derivative of the Cauchy kernel: 1 / (1 + s / c^2)."""
    return np.asarray(1.0 / (1.0 + s / scale**2))


def kernel_curvature(s: Array, robust_scale: float) -> Array:
    """Second-order (Triggs) correction: factor of r r^T J to be subtracted from the Jacobian J, s = r.r (M,).

    With the kernel's exact second derivative the Hessian is w J^T (I - 2 w r r^T / c^2) J, w the weight.
    Written as w B^T B with B = J - curvature r r^T J (Triggs et al., "Bundle adjustment", 2000, eq. 11) it
    stays positive; the correction is limited by MAX_CURVATURE.
    """
    limited = np.minimum(2.0 / (robust_scale**2 + s), MAX_CURVATURE / (s + 1e-12))
    return np.asarray(limited / (1.0 + np.sqrt(1.0 - limited * s)))


def robust_information(s: Array, scale: float) -> Array:
    """Information (M,) that each observation contributes under the Cauchy kernel, s its squared norm.

    The kernel's efficiency, shared out in proportion to the weights.
    """
    w = 1.0 / (1.0 + s * (3.0 / max(float(np.mean(s)), 1e-12)) / scale**2)
    return np.asarray(w / np.mean(w) * efficiency(s, scale))


def robust_gain(scale: float) -> float:
    """Factor that turns the weights of the Cauchy kernel into the information of Gaussian observations.

    Huber's sandwich for an M-estimator, a^2 / b with a = E psi', b = E psi^2, over the mean weight; in three
    dimensions, by quadrature.
    """
    s = (np.arange(4000) + 0.5) * 0.01
    density = np.sqrt(s) * np.exp(-0.5 * s)
    w = 1.0 / (1.0 + s / scale**2)
    slope = np.average(w - (2.0 / 3.0) * s * w**2 / scale**2, weights=density)
    spread = np.average(w**2 * s, weights=density) / 3.0
    return float(slope**2 / spread / np.average(w, weights=density))
