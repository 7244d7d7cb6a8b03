"""Masks for a sequence whose background is not dark and that has none, and what is doubtful about them."""

import logging
from collections.abc import Sequence
from dataclasses import replace

from polhode.frontend.background.find_masks import doubtful_frames, find_background, find_masks
from polhode.frontend.found_masks import FoundMasks
from polhode.frontend.rectification import Rectifier
from polhode.records.dataset import StereoSequence
from polhode.runtime.progress import Progress

NAMED = 3
"""Doubtful frames that a sentence names."""

_log = logging.getLogger(__name__)


def with_found_masks(
    sequence: StereoSequence, rectifier: Rectifier, frames: Sequence[int], workers: int, progress: Progress
) -> Rectifier:
    """The rectifier with the masks of these pairs, if they need any: no dark sky, and none are given."""
    background = None if rectifier.surroundings else find_background(sequence, rectifier)
    if background is None:
        return rectifier
    with progress.stage("masks of the target", len(frames)) as advance:
        found = find_masks(sequence, rectifier, background, frames, workers, advance)
    if found is None:
        _log.info("nothing stands before the background, which is %s", background.description)
        return rectifier
    _log.info("the background is not dark: what stands before it, %s, is the target", background.description)
    return replace(rectifier, found=found)


def doubts_of_masks(found: FoundMasks) -> str:
    """What is doubtful about them, a sentence; empty: nothing."""
    doubtful = doubtful_frames(found)
    if not doubtful:
        return ""
    named = ", ".join(str(k) for k in doubtful[:NAMED]) + (", ..." if len(doubtful) > NAMED else "")
    return (
        "the background is not dark, and the masks of the target that were found are doubtful in "
        f"{len(doubtful)} of {len(found.quality)} pairs (frames {named}): the two images, the stereo matches "
        "or the neighbouring frames disagree; look at pictures/masks.jpg, and give masks (masks0/ and "
        "masks1/) if they are wrong"
    )
