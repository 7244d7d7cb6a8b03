"""Stamps of both cameras: offset of the clocks, unpaired images."""

import numpy as np
import pytest

from polhode.pipeline.checkout.timing import Stamps, stamp_checks
from polhode.records import Ints

LEFT = 1_600_000_000_000_000_000 + 500_000_000 * np.arange(20, dtype=np.int64)


def verdicts(right: Ints) -> list[tuple[float | None, str]]:
    return [(check.value, check.status) for check in stamp_checks(Stamps(LEFT, right))]


def test_equal_stamps_pass() -> None:
    assert verdicts(LEFT) == [(0.0, "PASS"), (0.0, "PASS")]


@pytest.mark.parametrize(
    ("offset_ns", "microseconds", "words"),
    [(4_000, 4.0, "4 us"), (-4_000, 4.0, "before"), (200_000_000, 200_000.0, "(0.4 frames) after")],
)
def test_an_offset_of_the_clocks_is_stated(offset_ns: int, microseconds: float, words: str) -> None:
    offset, partners = stamp_checks(Stamps(LEFT, LEFT + offset_ns))
    assert (offset.value, offset.status, offset.unit) == (microseconds, "WARN", "us")
    assert words in offset.finding and partners.status == "PASS"


def test_lost_frames_are_counted() -> None:
    assert verdicts(LEFT[:-1]) == [(0.0, "PASS"), (5.0, "PASS")]
    assert verdicts(LEFT[::2]) == [(0.0, "PASS"), (50.0, "WARN")]
    assert verdicts(LEFT[::4]) == [(0.0, "PASS"), (75.0, "FAIL")]


def test_stamps_that_have_nothing_in_common_fail() -> None:
    assert verdicts(LEFT + 10**15) == [(None, "FAIL"), (100.0, "FAIL")]


def test_stamps_that_scatter_too_much_have_no_partner() -> None:
    late = np.where(np.arange(20) % 2, 100_000_000, 0)
    offset, partners = stamp_checks(Stamps(LEFT, LEFT + late))
    assert partners.value is not None and partners.value > 50.0 and partners.status != "PASS"
    assert "5 ms are allowed" in offset.finding
