"""Real photographs: the temple of docs/validation.md#photographs, where they are beside the repository."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

from polhode.config import Frontend
from polhode.files.tables import read_table
from polhode.frontend.features.stereo import RootSift, StereoFeatures
from polhode.frontend.matching.pairs import match_pairs
from polhode.frontend.rectification import Rectifier, make_rectifier, rectified_left, rectified_pair
from polhode.frontend.segmentation import has_surroundings
from polhode.geometry.lie import Array, Bools, inverse_pose, transform_points
from polhode.records.dataset import StereoSequence, open_sequence

TEMPLE = Path(__file__).parents[3] / "shared" / "data" / "photographs" / "temple"
BOX_O = np.array(list(product((-0.023121, 0.078626), (-0.038009, 0.121636), (-0.091940, -0.017395))))
"""Corners (8, 3) of the box that holds the object, in its frame [m]."""
MARGIN_PX = 12
"""Two millimetres of the object below the box, where it stands on the cloth, and the smoothing of masks."""

pytestmark = pytest.mark.skipif(
    not TEMPLE.is_dir(),
    reason="the photographs are not in the repository; see docs/validation.md#photographs",
)


@dataclass(frozen=True)
class Views:
    """The photographs with their calibrated poses."""

    sequence: StereoSequence
    rectifier: Rectifier
    X_RO: Array
    """(F, 4, 4) the object in the rectified left camera"""

    def box(self, k: int) -> Bools:
        """(H, W) where the object's box is seen."""
        rig = self.rectifier.rig
        uv = rig.project(transform_points(self.X_RO[k], BOX_O))[:, :2]
        seen = np.zeros((rig.height_px, rig.width_px), dtype=np.uint8)
        cv2.fillConvexPoly(seen, cv2.convexHull(np.round(uv).astype(np.int32)), 1)
        kernel = np.ones((2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1), dtype=np.uint8)
        return np.asarray(cv2.dilate(seen, kernel) > 0)


@cache
def views() -> Views:
    sequence = open_sequence(TEMPLE)
    rectifier = make_rectifier(sequence.calibration)
    rows = read_table(TEMPLE / "truth.csv", columns=12).values
    X_CO = np.tile(np.eye(4), (len(rows), 1, 1))
    X_CO[:, :3, :3], X_CO[:, :3, 3] = rows[:, :9].reshape(-1, 3, 3), rows[:, 9:]
    return Views(sequence, rectifier, inverse_pose(rectifier.X_CR) @ X_CO)


def test_the_cloth_is_taken_for_surroundings_and_left_out_of_the_masks() -> None:
    known = views()
    sequence, rectifier = known.sequence, known.rectifier
    frames = (0, 5, 16, 24)
    images = [rectifier(sequence.read_left(k)[0], 0) for k in frames]
    assert has_surroundings(images, rectifier.borders[0])
    for k in frames:
        _, with_cloth = rectified_left(sequence, rectifier, k)
        _, mask = rectified_left(sequence, replace(rectifier, surroundings=True), k)
        inside = known.box(k)
        assert with_cloth[inside].mean() > mask[inside].mean() > 0.4
        assert (mask & ~inside).sum() / mask.sum() < 0.005
        assert (with_cloth & ~inside).sum() / with_cloth.sum() > 0.1


def test_points_move_between_two_photographs_as_the_calibration_says() -> None:
    known = views()
    rectifier = replace(known.rectifier, surroundings=True)
    # nearest neighbours, as for RootSIFT by default
    config, frames = Frontend(), (16, 17)
    method = RootSift(config)
    features: list[StereoFeatures] = [
        method(rectified_pair(known.sequence, rectifier, k), rectifier.rig) for k in frames
    ]
    assert min(map(len, features)) > 300
    partners = [np.array([1]), np.zeros(0, dtype=np.int64)]
    (match,) = match_pairs(features, partners, rectifier.rig, config, 0, 1, lambda: None)
    a, b = match.features.T
    X_AB = known.X_RO[frames[0]] @ inverse_pose(known.X_RO[frames[1]])
    moved = transform_points(X_AB, features[1].p_R[b])
    assert len(a) > 100
    assert np.median(np.linalg.norm(features[0].p_R[a] - moved, axis=1)) < 1.0e-3
    found = transform_points(match.X_RiRj, features[1].p_R[b])
    assert np.median(np.linalg.norm(found - moved, axis=1)) < 0.45e-3
