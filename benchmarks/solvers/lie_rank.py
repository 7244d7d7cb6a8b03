"""The Lie-derivative rank test of the thesis's chapter 3, and of the back end's problem, motion by motion.

Run: ``python -m benchmarks.solvers.lie_rank``. No data: ranks of symbolic matrices at one state of each
motion.
"""

import numpy as np

from polhode.backend.uncertainty.lie_rank import (
    System,
    evaluate,
    measured_poses,
    measured_rates,
    observability,
)

ORDERS = (1, 2, 3, 4)
BOX, DISC, BALL = (1.5, 1.2, 0.9), (1.3, 1.3, 0.8), (1.0, 1.0, 1.0)
MOTIONS = {
    "tumble of unequal moments": ((0.4, 0.5, 0.45), BOX),
    "the same, one rate passes zero": ((0.8, 0.1, 0.0), BOX),
    "axisymmetric, precessing": ((0.4, 0.1, 0.6), DISC),
    "equal moments": ((0.4, 0.1, 0.6), BALL),
    "pure spin about the least moment": ((0.0, 0.0, 0.8), BOX),
    "flat spin: about the greatest moment": ((0.8, 0.0, 0.0), BOX),
    "at rest": ((0.0, 0.0, 0.0), BOX),
}
"""w_P [rad/s] and principal moments, any scale."""


def main() -> None:
    """Print the thesis's null vector and both tables of ranks."""
    rates, poses = measured_rates(), measured_poses()
    state = np.array([0.4, 0.5, 0.45, *BOX])
    found = observability(evaluate(rates.observability_matrix(1), state))
    null = found.null_space[:, 0] / found.null_space[-1, 0]
    print("Rates along the principal axes are measured (thesis 3.8-3.15); x = (w, Jxx, Jyy, Jzz)")
    print(f"[grad L^0 h; grad L^1 h]: rank {found.rank} of {len(state)}, null vector {np.round(null, 6)}")
    print(f"the inertia itself over Jzz: {np.round(state[3:] / state[5], 6)}: only its scale is hidden\n")
    table(rates, {name: np.array([*w, *J]) for name, (w, J) in MOTIONS.items()})
    print("\nPoses of G are measured, centre of mass and axes are unknown: x = (r, v, q, w, com, J)\n")
    table(poses, {name: pose_state(w, J) for name, (w, J) in MOTIONS.items()})


def pose_state(w: tuple[float, float, float], moments: tuple[float, float, float]) -> np.ndarray:
    """A state (22,) of ``measured_poses`` with its principal axes along G."""
    motion = [0.1, 0.2, 0.6, 0.01, 0.02, -0.01]
    return np.array([*motion, 0.5, 0.5, -0.5, 0.5, *w, 0.01, 0.02, -0.03, *moments, 0.0, 0.0, 0.0])


def table(system: System, states: dict[str, np.ndarray]) -> None:
    """Ranks by the highest order of derivatives, and what stays hidden: components with a share in it."""
    print("| motion | " + " | ".join(f"up to L^{order}" for order in ORDERS) + " | hidden |")
    print("|" + "---|" * (len(ORDERS) + 2))
    functions = [system.observability_matrix(order) for order in ORDERS]
    for name, state in states.items():
        found = [observability(evaluate(function, state)) for function in functions]
        share = np.abs(found[-1].null_space).max(axis=1)
        hidden = [part for part, much in zip(system.names, share, strict=True) if much > 1e-6]
        ranks = " | ".join(str(each.rank) for each in found)
        print(f"| {name} | {ranks} | {len(state) - found[-1].rank}: {', '.join(hidden)} |")


if __name__ == "__main__":
    main()
