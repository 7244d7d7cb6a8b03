"""Level of the disturbances: the evidence that the measurements give of the process noise.

The evidence of a level q = (acceleration, torque) is Laplace's approximation: states, landmarks and constants
are fitted under q and integrated out as a Gaussian (Bishop, "Pattern Recognition and Machine Learning", 2006,
4.4)::

    -ln p(data | q) = cost(x_q) + 1/2 ln det Lambda(q) + 1/2 ln det H(x_q) + constant

Lambda is the covariance of the process noise over all steps and H the Gauss-Newton Hessian. The result is the
mean of the posterior (``level_posterior``), with its uncertainty.

Only the weights of the dynamics change in the search: near a solution the measurements constrain the poses as
a Gaussian does. Their stereo terms are expanded in the poses, with one elimination of the landmarks; an
iteration then costs about a third of one of the whole problem.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError

from polhode.backend.outliers_and_noise.level_posterior import posterior
from polhode.backend.problem.iterate import N_POSE, Iterate
from polhode.backend.problem.motion_data import MotionData
from polhode.backend.solvers.chain import eliminate_chain, half_log_det, solve_with_chain
from polhode.backend.solvers.gauss_newton import (
    CONSTANT_SCALE,
    MIN_DAMPING,
    Damping,
    GaussNewton,
    NormalEquations,
)
from polhode.backend.solvers.linearization_point import (
    TIGHT_GAUGE,
    LinearizationPoint,
    MotionFit,
    linearization_point,
)
from polhode.backend.solvers.robust_kernel import robust_cost
from polhode.backend.solvers.schur import back_substitute
from polhode.geometry.lie import Array, Ints


@dataclass(frozen=True)
class VisionExpansion:
    """Stereo terms without landmarks: value + g p + p S p / 2, p (6 F,) poses relative to ``reference``."""

    reference: Iterate
    value: float
    g: Array
    """(6 F,)"""
    S: Array
    """(6 F, 6 F)"""
    half_log_det: float
    """Half the logarithm of the determinant of the landmarks' information"""
    _E: Array
    _h: Array
    _C_inv: Array
    _observations: tuple[Ints, Ints]

    @staticmethod
    def of(fit: MotionFit) -> "VisionExpansion":
        """The expansion about an iterate, with the robust weights there."""
        data, iterate = fit.data, fit.iterate
        vision = GaussNewton(data, with_dynamics=False)
        fixed, x = fit.linearized(), iterate.vector()
        system = vision.normal_equations(fixed, x, prior=False)
        S, g, C_inv = vision.reduced(system)
        poses = pose_slots(iterate)
        S = S[np.ix_(poses, poses)]
        squares = np.sum(vision.residuals(fixed, x)[0] ** 2, axis=1)
        value = robust_cost(squares, data.robust_scale)
        value -= 0.5 * float(np.einsum("li,lij,lj->", system.h, C_inv, system.h))
        return VisionExpansion(
            *(iterate, value, g[poses], np.tril(S) + np.tril(S, -1).T),
            0.5 * float(np.linalg.slogdet(system.C)[1].sum()),
            *(system.E, system.h, C_inv, (data.frame, data.start)),
        )

    def at(self, x: Array) -> tuple[float, Array]:
        """Value and gradient (6 F,) at states and constants x (n,)."""
        p = (x - without_landmarks(self.reference))[pose_slots(self.reference)]
        slope = self.S @ p
        return self.value + float(self.g @ p + 0.5 * p @ slope), self.g + slope

    def iterate(self, x: Array) -> Iterate:
        """The unknowns at states and constants x (n,), the landmarks fitted to the poses."""
        frame, start = self._observations
        step = x - without_landmarks(self.reference)
        marks = back_substitute(step, frame, start, self._E, self._C_inv, -self._h, self.reference.n_state)
        return self.reference.moved_to(np.concatenate([x, (self.reference.p_G + marks).ravel()]))


class CondensedGaussNewton(GaussNewton):
    """Gauss-Newton in states and constants x (n,) about the expansion's reference."""

    name = "condensed"

    def __init__(self, data: MotionData, vision: VisionExpansion) -> None:
        super().__init__(data)
        self.vision = vision
        self._poses, n = pose_slots(vision.reference), vision.reference.n_dense
        self._half_log_det = np.nan
        # one system at a time is needed; to find new memory for each takes as long as to fill it
        self._H = np.empty((n, n))

    def linearization_point(self) -> LinearizationPoint:
        """About the expansion's reference, under the noise of the data."""
        return linearization_point(self.data, self.vision.reference, TIGHT_GAUGE)

    def cost(self, fixed: LinearizationPoint, x: Array) -> float:
        """The objective."""
        return self.with_other_costs(self.vision.at(x)[0], fixed, x)

    def normal_equations(
        self, fixed: LinearizationPoint, x: Array, weight: Array | None = None, prior: bool = True
    ) -> NormalEquations:
        """Linearize at x, with the weights of the expansion. Overwrites the system before."""
        n, s = fixed.reference.n_dense, fixed.reference.n_state
        H, g = self._H, np.zeros(n)
        H[:] = 0.0
        total, slope = self.vision.at(x)
        # without fancy indices, which copy: the poses are the first numbers of each frame
        frames = fixed.reference.n_frames
        blocks = H[: s * frames, : s * frames].reshape(frames, s, frames, s)
        blocks[:, :N_POSE, :, :N_POSE] = self.vision.S.reshape(frames, N_POSE, frames, N_POSE)
        g[self._poses] = slope
        total = self.add_other_terms(total, fixed, x, H, g, prior)
        none = np.zeros((0, 3))
        return NormalEquations(H, g, none[:, None], none, none[:, None], total, s)

    def step(self, system: NormalEquations, damped: Damping) -> Array:
        """The damped step of states and constants."""
        frames = self.vision.reference.n_frames
        # where steps between frames are stiff, even the least damping would change the determinant
        damping = damped.of_all if damped.of_all > MIN_DAMPING else 0.0
        chain = eliminate_chain(system.H, system.g, frames, system.n_state, damping)
        at = N_POSE * frames + np.arange(len(CONSTANT_SCALE))
        chain.dense[at, at] += damped.of_constants / CONSTANT_SCALE**2
        step, self._half_log_det = solve_with_chain(chain, system.n_state)
        return step

    def solve_roughly(
        self, fixed: LinearizationPoint, x: Array, max_iterations: int, small_decrease: float
    ) -> tuple[Array, float, float]:
        """Descend from x until the next step would decrease the cost by no more than ``small_decrease``.

        A step that decreases it as the quadratic model says, within that, needs no other. Returns x, its
        cost, and half the logarithm of the determinant of the information with which the last step was taken,
        landmarks included. Raises LinAlgError where a step has no solution.
        """
        damping = Damping()
        for _ in range(max_iterations):
            system = self.normal_equations(fixed, x)
            cost = system.cost
            found = self._descend(fixed, x, system, damping)
            if found is None:
                break
            predicted = -0.5 * float(system.g @ (found[0] - x))
            x, cost, damping = found
            decrease = system.cost - cost
            if min(decrease, abs(decrease - predicted)) <= small_decrease:
                break
            damping = damping.less()
        if damping != Damping():
            self.step(self.normal_equations(fixed, x), Damping())
        return x, cost, self._half_log_det + self.vision.half_log_det


def pose_slots(iterate: Iterate) -> Ints:
    """(6 F,) the poses among the unknowns."""
    frames = iterate.n_state * np.arange(iterate.n_frames)[:, None]
    return np.asarray((frames + np.arange(N_POSE)).ravel())


def without_landmarks(iterate: Iterate) -> Array:
    """States and constants (n,) of an iterate."""
    return replace(iterate, p_G=np.zeros((0, 3))).vector()


START_ITERATIONS = 10
INSIGNIFICANT_EVIDENCE = 2.0
"""Difference of log-evidence that is not significant."""
ITERATIONS = 3
"""Gauss-Newton iterations at each level, from the solution at the neighbouring level."""
AGREEING_EVIDENCE = 0.5
"""The search ends when the problem itself has the evidence of its expansion within this."""


@dataclass(frozen=True)
class LevelFit(MotionFit):
    """A process noise, the motion fitted under it, and minus the logarithm of its evidence."""

    minus_log_evidence: float


@dataclass(frozen=True)
class LevelTrial:
    """A process noise in a search, what was fitted under it, and minus the logarithm of its evidence."""

    data: MotionData
    x: Array
    """(n,) states and constants, about the search's expansion"""
    minus_log_evidence: float


class LevelSearch:
    """Fits under many levels, with the stereo terms expanded about one iterate.

    The levels change how the steps between frames are weighted, not the measurements. Their expansion costs
    one elimination of the landmarks; a level then costs a quarter of ``fit_level``.
    """

    def __init__(self, fit: MotionFit) -> None:
        self._vision = VisionExpansion.of(fit)
        self._data = fit.data
        self.start = without_landmarks(fit.iterate)
        self._trials: list[LevelTrial] = []

    def fit(self, data: MotionData, x: Array, iterations: int = ITERATIONS) -> LevelTrial:
        """Fit from x (n,) under the noise of ``data``, whose measurements are the same."""
        solver = CondensedGaussNewton(data, self._vision)
        fixed = solver.linearization_point()
        try:
            # a smaller decrease of the cost than a hundredth changes no comparison of evidences
            x, cost, half_log_det = solver.solve_roughly(fixed, x, iterations, 0.01)
        except LinAlgError:
            return LevelTrial(data, x, np.inf)
        return LevelTrial(data, x, cost + fixed.steps.half_log_det + half_log_det)

    def at(self, accel_psd: float, torque_psd: float) -> LevelTrial:
        """The fit under other levels, from the nearest ones that were tried."""
        data = with_level(self._data, accel_psd, torque_psd)
        off = [abs(np.log([each.data.accel_psd / accel_psd, each.data.torque_psd / torque_psd])).sum()
               for each in self._trials]  # fmt: skip
        trial = self.fit(data, self._trials[int(np.argmin(off))].x if off else self.start, START_ITERATIONS)
        if np.isfinite(trial.minus_log_evidence):
            self._trials.append(trial)
        return trial

    def minus_log_evidence(self, accel_psd: float, torque_psd: float) -> float:
        """Of other levels."""
        return self.at(accel_psd, torque_psd).minus_log_evidence

    def fitted(self, trial: LevelTrial, iterations: int = ITERATIONS) -> LevelFit:
        """The fit of the problem itself under the level of a trial."""
        return fit_level(MotionFit(trial.data, self._vision.iterate(trial.x)), iterations)


def estimate_process_noise(fit: MotionFit) -> LevelFit:
    """The posterior of accel_psd and torque_psd under the problem's prior, and the fit at their means."""
    prior, found = fit.data.level_prior, LevelFit(fit.data, fit.iterate, np.inf)
    for _ in range(4):
        search = LevelSearch(found)
        levels = posterior(prior, search.minus_log_evidence)
        trial = search.at(*levels.psd)
        found = search.fitted(trial, START_ITERATIONS)
        if abs(found.minus_log_evidence - trial.minus_log_evidence) <= AGREEING_EVIDENCE:
            break
    return replace(found, data=replace(found.data, level_decades=levels.decades))


def with_level(data: MotionData, accel_psd: float, torque_psd: float) -> MotionData:
    """The problem under another process noise."""
    return replace(data, accel_psd=accel_psd, torque_psd=torque_psd)


def fit_level(fit: MotionFit, iterations: int = ITERATIONS) -> LevelFit:
    """Fit under the level of the problem, with its evidence; infinitely unlikely where the fit fails."""
    data = fit.data
    solver, fixed = GaussNewton(data), fit.linearized(TIGHT_GAUGE)
    try:
        solution = solver.solve(fixed, fit.iterate.vector(), iterations)
        system = solver.normal_equations(fixed, solution.x)
        reduced, _, _ = solver.reduced(system)
        half_log_det_dense = half_log_det(reduced, data.n_frames, system.n_state)
    except LinAlgError:
        return LevelFit(data, fit.iterate, np.inf)
    half_log_det_marks = 0.5 * float(np.linalg.slogdet(system.C)[1].sum())
    minus_log_evidence = system.cost + fixed.steps.half_log_det + half_log_det_dense + half_log_det_marks
    return LevelFit(data, fit.iterate.moved_to(solution.x), minus_log_evidence)
