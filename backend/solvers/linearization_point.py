"""What stays fixed during one solve: reference attitudes, whitening, priors and gauge."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.dynamics.process_noise import whitening
from polhode.backend.dynamics.propagation import series_steps
from polhode.backend.dynamics.residuals import Steps
from polhode.backend.problem.iterate import Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.geometry.lie import Array

LOOSE_GAUGE, TIGHT_GAUGE = 0.1, 1e-3
"""Standard deviation with which G is fixed at the first frame [rad, body radii]. A cold start must be free to
move G; near the solution a step that moves G would leave the curved valley of equal cost."""
COM_PRIOR_M = 0.1
"""Smallest standard deviation of the prior on the centre of mass [m]; for larger bodies it is their
radius."""
LOOSE_PSD = 1.0
"""[(m/s^2)^2/Hz], [(rad/s^2)^2/Hz] process noise so strong that a step carries no information on the body."""


@dataclass(frozen=True)
class LinearizationPoint:
    """What is fixed during one solve: reference attitudes, whitening at the current rates, priors, gauge.

    The free frame G is kept near the reference by a weak prior on the first pose. It costs nothing at the
    solution, because every motion of G with its landmarks leaves the other terms unchanged.
    """

    reference: Iterate
    A: Array
    """(F, 3, 3) R_RN R_ref"""
    steps: Steps
    """the steps between frames"""
    prior: Array
    """(13,) parameters of the prior kernel"""
    gauge_information: Array
    """(6,) diagonal of the prior on p_NG, theta of the first frame"""
    camera_information: Array
    """(6,) diagonal of the prior on the errors of the camera's pose, for each frame"""
    bias_sigma: tuple[float, float]
    """[N, N m] of the constant biases of a known wrench"""


@dataclass(frozen=True)
class MotionFit:
    """A problem and a value of its unknowns: a start, or a solution."""

    data: MotionData
    iterate: Iterate

    def linearized(self, gauge: float = LOOSE_GAUGE) -> LinearizationPoint:
        """Fix references and whitening here; gauge is the standard deviation of the first pose."""
        return linearization_point(self.data, self.iterate, gauge)

    def moved_to(self, x: Array) -> Self:
        """The unknowns at a vector about the iterate."""
        return replace(self, iterate=self.iterate.moved_to(x))

    def with_data(self, **changes: object) -> "MotionFit":
        """The same unknowns of a problem with some of its fields changed."""
        return MotionFit(replace(self.data, **changes), self.iterate)  # type: ignore[arg-type]


def linearization_point(data: MotionData, iterate: Iterate, gauge: float = LOOSE_GAUGE) -> LinearizationPoint:
    """Fix references and whitening at an iterate; gauge is the standard deviation of the first pose."""
    middle, radius = middle_and_radius(iterate.p_G)
    com_sigma = max(COM_PRIOR_M, radius)
    # 1e-7 m or rad where only the other part of the camera's pose is noisy
    of_camera = [max(sigma, 1e-7) ** -2 for sigma in data.camera_sigma]
    return LinearizationPoint(
        reference=iterate,
        A=data.R_RN @ iterate.R_NG,
        steps=_steps(data, iterate),
        prior=np.concatenate([middle, [com_sigma], iterate.R_inertia.T.ravel()]),
        gauge_information=np.repeat([(gauge * com_sigma) ** -2, gauge**-2], 3),
        camera_information=np.repeat(of_camera, 3),
        bias_sigma=data.bias_sigma,
    )


def _steps(data: MotionData, iterate: Iterate) -> Steps:
    """The steps between frames, whitened at the rates of the iterate."""
    w, J_G, known = iterate.w_G[:-1], iterate.J_G(data.form), data.impulses
    unknown = np.zeros_like(data.dt_s)
    if data.loose is not None:
        unknown[data.loose] = LOOSE_PSD
    if known is not None and iterate.wrench is None:
        unknown[known.acting] = LOOSE_PSD
    accel_psd, torque_psd = np.maximum(data.accel_psd, unknown), np.maximum(data.torque_psd, unknown)
    # an unknown disturbance of any time history within its step, integrated out: white, as strong over the
    # step
    accel_node, torque_node = np.square(data.node_sigma)[:, None] * data.nodes * data.dt_s
    W_t, W_r, half_log = whitening(w, J_G, data.dt_s, accel_psd + accel_node, torque_psd + torque_node)
    series = series_steps(w, J_G, data.dt_s, torque_psd)
    if known is None or iterate.wrench is None:
        return Steps(data.dt_s, series, W_t, W_r, half_log)
    series = known.refine_series(series, w, data.dt_s)
    return Steps(data.dt_s, series, W_t, W_r, half_log, known.force_increments, known.torque(series))


def middle_and_radius(points: Array) -> tuple[Array, float]:
    """Geometric median (3,) of points (n, 3), and their median distance from it.

    Raises LinAlgError when no point is left: such a motion is no answer.
    """
    if len(points) == 0:
        raise LinAlgError("no landmark is left")
    # robust and independent of the axes (Weiszfeld 1937)
    middle = points.mean(axis=0)
    for _ in range(10):
        weight = 1.0 / np.maximum(np.linalg.norm(points - middle, axis=1), 1e-6)
        middle = np.asarray(weight @ points / weight.sum())
    return middle, float(np.sqrt(np.median(np.sum((points - middle) ** 2, axis=1))))


def recenter_inertia(data: MotionData, iterate: Iterate) -> Iterate:
    """The same inertia with its reference rotation moved to it."""
    xi, R_inertia = data.form.coordinates(iterate.second_moments(data.form))
    return replace(iterate, xi=xi, R_inertia=R_inertia)
