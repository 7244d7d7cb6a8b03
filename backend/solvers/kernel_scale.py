"""How wide the robust kernel is in the end: as wide as the residuals allow.

A Cauchy kernel of three standard deviations costs 4 % of the information where the noise is Gaussian, and
more than its sandwich covariance says. Once contradictions have left the problem, the kernel whose estimate
scatters least is chosen from the residuals themselves (Huber's asymptotic variance as the criterion; Hampel
et al., "Robust Statistics", 1986, section 2.4).
"""

import numpy as np

from polhode.lie import Array

WIDER = (1.0, 1.5, 2.0, 3.0, 5.0)
"""Candidate scales, over the one in the configuration."""


def widest_useful(s: Array, scale: float) -> float:
    """Of ``scale`` and wider kernels the most efficient for residuals of squared norms s (M,), whitened."""
    candidates = [scale * factor for factor in WIDER]
    return candidates[int(np.argmax([efficiency(s, candidate) for candidate in candidates]))]


def efficiency(s: Array, scale: float) -> float:
    """Information that an observation contributes under the kernel, per degree of freedom.

    Huber's sandwich a^2 / b with a = mean(psi'), b = mean(psi^2), over residuals s (M,), the squared norms of
    three whitened components. Equals 1 for a wide kernel and Gaussian noise. The noise level is known by now,
    residuals are smaller by what the fit took: they are scaled back to it.
    """
    s = s * (3.0 / max(float(np.mean(s)), 1e-12))
    w = 1.0 / (1.0 + s / scale**2)
    slope = np.mean(w - (2.0 / 3.0) * s * w**2 / scale**2)
    spread = np.mean(w**2 * s) / 3.0
    return max(float(slope), 0.1) ** 2 / max(float(spread), 1e-12)
