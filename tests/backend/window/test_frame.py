"""Slots are reused, and grow only with what is seen at the same time."""

import numpy as np

from polhode.backend.window.frame import FIRST_SLOTS, LandmarkSlots


def test_forgotten_landmarks_make_room_for_new_ones() -> None:
    marks = LandmarkSlots()
    for n in range(10):
        names = np.arange(1000 * n, 1000 * n + 900)
        slots = marks.take(names)
        marks.views[slots] += 1
        np.testing.assert_array_equal(marks.find(names), slots)
        marks.leave(slots)
        assert np.all(marks.find(names) == -1)
    assert len(marks) == FIRST_SLOTS and len(marks.used) == 0


def test_more_landmarks_than_slots() -> None:
    marks = LandmarkSlots()
    slots = marks.take(np.arange(3000))
    marks.views[slots] += 2
    assert len(np.unique(slots)) == 3000
    marks.leave(slots[:10])
    np.testing.assert_array_equal(marks.find(np.arange(3000)), slots)
    assert len(marks.used) == 3000
