"""Whether the masks that were found before a background that is not dark can be trusted."""

from polhode.frontend.background.find_masks import doubtful_frames
from polhode.frontend.found_masks import FoundMasks
from polhode.pipeline.found_background import doubts_of_masks
from polhode.pipeline.run_directory.summary_schema import Check

MAX_DOUBTFUL = 20.0
"""Share of the pairs [%]: with fewer, the robust steps after them cope."""


def mask_checks(found: FoundMasks | None) -> list[Check]:
    """One check; none where no masks had to be found."""
    if found is None:
        return []
    check = Check(name="pairs whose masks, found in the images, are doubtful", limit=MAX_DOUBTFUL, unit="%")
    share = len(doubtful_frames(found)) / max(len(found.quality), 1)
    return [check.judged(100.0 * share, doubts_of_masks(found))]
