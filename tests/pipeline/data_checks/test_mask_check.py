"""Masks that were found: no check where there are none, a doubt that names frames where many are doubtful."""

from dataclasses import replace

from polhode.frontend.found_masks import FoundMasks, MaskQuality
from polhode.pipeline.data_checks.check_data import mask_checks
from polhode.pipeline.found_background import doubts_of_masks

GOOD = MaskQuality(area=0.1, agreement=0.98, contradicted=0.02, far_share=0.95)
BAD = replace(GOOD, agreement=0.4)


def found(bad: int) -> FoundMasks:
    return FoundMasks({}, dict(enumerate([BAD] * bad + [GOOD] * (20 - bad))))


def test_where_no_masks_were_found_there_is_no_check() -> None:
    assert mask_checks(None) == []


def test_sound_masks_hold_without_a_warning() -> None:
    (check,) = mask_checks(found(0))
    assert (check.value, check.limit, check.reason) == (0.0, 20.0, "")
    assert doubts_of_masks(found(0)) == ""


def test_a_few_doubtful_masks_are_a_warning_and_no_doubt_of_the_answer() -> None:
    (check,) = mask_checks(found(2))
    assert (check.value, check.reason) == (10.0, "")
    assert "doubtful in 2 of 20 pairs (frames 0, 1):" in doubts_of_masks(found(2))


def test_many_doubtful_masks_are_a_reason_to_doubt_the_answer() -> None:
    (check,) = mask_checks(found(5))
    assert check.value == 25.0
    assert "doubtful in 5 of 20 pairs (frames 0, 1, 2, ...):" in check.reason
    assert "give masks" in check.reason
