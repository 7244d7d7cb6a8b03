"""From guesses to a motion with its noise: hypotheses, pruning, pushes known and unknown, disturbances."""

from dataclasses import dataclass, replace

from backend.ambiguity import Choice, choose
from backend.attach import attach_wrench
from backend.iterate import Iterate
from backend.noise import NoiseScales
from backend.problem import MotionData
from backend.process_level import estimate_process_noise
from backend.prune import Kept, settle
from backend.trials import Start, Trial, try_hypotheses
from backend.unknown_pushes import find_pushes
from polhode.config.backend import Backend
from polhode.progress import Advance

SEARCHES = 3
"""For unknown pushes: with the strong ones freed the disturbances are weaker, and weak ones show."""


@dataclass(frozen=True)
class Fit:
    """A motion near the optimum, and the problem with its noise as it was told from the data."""

    data: MotionData
    kept: Kept
    iterate: Iterate
    """Of the whole data"""
    scales: NoiseScales
    trials: dict[str, Trial]
    """Of the hypotheses, by name"""
    choice: Choice
    """Among them"""
    wrench_runner_up: dict[str, float]
    """Cost of the other directions of a known torque's axes, by name"""


def fit(data: MotionData, starts: list[Start], config: Backend, advance: Advance) -> Fit:
    """Fit; where free motion is contradicted by pushes, again with nodes for them.

    Raises RunFailure when no guess leads to a motion that most observations agree with.
    """
    found = _fit(data, starts, config, advance)
    for _ in range(SEARCHES if config.unknown_wrench == "found" else 0):
        small = found.kept.restrict(found.iterate)
        pushes = find_pushes(found.kept.data, small, data.node_sigma, config.process_noise == "given")
        if pushes is None:
            break
        with_nodes = replace(data, nodes=pushes.nodes, node_sigma=pushes.sigma)
        found = _fit(with_nodes, starts, config, lambda: None)
    return found


def _fit(data: MotionData, starts: list[Start], config: Backend, advance: Advance) -> Fit:
    trials = try_hypotheses(data, starts, advance)
    choice = choose(trials, data.dt_s)
    data, kept, iterate, scales = settle(data, trials[choice.name].iterate)
    advance()
    runner_up: dict[str, float] = {}
    if data.impulses is not None and data.impulses.acting.any():
        attached = attach_wrench(kept.data, kept.restrict(iterate))
        iterate, runner_up = kept.expand(attached.iterate, iterate), attached.runner_up
    if config.process_noise == "estimated":
        level = estimate_process_noise(kept.data, kept.restrict(iterate))
        iterate, kept = kept.expand(level.iterate, iterate), replace(kept, data=level.data)
        data = replace(data, accel_psd=level.data.accel_psd, torque_psd=level.data.torque_psd)
    advance()
    return Fit(data, kept, iterate, scales, trials, choice, runner_up)
