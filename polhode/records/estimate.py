"""Motion, mass properties and sparse map: what the back end finds.

Frames (docs/notation.md): N inertial, R rectified left camera, G geometric frame of the target, P principal
axes at the centre of mass. ``p_N = X_NG @ p_G``; ``p_G = R_GP @ p_P + com_G``.
"""

from dataclasses import dataclass, field

import numpy as np

from polhode.geometry.lie import Array, Bools, Ints
from polhode.records.calibration_effects import CalibrationEffects


@dataclass(frozen=True)
class InitialMotion:
    """A first guess: the target's pose per frame, by chaining, pose graph and bundle adjustment."""

    X_RG: Array
    """(F, 4, 4) pose of the target in the rectified left camera; interpolated where not connected."""
    connected: Bools
    """(F,) true where the pose comes from measurements."""


@dataclass(frozen=True)
class NoiseLevels:
    """Noise levels of the estimate."""

    pixel_sigma_px: float
    """Residual standard deviation of u and v, robust [px]."""
    disparity_sigma_px: float
    accel_psd: float
    """[(m/s^2)^2/Hz]"""
    torque_psd: float
    """[(rad/s^2)^2/Hz], torque over the middle moment."""
    accel_psd_decades: float = 0.0
    """Standard deviation of the logarithm of accel_psd, a mean power [decades]; 0: it was given"""
    torque_psd_decades: float = 0.0
    times_stated: float | None = None
    """Estimated over stated level (power), the larger of force and torque; None: unknown"""
    drift_px: float = 0.0
    """Standard deviation of what landmarks slide over the surface while the target turns by more than a
    radian [px]"""


@dataclass(frozen=True)
class ProgramEnd:
    """What IPOPT says of the program's solution."""

    status: str
    """IPOPT's own word, such as Solve_Succeeded"""
    optimality: float
    """Largest entry of the gradient of the Lagrangian, of whitened residuals; NaN: not evaluated"""
    constraint_violation: float
    """0: the program has no constraints"""
    iterations: int
    seconds: float
    """With the time to build the program"""


@dataclass(frozen=True)
class SolverOutcome:
    """How the optimisation ended."""

    name: str
    iterations: int
    cost: float
    converged: bool
    reduced_chi2: float
    message: str = ""
    runner_up: dict[str, float] = field(default_factory=dict)
    """Cost of the other hypotheses, by name."""
    ipopt: ProgramEnd | None = None
    """None: IPOPT had no part in it."""


@dataclass(frozen=True)
class Identifiability:
    """What the data determine. ``com`` and ``axes`` are true only when every component is determined."""

    k1: bool
    k2: bool
    com: bool
    axes: bool
    detail: dict[str, str]
    """The reason, by direction."""
    com_P: Bools
    """(3,) each component of the centre of mass, along the principal axes."""
    axes_P: Bools
    """(3,) each rotation of the principal axes, about them."""
    sigma: Array
    """(8,) of com along P [m], k1, k2, the axes [rad]; inf where undetermined."""


@dataclass(frozen=True)
class MassProperties:
    """Mass distribution up to scale. Moments sorted Jxx >= Jyy >= Jzz, the middle one 1, P right-handed."""

    J_G: Array
    """(3, 3) about the centre of mass, axes of G."""
    moments: Array
    """(3,)"""
    k1: float
    """ln(Jxx / Jyy)"""
    k2: float
    """ln(Jyy / Jzz)"""
    cov_k: Array
    """(2, 2); inf on the diagonal where undetermined."""
    cov_J: Array
    """(5, 5) in the solver's parameters."""
    R_GP: Array
    """(3, 3)"""
    cov_R_GP: Array
    """(3, 3) of theta in R_GP Exp(theta) [rad^2]; inf on the diagonal where undetermined."""
    com_G: Array
    """(3,) [m]"""
    cov_com_G: Array
    """(3, 3) [m^2]; inf on the diagonal where undetermined."""
    identifiable: Identifiability
    mass_kg: float | None = None
    """From known forces; None: no forces are known. Likewise the following; a sigma of inf: undetermined."""
    sigma_mass_kg: float | None = None
    inertia_scale_kg_m2: float | None = None
    """Middle moment, from known torques: times J_G it gives the inertia in kg m^2"""
    sigma_inertia_scale_kg_m2: float | None = None
    cov_ln_scale: Array | None = None
    """(20,) covariance of the logarithm of that scale with what ``covariance_last_body`` describes"""
    J_by_xi: Array | None = None
    """(5, 3, 3) derivative of J_G by the solver's parameters, the middle moment 1 to first order"""

    @property
    def sigma_moments(self) -> Array:
        """(3,) of exp(k1), 1, exp(-k2), by the delta method."""
        return self.moments * np.sqrt([self.cov_k[0, 0], 0.0, self.cov_k[1, 1]])


@dataclass(frozen=True)
class Impulse:
    """Accumulated effect of unknown forces and torques over consecutive steps between frames."""

    start_ns: int
    end_ns: int
    delta_v_N: Array
    """(3,) change of velocity [m/s]"""
    sigma_delta_v_N: Array
    """(3,)"""
    delta_w_P: Array
    """(3,) sum of the changes of angular velocity, in the body [rad/s]"""
    sigma_delta_w_P: Array
    """(3,) inf where the principal axes are undetermined"""


@dataclass(frozen=True)
class Disturbances:
    """Accelerations by unknown forces and torques, mean over each of n steps between frames."""

    start_ns: Ints
    """(n,)"""
    end_ns: Ints
    """(n,)"""
    accel_N: Array
    """(n, 3) force over mass [m/s^2]"""
    sigma_accel_N: Array
    """(n, 3)"""
    angular_accel_P: Array
    """(n, 3) inverse inertia times torque [rad/s^2]"""
    sigma_angular_accel_P: Array
    """(n, 3) inf where the principal axes are undetermined"""
    impulses: tuple[Impulse, ...]
    """Of each run of consecutive steps: determined better than the single steps"""


@dataclass(frozen=True)
class Landmarks:
    """The sparse map in G."""

    p_G: Array
    """(L, 3) [m]"""
    sigma_m: Array
    """(L,) root of the mean variance over the three axes [m]"""
    observations: Ints
    """(L,) number of frames"""

    def __len__(self) -> int:
        """Number of landmarks, L."""
        return len(self.p_G)


@dataclass(frozen=True)
class RotationHypothesis:
    """The end of one of several motions that the data leave open."""

    odds: float
    r_N: Array
    """(3,) centre of mass [m]"""
    v_N: Array
    """(3,) [m/s]"""
    R_NG: Array
    """(3, 3)"""
    w_G: Array
    """(3,) [rad/s]"""
    J_G: Array
    """(3, 3) about the centre of mass, middle moment 1"""
    R_GP: Array
    """(3, 3)"""
    com_G: Array
    """(3,) [m]"""
    covariance: Array
    """(20, 20) as ``MotionEstimate.covariance_last_body``, had it been this motion"""
    accel_psd: float
    """[(m/s^2)^2/Hz]"""
    torque_psd: float
    """[(rad/s^2)^2/Hz], torque over the middle moment"""
    level_decades: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of the logarithms of both [decades]"""
    turn_deg: float = 0.0
    """Median rotation between frames [deg]"""


@dataclass(frozen=True)
class CalibrationScore:
    """What the residuals say of n errors that all observations share, everything else fitted to them again.

    The first two are a relative error of the focal length, and one of all disparities [px]; those of the
    calibration follow, in units of their prior.
    """

    information: Array
    """(n, n)"""
    score: Array
    """(n,) the information times the errors, and noise"""
    noise: Array
    """(n, n) covariance of that noise"""

    def of_prior(self) -> tuple[Array, Array, Array]:
        """Information, score and noise of the errors of the calibration alone."""
        return self.information[2:, 2:], self.score[2:], self.noise[2:, 2:]


@dataclass(frozen=True)
class EstimatedError:
    """A combination of parameters of the calibration that the data determine."""

    parameters: dict[str, float]
    """What it changes of those that mainly belong to it, true minus stated, by name"""
    value: float
    """In sigmas of the prior"""
    sigma: float
    """Standard deviation that is left, in sigmas of the prior"""


@dataclass(frozen=True)
class CalibrationPart:
    """What errors of the calibration, which all frames share, contribute to the covariances."""

    source: str
    """Of the sigmas of the calibration, in words"""
    last_joint: Array
    """(20, 20) of ``covariance_last_joint``"""
    cov_k: Array
    """(2, 2)"""
    cov_R_GP: Array
    """(3, 3) [rad^2]"""
    poses: Array
    """(F, 6, c) change of the seen poses by one sigma of each of c errors: shift along N [m], turn along G
    [rad]"""
    estimated: tuple[EstimatedError, ...] = ()
    """Errors that were estimated, and of which the measurements were freed"""
    correction: CalibrationEffects | None = None
    """Effect of these (c = 1), to be taken off measurements; None: there are none"""


@dataclass(frozen=True)
class MotionEstimate:
    """The result of the back end, one state per frame; r, v are absolute, the attitude is R_NP Exp(theta)."""

    timestamps_ns: Ints
    """(F,)"""
    r_N: Array
    """(F, 3) centre of mass [m]"""
    v_N: Array
    """(F, 3) [m/s]"""
    R_NP: Array
    """(F, 3, 3)"""
    w_P: Array
    """(F, 3) [rad/s]"""
    X_NG: Array
    """(F, 4, 4) as seen from the camera's stated poses; landmarks and depth refer to it. Where those poses
    are noisy, r_N and R_NP are corrected for their noise and differ from it."""
    covariance: Array
    """(F, 12, 12) in the order r (N), v (N), theta (P), w (P); inf on the diagonal where undetermined."""
    covariance_last_joint: Array
    """(20, 20): the last state (12), the 5 inertia parameters of the solver, com_G (3)."""
    mass: MassProperties
    landmarks: Landmarks
    residuals_px: Array
    """(M, 3) measured minus predicted uvd [px]."""
    inlier_weight: Array
    """(M,) weight of the robust kernel, 1 for a full inlier."""
    noise: NoiseLevels
    solver: SolverOutcome
    warnings: tuple[str, ...] = ()
    covariance_last_body: Array | None = None
    """(20, 20): the last r_N, v_N, theta in R_NG Exp(theta), w_G, then the 5 inertia parameters, com_G (3).
    Always finite: independent of the principal axes; a weak prior bounds what is undetermined."""
    covariance_X_NG: Array | None = None
    """(F, 6, 6) of X_NG, translation t [m] and rotation a [rad] along the axes of G:
    p_N = X_NG (Exp(a) p_G + t). Without errors common to all poses, and those of the calibration, which depth
    shares, so always finite. None: unknown"""
    covariance_of_marks: Array | None = None
    """(F, 12, 12) in the order r (N), v (N), theta (P), w (P), of the body itself: the estimated centre of
    mass and axes are exact marks on it, so it is finite also where they are undetermined. The marks are where
    the first frame shows them: it is the covariance of the motion since then. None: unknown"""
    disturbances: Disturbances | None = None
    """By unknown forces and torques; None: not sought, or none found"""
    hypotheses: tuple[RotationHypothesis, ...] = ()
    """Motions with other rotations between frames that fit as well, this one first; empty: there are none"""
    calibration: CalibrationPart | None = None
    """None: the calibration is exact"""
    calibration_score: CalibrationScore | None = None
    """Of the calibration as stated; None: not known"""


@dataclass(frozen=True)
class OnlineEstimate:
    """The causal estimate, one row per frame, from the frames up to it. G is fixed at the first frame, and
    again where the motion was lost.

    Undetermined quantities have finite values and a variance of inf. The states are those of
    ``MotionEstimate``.
    """

    timestamps_ns: Ints
    """(F,)"""
    r_N: Array
    """(F, 3) [m]"""
    v_N: Array
    """(F, 3) [m/s]"""
    R_NP: Array
    """(F, 3, 3)"""
    w_P: Array
    """(F, 3) [rad/s]"""
    covariance: Array
    """(F, 12, 12) in the order r (N), v (N), theta (P), w (P)"""
    X_NG: Array
    """(F, 4, 4)"""
    k: Array
    """(F, 2) k1, k2"""
    cov_k: Array
    """(F, 2, 2)"""
    com_G: Array
    """(F, 3) [m]"""
    cov_com_G: Array
    """(F, 3, 3) [m^2]"""
    R_GP: Array
    """(F, 3, 3)"""
    cov_R_GP: Array
    """(F, 3, 3) [rad^2], about the axes of P"""
    determined: Bools
    """(F, 4) whether k1, k2, com and axes are"""
    frame: Ints
    """(F,) how often the motion had been lost before: rows of one number are in one frame G"""


@dataclass(frozen=True)
class Prediction:
    """States at T instants, with two covariances (T, 12, 12) of r (N), v (N), theta (P), w (P)."""

    time_s: Array
    """(T,) since the last state"""
    r_N: Array
    v_N: Array
    R_NP: Array
    w_P: Array
    covariance: Array
    """of the centre of mass and the principal axes: large where those are poorly known"""
    covariance_of_marks: Array
    """of the body: the estimated centre of mass and axes are exact marks on it"""
    sigma_parts: Array
    """(T, 3, 12) standard deviations in ``covariance`` by the last state, by what the uncertain inertia adds,
    and by disturbances"""
    region_sigmas: Array
    """(T, 4) standard deviations that the regions of r, v, theta and w extend which hold 99 %: the root of
    e^T C^-1 e there, e an error of three components and C its block of ``covariance``, or of
    ``covariance_of_marks``. 3.37 where errors are normally distributed"""
