"""Pictures for the report: what the cameras saw and what was tracked there."""

import cv2
import numpy as np

from polhode.dataset import StereoSequence
from polhode.frontend.rectification.rectified_pair import rectified_left
from polhode.frontend.rectification.rectify import Rectifier
from polhode.frontend.rectification.target import Crop, target_crop
from polhode.lie import Array
from polhode.records import MotionEstimate, StereoTracks

INLIER_BGR = (120, 220, 60)
OUTLIER_BGR = (70, 80, 240)
SIDE_PX = 360


def track_pictures(
    sequence: StereoSequence,
    rectifier: Rectifier,
    tracks: StereoTracks,
    estimate: MotionEstimate,
    count: int = 6,
) -> dict[str, bytes]:
    """Caption -> JPEG of the left image's crop with its measurements: inliers green, outliers red."""
    pictures = {}
    for k in np.unique(np.linspace(0, tracks.n_frames - 1, count).round().astype(int)).tolist():
        left, mask = rectified_left(sequence, rectifier, k)
        crop = target_crop(mask, margin_px=16) or Crop(0, 0, left.shape[1], left.shape[0])
        here = tracks.frame == k
        inlier = estimate.inlier_weight[here] > 0.5
        picture = _draw(left, crop, tracks.uvd_px[here, :2], inlier)
        seconds = float(tracks.time_s[k])
        caption = f"frame {k}, {seconds:.1f} s: {int(inlier.sum())} inliers, {int((~inlier).sum())} outliers"
        pictures[caption] = picture
    return pictures


def _draw(image: np.ndarray, crop: Crop, uv_px: Array, inlier: np.ndarray) -> bytes:
    patch = image[crop.v0 : crop.v1, crop.u0 : crop.u1]
    zoom = SIDE_PX / max(patch.shape)
    size = (round(patch.shape[1] * zoom), round(patch.shape[0] * zoom))
    canvas = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2BGR)
    places = ((uv_px - [crop.u0, crop.v0] + 0.5) * zoom).round().astype(int)
    for place, good in zip(places.tolist(), inlier.tolist(), strict=True):
        cv2.circle(canvas, place, 2, INLIER_BGR if good else OUTLIER_BGR, -1, cv2.LINE_AA)
    return cv2.imencode(".jpg", canvas, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
