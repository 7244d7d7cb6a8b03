"""Pairs by time: offsets are found and removed, tolerances hold, nothing is paired twice."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polhode.records.pairing import offset_in_words, pair_by_time, time_in_words

STEP_NS = 500_000_000
LEFT = 1_600_000_000_000_000_000 + STEP_NS * np.arange(20, dtype=np.int64)


@pytest.mark.parametrize("offset_ns", [0, 4_000, -4_000, 200_000_000, -220_000_000])
def test_a_constant_offset_is_found_and_every_frame_paired(offset_ns: int) -> None:
    pairing = pair_by_time(LEFT, LEFT + offset_ns)
    assert pairing.offset_ns == offset_ns
    np.testing.assert_array_equal(pairing.left, np.arange(20))
    np.testing.assert_array_equal(pairing.right, np.arange(20))


@given(
    st.sets(st.integers(0, 19), max_size=12),
    st.sets(st.integers(0, 19), max_size=6),
    st.integers(-200_000_000, 200_000_000),
    st.integers(0, 2**32),
)
def test_lost_frames_and_jitter_never_pair_what_does_not_belong_together(
    no_left: set[int], no_right: set[int], offset_ns: int, seed: int
) -> None:
    jitter = np.random.default_rng(seed).integers(-1_000_000, 1_000_001, 20)
    left = np.array([k for k in range(20) if k not in no_left])
    right = np.array([k for k in range(20) if k not in no_right])
    pairing = pair_by_time(LEFT[left], (LEFT + offset_ns + jitter)[right])
    np.testing.assert_array_equal(left[pairing.left], right[pairing.right])
    both = len(set(left.tolist()) & set(right.tolist()))
    assert both - len(pairing.left) <= (0 if both > 0.5 * max(len(left), len(right)) else both)


def test_tolerances_given_offsets_single_frames_and_none() -> None:
    right = LEFT.copy()
    right[7] += 6_000_000
    pairing = pair_by_time(LEFT, right)
    assert pairing.tolerance_ns == 5_000_000 and 7 not in pairing.left and len(pairing.left) == 19
    assert pairing.nearest_ns[7] == 6_000_000
    assert len(pair_by_time(LEFT, right, tolerance_ns=6_000_000).left) == 20
    pairing = pair_by_time(LEFT, LEFT + 3 * STEP_NS, offset_ns=3 * STEP_NS)
    np.testing.assert_array_equal(pairing.left, pairing.right)
    assert len(pairing.left) == 20
    shifted = pair_by_time(LEFT, LEFT + 3 * STEP_NS)
    assert shifted.offset_ns == 0 and len(shifted.left) == 17
    assert len(pair_by_time(LEFT[:1], LEFT[:1]).left) == 1
    assert len(pair_by_time(LEFT[:1], LEFT[:1] + 5).left) == 0
    assert len(pair_by_time(LEFT[:0], LEFT).left) == len(pair_by_time(LEFT, LEFT[:0]).left) == 0


def test_times_and_offsets_in_words() -> None:
    times = {4_000: "4 us", -12_500_000: "12.5 ms", 2e8: "0.2 s", 20: "20 ns", 3e10: "30 s"}
    assert {time_ns: time_in_words(time_ns) for time_ns in times} == times
    text = "the stamps of cam1 are 0.2 s (0.4 frames) before those of cam0"
    assert offset_in_words(-200_000_000, STEP_NS) == text
