"""Figure of what a free body keeps: energies and angular momentum over time (thesis figures 6-7, 6-8)."""

import numpy as np

from polhode.lie import Array
from polhode.pipeline.report.content import Content, Motion
from polhode.pipeline.report.plot import ACCENT, FAINT, Figure, band, line, panels
from polhode.rigid_body import angular_momentum_N, rotational_energy


def conserved_figures(content: Content) -> list[Figure]:
    """Energy of rotation and of translation, angular momentum; nothing without an estimate."""
    return [] if content.motion is None else [_conserved(content.motion)]


def _conserved(motion: Motion) -> Figure:
    path, moments = motion.trajectory, motion.moments
    cov_v = motion.covariance.covariance[:, 3:6, 3:6]
    cov_w = motion.covariance.covariance[:, 9:12, 9:12]
    h_P = path.w_P * moments
    energy, momentum = rotational_energy(np.diag(moments), path.w_P), np.linalg.norm(h_P, axis=1)
    h_N = angular_momentum_N(np.diag(moments), path.R_NP, path.w_P)
    mean_h = np.mean(h_N, axis=0)
    # The arctangent keeps its digits at small angles, where the arccosine has none.
    tilt = np.arctan2(np.linalg.norm(np.cross(h_N, mean_h), axis=1), h_N @ mean_h)
    translation = 0.5e6 * np.sum(path.v_N**2, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope_h = h_P * moments / momentum[:, None]
        curves = (
            (100 * (energy / energy.mean() - 1), 100 * _sigma(h_P, cov_w) / energy.mean(), 0.0),
            (translation, 1e6 * _sigma(path.v_N, cov_v), float(np.mean(translation))),
            (100 * (momentum / momentum.mean() - 1), 100 * _sigma(slope_h, cov_w) / momentum.mean(), 0.0),
        )
    figure = panels(
        [
            ("rotation [%]", "½ v² [mm²/s²]"),
            ("momentum [%]", "direction [deg]"),
        ],
        "time since the first frame [s]",
        showlegend=False,
    )
    ends = path.time_s[[0, -1]]
    dashes = {"mode": "lines", "line": {"color": FAINT, "width": 1.2, "dash": "dash"}}
    data = []
    for panel, (value, sigma, mean) in enumerate(curves, start=1):
        data += band(path.time_s, value, 3 * sigma, ACCENT, panel)
        data.append(line(ends, [mean, mean], "mean", FAINT, panel, **dashes))
        data.append(line(path.time_s, value, "", ACCENT, panel))
    data.append(line(path.time_s, np.rad2deg(tilt), "", ACCENT, 4))
    figure["yaxis4"]["rangemode"] = "tozero"
    return Figure(
        "energy-momentum",
        "Energy and angular momentum",
        "Kinetic energy of the rotation relative to its mean, and of the translation per mass; angular "
        "momentum relative to its mean, and the angle between it in N and its mean direction. Bands: three "
        "standard deviations, from the velocities alone. Without force and torque all are constant: a drift "
        "beyond the bands speaks of one, or of a wrong inertia.",
        data,
        figure,
        height_px=480,
    )


def _sigma(gradient: Array, covariance: Array) -> Array:
    """Root of g C g per row: gradient (F, 3), covariance (F, 3, 3) -> (F,)."""
    return np.asarray(np.sqrt(np.einsum("fi,fij,fj->f", gradient, covariance, gradient)))
