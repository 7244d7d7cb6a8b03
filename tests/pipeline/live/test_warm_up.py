"""Before the first pair comes, extraction, matching and window have done all that they do later."""

import numpy as np

from polhode.config import Config
from polhode.geometry.camera import RectifiedRig
from polhode.pipeline.live.warm_up import STEP_PX, warm_up_stream


def test_the_made_up_pairs_match_as_real_ones_do() -> None:
    offset_px = -12.5
    rig = RectifiedRig(467.0, 320.0, 240.0, 0.09, 640, 480, offset_px)
    match = warm_up_stream(rig, Config())
    assert match is not None and len(match.features) > 30
    # a square that faces the cameras, moved to the right
    expected_m = -STEP_PX * rig.baseline_m / (30 + round(offset_px) - offset_px)
    assert abs(match.X_RiRj[0, 3] - expected_m) < 0.2 * abs(expected_m)
    np.testing.assert_allclose(match.X_RiRj[:3, :3], np.eye(3), atol=5e-3)
    # a small image is no obstacle
    warm_up_stream(RectifiedRig(80.0, 31.5, 23.5, 0.1, 64, 48), Config())
