"""What ``polhode train`` learns, from what, and for how long."""

from typing import Literal

from polhode.config.section import Section
from polhode.config.train.corpus import Corpus
from polhode.config.train.depth import DepthTraining
from polhode.config.train.descriptor import DescriptorTraining
from polhode.config.train.schedule import Schedule

__all__ = ["Corpus", "DepthTraining", "DescriptorTraining", "Schedule", "Train"]


class Train(Section):
    """Training of one network of the front end."""

    task: Literal["descriptor", "depth"] = "descriptor"
    """Which network: the descriptor of surface patches, or the one that refines disparities."""
    output: str = "runs/train"
    """Folder of the results: checkpoint, curves, weights, scores. What was begun there goes on."""
    corpus: Corpus = Corpus()
    schedule: Schedule = Schedule()
    descriptor: DescriptorTraining = DescriptorTraining()
    depth: DepthTraining = DepthTraining()
