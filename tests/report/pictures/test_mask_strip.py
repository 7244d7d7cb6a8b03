"""The picture of found masks: which frames it shows, and where the outline is."""

import numpy as np

from polhode.report.pictures.mask_strip import DOUBTFUL_BGR, OUTLINE_BGR, draw_outline, frames_to_show


def test_frames_are_spread_over_the_sequence_and_doubtful_ones_are_shown() -> None:
    assert frames_to_show(list(range(5)), set()) == [0, 1, 2, 3, 4]
    spread = frames_to_show(list(range(71)), set())
    assert (len(spread), spread[0], spread[-1]) == (8, 0, 70)
    shown = frames_to_show(list(range(71)), {13, 14})
    assert len(shown) == 8 and {13, 14} <= set(shown)
    crowded = frames_to_show(list(range(71)), set(range(20, 60)))
    assert len(crowded) == 8 and crowded[0] == 0 and crowded[-1] == 70


def test_the_outline_runs_along_the_edge_of_the_mask() -> None:
    image = np.full((240, 320), 100, dtype=np.uint8)
    mask = np.zeros((240, 320), dtype=bool)
    mask[80:160, 100:200] = True
    for doubtful, colour in ((False, OUTLINE_BGR), (True, DOUBTFUL_BGR)):
        tile = draw_outline(image, mask, "frame 3", doubtful)
        assert tile.shape == (240, 320, 3)
        np.testing.assert_allclose(tile[120, 100], colour, atol=3)
        assert tile[120, 150].tolist() == [100] * 3
        assert tile[200, 150].tolist() == [55] * 3
