"""The sample of pairs that checkout examines: successive frames at places spread over the sequence."""

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from polhode.config.frontend_settings import Frontend
from polhode.frontend.background.find_masks import doubtful_frames
from polhode.frontend.features.epipolar_search import RowOffsets, row_offsets
from polhode.frontend.features.keypoints import KeyPoints, detect, no_key_points
from polhode.frontend.features.stereo import StereoFeatures, match_stereo, with_ranges
from polhode.frontend.matching.pairs import PairMatch, match_pairs
from polhode.frontend.rectification import Image, Rectifier, rectified_pair, target_crop
from polhode.geometry.lie import Array, Bools, Ints
from polhode.pipeline.checkout.image_quality import ImageQuality, RangeQuality, image_quality, range_quality
from polhode.records.dataset import StereoSequence
from polhode.records.mask_files import is_inverted
from polhode.runtime.processes import in_order
from polhode.runtime.progress import Progress

PLACES = 10
"""In the sequence; at each one two successive pairs are examined."""
MAX_STEP = 1.5
"""Of the usual interval, for two frames to be successive."""
MIN_ROWS, LEVELLED_PX = 12, 0.3
"""With so many matches whose rows differ by more, they are levelled before stereo matching, so that the other
checks still work."""


@dataclass(frozen=True)
class ExaminedPair:
    """What one stereo pair shows."""

    frame: int
    """Index of the pair in the sequence"""
    features: StereoFeatures
    """With the rows levelled"""
    rows: RowOffsets
    """Matches across rows, as the calibration rectifies them"""
    level_left: Array
    """(n,) mean grey level around each feature in the left image"""
    level_right: Array
    """(n,) in the right image"""
    images: tuple[ImageQuality, ...]
    """Of the left and the right camera; of the left one where range images take the place of a second one"""
    has_masks: tuple[bool, ...]
    inverted_masks: tuple[bool, ...]
    """Of the images that have one: whether it covers the border and leaves out something"""
    """Of the images"""
    ranges: RangeQuality | None = None

    @property
    def left(self) -> ImageQuality:
        """Of the left image."""
        return self.images[0]

    @property
    def right(self) -> ImageQuality | None:
        """Of the right image, if there is one."""
        return self.images[1] if len(self.images) > 1 else None


@dataclass(frozen=True)
class Sample:
    """The examined pairs of a sequence."""

    pairs: tuple[ExaminedPair, ...]
    """In order of time"""
    successive: Ints
    """(m, 2) indices into ``pairs`` of those that follow each other in the sequence"""
    links: tuple[PairMatch | None, ...]
    """(m,) the motion between these; None: they do not match"""
    surroundings: bool = False
    """Whether dim surroundings are left out of the target's masks"""
    doubtful_masks: tuple[int, int] | None = None
    """Number of pairs whose found masks are doubtful, and of all with such masks; None: there are none"""

    @property
    def has_ranges(self) -> bool:
        """Whether range images take the place of the right ones."""
        return any(pair.ranges is not None for pair in self.pairs)

    @property
    def noun(self) -> str:
        """What the examined frames are called."""
        return "images" if self.has_ranges else "pairs"


def places(timestamps_ns: Ints, count: int = PLACES) -> Ints:
    """Indices of frames: ``count`` pairs of successive ones, spread evenly, or all frames if there are few.

    Frames on both sides of a gap are not successive, where the sequence (F,) has others.
    """
    frames = len(timestamps_ns)
    if frames <= 2 * count:
        return np.arange(frames, dtype=np.int64)
    step = np.diff(timestamps_ns)
    first = np.flatnonzero(step <= MAX_STEP * np.median(step)).astype(np.int64)
    first = first[np.round(np.linspace(0, len(first) - 1, count)).astype(np.int64)]
    return np.unique(np.concatenate([first, first + 1]))


def take_sample(
    sequence: StereoSequence, rectifier: Rectifier, frames: Ints, workers: int, progress: Progress
) -> Sample:
    """Examine the pairs of these indices, and match those that are successive."""
    pairs, look = [], partial(examine, sequence, rectifier)
    with progress.stage("pairs", len(frames)) as advance:
        for pair in in_order(look, frames.tolist(), workers, (__name__,)):
            pairs.append(pair)
            advance()
    step, usual = np.diff(sequence.timestamps_ns[frames]), np.median(np.diff(sequence.timestamps_ns))
    first = np.flatnonzero((np.diff(frames) == 1) & (step <= MAX_STEP * usual)).astype(np.int64)
    successive = np.stack([first, first + 1], axis=1)
    features = [pair.features for pair in pairs]
    partners = [successive[successive[:, 0] == k, 1] for k in range(len(pairs))]
    matches = match_pairs(features, partners, rectifier.rig, Frontend(), 0, 1, lambda: None)
    known = {(match.i, match.j): match for match in matches}
    links = tuple(known.get((int(i), int(j))) for i, j in successive)
    found = rectifier.found
    doubtful = None if found is None else (len(doubtful_frames(found)), len(found.quality))
    return Sample(tuple(pairs), successive, links, rectifier.surroundings, doubtful)


def examine(sequence: StereoSequence, rectifier: Rectifier, k: int) -> ExaminedPair:
    """Measure pair k."""
    raw, pair, rig = sequence.read_pair(k), rectified_pair(sequence, rectifier, k), rectifier.rig

    def quality(side: int, image: Image, given: Bools | None) -> ImageQuality:
        """Of an image as recorded or, where its mask was found, as rectified."""
        mask = rectifier.found.mask(k, side) if rectifier.found is not None and given is None else None
        if mask is not None:
            return image_quality(rectifier(image, side), mask)
        return image_quality(image, given, rectifier.surroundings)

    def key_points(image: Image, mask: Bools) -> KeyPoints:
        crop = target_crop(mask)
        return no_key_points() if crop is None else detect(image, mask, crop, Frontend().features)

    left, of_left = key_points(pair.left, pair.mask_left), quality(0, raw.left, raw.mask_left)
    if pair.measured is not None:
        features = with_ranges(pair.measured, left, rig)
        return ExaminedPair(
            frame=k,
            features=features,
            rows=RowOffsets(np.zeros((0, 2)), np.zeros(0), np.zeros(0)),
            level_left=_levels(pair.left, features.uvd_px[:, :2]),
            level_right=np.zeros(len(features)),
            images=(of_left,),
            has_masks=(raw.mask_left is not None,),
            inverted_masks=_inverted(raw.mask_left),
            ranges=range_quality(pair.measured, pair.mask_left),
        )
    right = key_points(pair.right, pair.mask_right)
    rows = row_offsets(left, right, rig.width_px, rig.focal_px * np.deg2rad(1.0))
    image, right = _level_rows(pair.right, right, rows)
    features, _ = match_stereo(pair.left, image, left, right, rig)
    uv, d = features.uvd_px[:, :2], features.uvd_px[:, 2]
    return ExaminedPair(
        frame=k,
        features=replace(features, rows=None),
        rows=rows,
        level_left=_levels(pair.left, uv),
        level_right=_levels(image, uv - np.column_stack([d, np.zeros(len(d))])),
        images=(of_left, quality(1, raw.right, raw.mask_right)),
        has_masks=(raw.mask_left is not None, raw.mask_right is not None),
        inverted_masks=_inverted(raw.mask_left, raw.mask_right),
    )


def _level_rows(image: Image, points: KeyPoints, rows: RowOffsets) -> tuple[Image, KeyPoints]:
    """The right image and its key points, moved so that their rows are those of the left image."""
    if len(rows.offset_px) < MIN_ROWS:
        return image, points
    # by least squares, repeated without outliers
    u, y = rows.uv_px[:, 0] - rows.disparity_px, rows.offset_px
    line, A = np.array([0.0, float(np.median(y))]), np.column_stack([u, np.ones(len(u))])
    for _ in range(4):
        residual = np.abs(y - A @ line)
        good = residual <= 3.0 * max(1.4826 * float(np.median(residual)), 0.05)
        if np.ptp(u[good]) < MIN_ROWS:
            break
        line = np.linalg.lstsq(A[good], y[good])[0]
    slope, offset = map(float, line)
    if np.abs(slope * u + offset).max() < LEVELLED_PX:
        return image, points
    # the row that shows what belongs into row v is v - offset - slope u
    M = np.array([[1.0, 0.0, 0.0], [-slope, 1.0, -offset]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = np.asarray(cv2.warpAffine(image, M, image.shape[::-1], flags=flags), dtype=np.uint8)
    uv = points.uv_px + np.column_stack([np.zeros(len(points)), slope * points.uv_px[:, 0] + offset])
    return moved, replace(points, uv_px=uv)


def _levels(image: Image, uv_px: Array) -> Array:
    """Mean grey level (n,) of the windows of 7 pixels around points (n, 2)."""
    mean, (height, width) = cv2.blur(image.astype(np.float32), (7, 7)), image.shape
    at = np.clip(np.round(uv_px).astype(np.int64), 0, [width - 1, height - 1])
    return np.asarray(mean[at[:, 1], at[:, 0]], dtype=np.float64)


def _inverted(*masks: Bools | None) -> tuple[bool, ...]:
    return tuple(is_inverted(mask) for mask in masks if mask is not None)
