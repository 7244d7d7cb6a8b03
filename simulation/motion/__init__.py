"""Motion of target and inspector over time: the truth of a sequence."""

from polhode.simulation.motion.inspector import InspectorMotion, inspector_motion, reported_inspector
from polhode.simulation.motion.mass import MassDistribution, mass_distribution, principal_axes
from polhode.simulation.motion.target import TargetMotion, target_motion, timestamps
from polhode.simulation.motion.wrench import known_wrench

__all__ = [
    "InspectorMotion",
    "MassDistribution",
    "TargetMotion",
    "inspector_motion",
    "known_wrench",
    "mass_distribution",
    "principal_axes",
    "reported_inspector",
    "target_motion",
    "timestamps",
]
