"""RootSIFT in both images of a pair, matched along the rows: the classical method."""

from polhode.camera import RectifiedRig
from polhode.config.frontend import Frontend
from polhode.frontend.features.keypoints import detect, no_key_points
from polhode.frontend.features.stereo import StereoFeatures, match_stereo
from polhode.frontend.rectification.rectified_pair import RectifiedPair
from polhode.frontend.rectification.target import target_crop


class RootSift:
    """``frontend.features.detect`` left and right, ``frontend.stereo.match_stereo`` between them."""

    def __init__(self, config: Frontend) -> None:
        self._config = config

    def __call__(self, pair: RectifiedPair, rig: RectifiedRig) -> StereoFeatures:
        """Stereo measurements of one rectified pair; none when the target is out of sight."""
        crops = (target_crop(pair.mask_left), target_crop(pair.mask_right))
        points = [
            detect(image, mask, crop, self._config.features) if crop is not None else no_key_points()
            for image, mask, crop in zip(
                (pair.left, pair.right), (pair.mask_left, pair.mask_right), crops, strict=True
            )
        ]
        return match_stereo(pair.left, pair.right, points[0], points[1], rig, self._config.stereo)
