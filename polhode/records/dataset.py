"""A stereo sequence on disk (docs/dataset.md), without its truth, which polhode/records/read_truth.py reads.

The second of the two cameras may be a range sensor (polhode/records/range_images.py): then the calibration
has a virtual right camera, and ``read_range`` takes the place of the right images.

Every image is decoded once when the sequence is opened, so that damage is found before the work begins.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import blake2b
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from polhode.files.foreign_files import CONFIGURATION_BYTES, MissingFile, read_text
from polhode.files.images import (
    Grey,
    Raw,
    UnreadableImage,
    bit_depth,
    has_content,
    parallel_decodes,
    read_mask,
    read_raw,
    to_grey,
)
from polhode.files.record_files import digest_of
from polhode.files.tables import (
    attitudes_of,
    numbers_at,
    read_listing,
    read_mapping,
    read_table,
    require_below,
)
from polhode.geometry.lie import Array, Bools, Ints, make_pose
from polhode.records.camera_folders import CameraFolders, find_cameras
from polhode.records.pairing import Pairing, offset_in_words, pair_by_time, time_in_words
from polhode.records.range_images import RANGE_FOLDER, RangeModel, read_range_model, why_no_ranges
from polhode.records.rig_calibration import (
    StereoCalibration,
    read_calibration,
    read_range_calibration,
    with_baseline,
)
from polhode.records.tracks import Wrench
from polhode.runtime.errors import InputError

MIN_PAIRS = 3
MAX_LOSS = 0.6
MIN_INTERVAL_S, MAX_INTERVAL_S = 1e-4, 86400.0
"""Between frames, usually: microseconds or seconds given as nanoseconds lie outside."""
LONG_GAP_S, LONG_GAP = 3600.0, 100.0
"""An interval that is longer than an hour and than so many usual ones is odd."""
PAIRS_AHEAD = 64
"""Pairs that are checked at a time when a sequence is opened."""
BORDER_SHARE, NEAR_PERCENTILE = 0.5, 5.0
"""Where more of a range image's border than this has a range, there is a background, and the usual range is
this percentile: that of a target which covers a twentieth of the image or more."""

__all__ = ["StereoCalibration", "StereoImages", "StereoSequence", "open_sequence"]


@dataclass(frozen=True)
class StereoImages:
    """One pair as recorded: neither undistorted nor rectified. Where ranges are in the place of a right
    camera, its image and mask are empty."""

    left: Grey
    """(H, W)"""
    right: Grey
    """(H, W)"""
    mask_left: Bools | None
    """(H, W), true on the target; None when the sequence has no mask for this frame"""
    mask_right: Bools | None


@dataclass(frozen=True)
class StereoSequence:
    """The usable pairs of a sequence, F of them, in order of time."""

    folder: Path
    timestamps_ns: Ints
    """(F,) strictly increasing, of the left images"""
    calibration: StereoCalibration
    X_NC: Array
    """(F, 4, 4) left camera as calibrated in N; the identity throughout when the inspector is at rest"""
    inspector_moves: bool
    sigma_camera_p_m: float
    """Standard deviation of the inspector's position [m]; 0: exact"""
    sigma_camera_theta_rad: float
    n_listed: int
    """Number of pairs, and of images without a partner, in both data.csv"""
    dropped: tuple[tuple[int, str], ...]
    """(timestamp_ns, reason) of frames that are listed but not usable"""
    warnings: tuple[str, ...]
    wrench: Wrench | None
    """Known force and torque on the target, of ``wrench0``; None when there is none"""
    repeated: Bools
    """(F,) pairs of which an image is, bit for bit, that of the pair before: a camera or recorder stood
    still. Their masks are empty, so that nothing is measured in them"""
    frozen: bool
    """Whether all pairs are the same, bit for bit; they are used, as of a target at rest"""
    _files: tuple[tuple[Path, Path], ...] = field(repr=False)
    _digests: tuple[tuple[bytes, ...], ...] = field(repr=False)
    """Of both images of each pair when the sequence was opened"""
    _right_ns: Ints
    """(F,) timestamps of the right images, which may differ by an offset and a little more"""
    _cameras: CameraFolders
    _bits: int = 8
    range_model: RangeModel | None = None
    """Of the range images in the place of a right camera; None: there are two cameras"""

    def __len__(self) -> int:
        return len(self.timestamps_ns)

    def part(self, frames: Ints) -> "StereoSequence":
        """The sequence of some of its pairs (n,), ascending."""
        chosen = frames.tolist()
        return replace(
            self,
            timestamps_ns=self.timestamps_ns[frames],
            X_NC=self.X_NC[frames],
            repeated=self.repeated[frames],
            _files=tuple(self._files[k] for k in chosen),
            _digests=tuple(self._digests[k] for k in chosen),
            _right_ns=self._right_ns[frames],
        )

    @property
    def has_ranges(self) -> bool:
        """Whether there are range images instead of a right camera."""
        return self.range_model is not None

    @property
    def second_name(self) -> str:
        """Name of the folder of the right camera, or of the range images."""
        return self._cameras.names[1]

    def read_pair(self, k: int) -> StereoImages:
        """Images and masks of pair k, 0 <= k < F, 8-bit grey. Raises InputError if the files have changed."""
        left, mask_left = self.read_left(k)
        if self.has_ranges:
            return StereoImages(left, np.zeros_like(left), mask_left, np.zeros(left.shape, dtype=np.bool_))
        return StereoImages(left, self._read_image(1, k), mask_left, self._read_mask(1, k))

    def read_range(self, k: int) -> NDArray[np.float32]:
        """Ranges (H, W) of pair k [m], NaN where there are none, of the pixels of the left image as recorded.

        Raises InputError if the files have changed; only for sequences with ``range_model``.
        """
        assert self.range_model is not None
        return self.range_model.metres(self._read_raw(1, k)).astype(np.float32)

    def read_left(self, k: int) -> tuple[Grey, Bools | None]:
        """The left image and mask of pair k alone."""
        return self._read_image(0, k), self._read_mask(0, k)

    def digest_of_pair(self, k: int) -> str:
        """Of all that is recorded in pair k and of how it is read: images or ranges, masks, depth of bits."""
        masks = [self._read_mask(camera, k) for camera in (0, *(() if self.has_ranges else (1,)))]
        return digest_of(self._digests[k], masks, self._bits, self.range_model)

    @cached_property
    def content_digest(self) -> str:
        """Of all that an estimate depends on: pairs, times, calibration, poses of the inspector, wrench."""
        pairs = [self.digest_of_pair(k) for k in range(len(self))]
        inspector = self.X_NC, self.sigma_camera_p_m, self.sigma_camera_theta_rad
        return digest_of(pairs, self.timestamps_ns, self.calibration, inspector, self.wrench)

    def left_file(self, k: int) -> Path:
        """The file of the left image of pair k."""
        return self._files[k][0]

    def _read_image(self, camera: int, k: int) -> Grey:
        return to_grey(self._read_raw(camera, k), self._bits)

    def _read_raw(self, camera: int, k: int) -> Raw:
        file = self._files[k][camera]
        try:
            raw = read_raw(file, *self.calibration.size_px(camera))
        except UnreadableImage as error:
            raise InputError(
                f"{self.folder}: pair {self.timestamps_ns[k]} ns changed while in use: {error}"
            ) from None
        if _digest(raw) != self._digests[k][camera]:
            raise InputError(f"{file}: changed while in use: leave the sequence alone, and run again")
        return raw

    def _read_mask(self, camera: int, k: int) -> Bools | None:
        width, height = self.calibration.size_px(camera)
        if self.repeated[k]:
            return np.zeros((height, width), dtype=np.bool_)
        right_ns = int(self._right_ns[k])
        path = _mask_file(self._cameras, camera, int(self.timestamps_ns[k]), right_ns)
        try:
            return read_mask(path, width, height)
        except UnreadableImage:
            # open_sequence has warned of it.
            return None


@dataclass(frozen=True)
class InspectorPoses:
    """Pose of the inspector's body B in N at each frame, and how well it is known."""

    X_NB: Array
    """(F, 4, 4)"""
    sigma_p_m: float
    sigma_theta_rad: float
    moves: bool
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Pair:
    """The files of a pair."""

    left: Path
    right: Path
    right_ns: int
    """Timestamp of the right image"""


@dataclass(frozen=True)
class _Checked:
    """Result of decoding one pair."""

    reason: str | None
    content: bool
    bright: bool
    """Whether more than half of an image is in the upper half of the range"""
    largest_16_bit: int
    bad_masks: tuple[str, ...]
    digests: tuple[bytes, ...] = ()
    """Of both images"""
    shows: tuple[bool, ...] = ()
    """Whether each has content: a black one has none"""


def open_sequence(folder: Path) -> StereoSequence:
    """Open and check a sequence.

    Unpaired and unreadable frames are dropped, listed in ``dropped`` and reported in ``warnings``. Raises
    InputError, one line, when the folder, a camera or its calibration is missing or wrong, timestamps do not
    increase, more than 60 % of the listed frames are lost, fewer than 3 pairs remain, all frames are black, a
    mask has the wrong size, no range image has a measurement, or ``inspector0`` or ``wrench0`` is wrong or
    does not cover the frames.
    """
    mav0 = _require_mav0(folder)
    cameras = find_cameras(mav0)
    ranges = read_range_model(cameras.folder(1)) if cameras.has_ranges else None
    if ranges is None:
        calibration = read_calibration(mav0, cameras.names)
    else:
        calibration = read_range_calibration(mav0, cameras.names[0])
    bits = calibration.bits
    left, right = (read_listing(cameras.folder(camera) / "data.csv") for camera in (0, 1))
    left_ns, right_ns = (np.array(list(names), dtype=np.int64) for names in (left, right))
    _require_overlap(cameras, left_ns, right_ns)
    pairing = pair_by_time(left_ns, right_ns)
    partner = dict(zip(left_ns[pairing.left].tolist(), right_ns[pairing.right].tolist(), strict=True))
    reasons = _unpaired(cameras, left_ns, right_ns, pairing)
    listed = sorted(partner.keys() | reasons.keys())
    names = {stamp: (left[stamp], right[other]) for stamp, other in partner.items()}
    reasons |= _without_files(cameras, names)
    # Images are decoded only while enough frames can remain.
    _require_enough(folder, reasons, len(listed))
    paired = [stamp for stamp in listed if stamp not in reasons]
    files = {
        stamp: _Pair(
            cameras.folder(0) / "data" / left[stamp],
            cameras.folder(1) / "data" / right[partner[stamp]],
            partner[stamp],
        )
        for stamp in paired
    }
    checked: dict[int, _Checked] = {}
    for stamp, check in zip(paired, _check_pairs(cameras, files, calibration, bits), strict=True):
        checked[stamp] = check
        if check.reason is not None:
            reasons[stamp] = check.reason
            _require_enough(folder, reasons, len(listed), unchecked=len(paired) - len(checked))
    usable = [stamp for stamp in paired if stamp not in reasons]
    dropped = tuple(sorted(reasons.items()))
    if not any(checked[stamp].content for stamp in usable):
        if any(checked[stamp].bright for stamp in usable):
            raise InputError(
                f"{folder}: all frames are saturated or uniformly bright; check exposure and gain"
            )
        message = "all frames are black: no image shows anything above the noise"
        raise InputError(f"{folder}: {message}; check exposure and lens cap")
    measured = [k for k, stamp in enumerate(usable) if checked[stamp].shows[1]]
    if ranges is not None and not measured:
        raise InputError(
            f"{cameras.folder(1)}: no image has a measurement, all pixels are 0; record the ranges again"
        )
    of_cameras = _repeated([checked[stamp] for stamp in usable])
    frozen = bool(of_cameras[1:].all())
    repeated = np.asarray(of_cameras.any(axis=1)) & (not frozen)
    still = np.flatnonzero(of_cameras[1:].all(axis=0))
    if len(still) and not frozen:
        raise InputError(
            f"{cameras.folder(int(still[0]))}: all images are the same, bit for bit: the camera or the "
            "recorder stood still; record the sequence again"
        )
    timestamps_ns = np.array(usable, dtype=np.int64)
    folder_of_poses, folder_of_wrench = mav0 / "inspector0", mav0 / "wrench0"
    inspector = read_inspector(folder_of_poses, timestamps_ns) if folder_of_poses.is_dir() else None
    # Without inspector0, N is the left camera itself.
    X_NC = inspector.X_NB @ calibration.X_BC0 if inspector else np.tile(np.eye(4), (len(usable), 1, 1))
    bad_masks = [bad for stamp in usable for bad in checked[stamp].bad_masks]
    bits = bits or bit_depth(max(checked[stamp].largest_16_bit for stamp in usable))
    sequence = StereoSequence(
        folder=folder,
        timestamps_ns=timestamps_ns,
        calibration=calibration,
        X_NC=np.asarray(X_NC),
        inspector_moves=inspector is not None and inspector.moves,
        sigma_camera_p_m=inspector.sigma_p_m if inspector else 0.0,
        sigma_camera_theta_rad=inspector.sigma_theta_rad if inspector else 0.0,
        n_listed=len(listed),
        dropped=dropped,
        warnings=(
            *_unused_ranges(cameras),
            *_offset_warning(cameras, pairing),
            *_warnings(dropped, len(listed), bad_masks, inspector),
            *_odd_times(timestamps_ns),
            *_repeats(timestamps_ns, repeated),
        ),
        wrench=read_wrench(folder_of_wrench, timestamps_ns) if folder_of_wrench.is_dir() else None,
        repeated=repeated,
        frozen=frozen,
        _files=tuple((files[stamp].left, files[stamp].right) for stamp in usable),
        _digests=tuple(checked[stamp].digests for stamp in usable),
        _cameras=cameras,
        _right_ns=np.array([files[stamp].right_ns for stamp in usable], dtype=np.int64),
        _bits=bits,
        range_model=ranges,
    )
    return sequence if ranges is None else _with_virtual_camera(sequence, ranges, measured)


def _with_virtual_camera(sequence: StereoSequence, model: RangeModel, measured: list[int]) -> StereoSequence:
    """The sequence with the virtual right camera where the noise of the ranges asks for it.

    measured: pairs whose range image has a measurement.
    """
    usual = []
    for index in np.unique(np.linspace(0, len(measured) - 1, 24).round().astype(int)).tolist():
        mask = sequence._read_mask(0, measured[index])
        here_m = _usual_range(sequence.read_range(measured[index]), mask)
        if np.isfinite(here_m):
            usual.append(here_m)
    if not usual:
        raise InputError(
            f"{sequence.folder / 'mav0' / RANGE_FOLDER}: no pixel of the target, as the masks give it, has a "
            "measurement; masks and ranges must be of the same pixels"
        )
    calibration = sequence.calibration
    focal_px = float(np.mean(calibration.K0[[0, 1], [0, 1]]))
    baseline_m = model.virtual_baseline_m(focal_px, float(np.median(usual)))
    return replace(sequence, calibration=with_baseline(calibration, baseline_m))


def _usual_range(range_m: NDArray[np.float32], mask: Bools | None) -> float:
    """That of the target in a range image (H, W) [m], roughly; NaN: it has none.

    Without a mask, what lies along the border is a background, and the target is nearer.
    """
    on_target = range_m if mask is None else range_m[mask]
    known = on_target[np.isfinite(on_target)]
    if len(known) == 0:
        return float("nan")
    border = np.concatenate([range_m[0], range_m[-1], range_m[:, 0], range_m[:, -1]])
    has_background = mask is None and np.isfinite(border).mean() > BORDER_SHARE
    return float(np.percentile(known, NEAR_PERCENTILE if has_background else 50.0))


def _unused_ranges(cameras: CameraFolders) -> Iterator[str]:
    if not cameras.has_ranges and (cameras.mav0 / RANGE_FOLDER).is_dir():
        yield (
            f"{cameras.mav0 / RANGE_FOLDER} is not used, since there are two cameras; to use the ranges, "
            f"take {cameras.names[1]} out of {cameras.mav0}"
        )


def _require_mav0(folder: Path) -> Path:
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not a folder: give the folder that contains mav0/ (see docs/dataset.md)"
        )
    mav0 = folder / "mav0"
    if not mav0.exists() and (folder / "cam0").is_dir():
        raise InputError(f"{folder} is the folder mav0 itself: give the folder that contains it")
    return mav0


def _require_overlap(cameras: CameraFolders, left_ns: Ints, right_ns: Ints) -> None:
    """Raise InputError for two recordings that have no time in common."""
    gap_ns = max(int(right_ns[0] - left_ns[-1]), int(left_ns[0] - right_ns[-1]))
    if gap_ns > 0 and min(len(left_ns), len(right_ns)) > 1:
        first, second = cameras.names
        late, early = (second, first) if right_ns[0] > left_ns[-1] else (first, second)
        raise InputError(
            f"{cameras.mav0}: the images of {first} and {second} have no time in common: {late} begins "
            f"{time_in_words(gap_ns)} after {early} ends; give both the stamps of one clock"
        )


def _unpaired(cameras: CameraFolders, left_ns: Ints, right_ns: Ints, pairing: Pairing) -> dict[int, str]:
    """Timestamp [ns] -> reason, of the images that have no partner."""
    first, second = cameras.names
    lone = np.delete(np.arange(len(right_ns)), pairing.right)
    # in the left clock, where none can be the stamp of a pair
    reasons = {int(stamp): f"only in {second}" for stamp in right_ns[lone] - pairing.offset_ns}
    lone = np.delete(np.arange(len(left_ns)), pairing.left)
    for stamp, off_ns in zip(left_ns[lone], pairing.nearest_ns[lone], strict=True):
        reasons[int(stamp)] = f"only in {first}"
        if 2 * abs(off_ns) < pairing.interval_ns:
            beyond = " beyond the usual offset" if pairing.offset_ns else ""
            reasons[int(stamp)] = (
                f"only in {first}: the nearest image of {second} is {time_in_words(off_ns)} away{beyond}, "
                f"{time_in_words(pairing.tolerance_ns)} are allowed; polhode import --tolerance-s allows more"
            )
    return reasons


def _offset_warning(cameras: CameraFolders, pairing: Pairing) -> Iterator[str]:
    """The constant offset between the stamps of the two cameras."""
    first, second = cameras.names
    if pairing.offset_ns:
        offset = offset_in_words(pairing.offset_ns, pairing.interval_ns, second, first)
        yield (
            f"{offset}: taken for an offset of the clocks; pairs have the stamps of {first}; if the cameras "
            "were not triggered together, depth and motion are wrong"
        )


def _without_files(cameras: CameraFolders, names: dict[int, tuple[str, str]]) -> dict[int, str]:
    """Timestamp [ns] -> reason, of the pairs that lack one of the two images."""
    reasons: dict[int, str] = {}
    for index, camera in enumerate(cameras.names):
        data = cameras.folder(index) / "data"
        present = _names_in(data)
        for stamp, pair in names.items():
            # A name with a folder is looked up by itself.
            if (
                stamp not in reasons
                and pair[index] not in present
                and ("/" not in pair[index] or not (data / pair[index]).exists())
            ):
                reasons[stamp] = f"{camera} image: file missing"
    return reasons


def _names_in(folder: Path) -> set[str]:
    """Names of the files in a folder; none when it cannot be read."""
    try:
        return {entry.name for entry in os.scandir(folder)}
    except OSError:
        return set()


def _check_pairs(
    cameras: CameraFolders, files: dict[int, _Pair], calibration: StereoCalibration, bits: int | None
) -> Iterator[_Checked]:
    """What is found out about each pair, in order; never more than a few are decoded ahead."""
    rest = iter(files.items())
    at_once = min(parallel_decodes(*calibration.size_px(camera)) for camera in (0, 1))
    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, 16, at_once)) as pool:
        while some := list(islice(rest, PAIRS_AHEAD)):
            yield from pool.map(lambda each: _check_pair(cameras, each[0], each[1], calibration, bits), some)


def _check_pair(
    cameras: CameraFolders, stamp: int, pair: _Pair, calibration: StereoCalibration, bits: int | None
) -> _Checked:
    bright, largest, digests, shows = False, 0, [], []
    for camera, path in enumerate((pair.left, pair.right)):
        try:
            raw = read_raw(path, *calibration.size_px(camera))
        except UnreadableImage as error:
            return _Checked(f"{cameras.names[camera]} image: {error}", False, False, 0, ())
        if camera == 1 and cameras.has_ranges:
            if wrong := why_no_ranges(raw):
                return _Checked(f"{cameras.names[camera]} image: {wrong}", False, False, 0, ())
            shows.append(bool(raw.any()))
            digests.append(_digest(raw))
            continue
        if raw.dtype == np.uint16:
            largest = max(largest, int(raw.max()))
            if bits is not None and largest >= 2**bits:
                raise InputError(
                    f"{path}: value {largest} is above {bits} bits: correct 'bits' in sensor.yaml"
                )
        grey = to_grey(raw, bits or bit_depth(int(raw.max())))
        shows.append(has_content(grey))
        bright = bright or bool(np.median(grey) > 127)
        digests.append(_digest(raw))
    bad_masks = tuple(_bad_masks(cameras, stamp, pair.right_ns, calibration))
    content = shows[0] if cameras.has_ranges else any(shows)
    return _Checked(None, content, bright, largest, bad_masks, tuple(digests), tuple(shows))


def _digest(image: NDArray[Any]) -> bytes:
    return blake2b(image.tobytes(), digest_size=16).digest()


def _mask_file(cameras: CameraFolders, camera: int, stamp: int, right_ns: int) -> Path:
    """A mask has the timestamp of its pair; one of the right camera may have that of its image."""
    folder = cameras.masks(camera)
    path = folder / f"{stamp}.png"
    if camera == 1 and right_ns != stamp and not path.exists():
        return folder / f"{right_ns}.png"
    return path


def _bad_masks(
    cameras: CameraFolders, stamp: int, right_ns: int, calibration: StereoCalibration
) -> Iterator[str]:
    for camera in (0,) if cameras.has_ranges else (0, 1):
        path = _mask_file(cameras, camera, stamp, right_ns)
        if not path.parent.is_dir():
            continue
        try:
            read_mask(path, *calibration.size_px(camera))
        except UnreadableImage as error:
            if "wrong size" in str(error):
                raise InputError(f"{path}: {error}; masks must have the size of the images") from None
            yield f"{path}: {error}"


def _require_enough(folder: Path, reasons: dict[int, str], n_listed: int, unchecked: int = 0) -> None:
    """Raise InputError when the frames lost so far, of which ``reasons`` tells, leave too few."""
    if not reasons:
        example = ""
    else:
        first = min(reasons)
        example = f" (first: {first} ns, {reasons[first]})"
    at_least = "at least " if unchecked else ""
    if len(reasons) > MAX_LOSS * n_listed:
        message = (
            f"{at_least}{len(reasons)} of {n_listed} frames are missing, unpaired or unreadable{example}"
        )
        raise InputError(f"{folder}: {message}; at most 60 % may be, repair the sequence")
    if n_listed - len(reasons) < MIN_PAIRS:
        message = f"{n_listed - len(reasons)} usable stereo pairs of {n_listed} frames{example}"
        raise InputError(f"{folder}: {message}; at least {MIN_PAIRS} are needed")


def _warnings(
    dropped: tuple[tuple[int, str], ...],
    n_listed: int,
    bad_masks: list[str],
    inspector: InspectorPoses | None,
) -> Iterator[str]:
    if dropped:
        stamp, reason = dropped[0]
        example = f"(first: {stamp} ns, {reason})"
        yield f"{len(dropped)} of {n_listed} frames dropped: unpaired or unreadable {example}"
    if bad_masks:
        yield f"{len(bad_masks)} masks are missing or unreadable and not used (first: {bad_masks[0]})"
    if inspector is not None:
        yield from inspector.warnings


def _repeated(checked: list[_Checked]) -> Bools:
    """(F, 2) whether each camera's image is that of the pair before: no sensor repeats its noise."""
    same = [
        [shows and a == b for shows, a, b in zip(after.shows, before.digests, after.digests, strict=True)]
        for before, after in pairwise(checked)
    ]
    return np.array([[False, False], *same], dtype=np.bool_)


def _repeats(timestamps_ns: Ints, repeated: Bools) -> Iterator[str]:
    if repeated.any():
        yield (
            f"{int(repeated.sum())} of {len(repeated)} pairs have an image of the pair before, bit for bit "
            f"(first: {timestamps_ns[repeated][0]} ns): a camera or recorder stood still; they are not used"
        )


def _odd_times(timestamps_ns: Ints) -> Iterator[str]:
    """Intervals that suggest another unit, or a stamp of another recording."""
    intervals_s = 1e-9 * np.diff(timestamps_ns)
    usual_s, longest = float(np.median(intervals_s)), int(np.argmax(intervals_s))
    if not MIN_INTERVAL_S <= usual_s <= MAX_INTERVAL_S:
        yield f"the frames are {usual_s:.3g} s apart: check that the timestamps in data.csv are nanoseconds"
    elif intervals_s[longest] > max(LONG_GAP_S, LONG_GAP * usual_s):
        yield (
            f"frame {timestamps_ns[longest + 1]} ns comes {intervals_s[longest]:.3g} s after the one before "
            f"it, where {usual_s:.3g} s is usual: check the timestamps in data.csv"
        )


def read_wrench(folder: Path, timestamps_ns: Ints) -> Wrench:
    """Read ``wrench0/data.csv``: timestamp, force_N (3) [N], torque_P (3) [N m]. A row applies until the
    next.

    Raises InputError when a row contains no numbers, timestamps do not increase, or no row is as early as the
    last frame (F,).
    """
    path = folder / "data.csv"
    table = read_table(path, columns=6)
    stamps, values = table.timestamps_ns, table.values
    require_below(table, 1e12, "a force [N] or torque [N m]")
    if stamps[0] > timestamps_ns[-1]:
        message = f"{path}: the first row, {stamps[0]} ns, is after the last frame, {timestamps_ns[-1]} ns"
        raise InputError(f"{message}; use the clock of the images, or remove wrench0/")
    return Wrench(stamps, values[:, :3], values[:, 3:])


def read_inspector(folder: Path, timestamps_ns: Ints) -> InspectorPoses:
    """Read ``inspector0`` and interpolate it to the frames (F,): linear in position, slerp in attitude.

    Raises InputError when a pose is NaN, a quaternion is not of unit length, or a frame has no pose
    within one interval between frames.
    """
    path = folder / "data.csv"
    table = read_table(path, columns=7)
    stamps, values = table.timestamps_ns, table.values
    require_below(table, 1e12, "a coordinate [m]")
    R_NB = attitudes_of(table, values[:, 3:], "q_RS")
    interpolated = _require_cover(path, stamps, timestamps_ns)
    sigma_p_m, sigma_theta_rad, warnings = read_sigmas(folder / "sensor.yaml")
    X_NB = _interpolate(stamps, values[:, :3], R_NB, timestamps_ns)
    if interpolated:
        warnings = (*warnings, f"{path}: {interpolated} frames lack a pose of their own; it was interpolated")
    moved = np.abs(X_NB - X_NB[0])
    moves = bool(moved[:, :3, 3].max() > 1e-9 or moved[:, :3, :3].max() > 1e-9)
    return InspectorPoses(X_NB, sigma_p_m, sigma_theta_rad, moves, warnings)


def _require_cover(path: Path, stamps: Ints, frames: Ints) -> int:
    """Raise unless each frame has a pose within one frame interval; count those far from any pose."""
    interval_ns = float(np.median(np.diff(frames)))
    after = np.clip(np.searchsorted(stamps, frames), 0, len(stamps) - 1)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    distance = np.minimum(abs(stamps[after] - frames), abs(stamps[before] - frames))
    far = distance > interval_ns * 1.001
    if far.any():
        message = f"{path} does not cover {int(far.sum())} of {len(frames)} frames, first {frames[far][0]} ns"
        raise InputError(f"{message}; give a pose for every frame, or remove inspector0/ if it is at rest")
    return int((distance > 0.5 * interval_ns).sum())


def read_sigmas(path: Path) -> tuple[float, float, tuple[str, ...]]:
    """sigma_p_m, sigma_theta_rad, warnings; a file or key that is absent means that the poses are exact."""
    try:
        if not read_text(path, CONFIGURATION_BYTES, "a YAML file").strip():
            return 0.0, 0.0, ()
    except MissingFile:
        return 0.0, 0.0, ()
    sensor = read_mapping(
        path, "give sigma_p_m and sigma_theta_rad, or remove the file if the poses are exact"
    )
    sigmas = []
    for key, most in (("sigma_p_m", 1e6), ("sigma_theta_rad", np.pi)):
        sigma = float(numbers_at(path, sensor, key, (1,))[0]) if key in sensor else 0.0
        if sigma < 0.0:
            raise InputError(f"{path} key '{key}': {sigma:g} is negative; a standard deviation is not")
        if sigma > most:
            raise InputError(f"{path} key '{key}': {sigma:g} is above {most:g}; such poses say nothing")
        sigmas.append(sigma)
    warnings: tuple[str, ...] = ()
    if "T_BS" in sensor and not np.allclose(numbers_at(path, sensor, "T_BS", (16,)), np.eye(4).ravel()):
        warnings = (
            f"{path}: T_BS is not applied; data.csv must have the pose of the body B that cameras refer to",
        )
    return sigmas[0], sigmas[1], warnings


def _interpolate(stamps: Ints, p_N: Array, R: Array, frames: Ints) -> Array:
    """Poses (F, 4, 4) at the frames; before the first and after the last pose, the nearest one."""
    if len(stamps) == 1:
        return np.repeat(make_pose(R, p_N), len(frames), axis=0)
    # Differences in int64 first: nanoseconds since 1970 do not fit the 53 bits of a double.
    t_poses = (stamps - stamps[0]).astype(np.float64)
    t_frames = np.clip((frames - stamps[0]).astype(np.float64), t_poses[0], t_poses[-1])
    at_frames = np.stack([np.interp(t_frames, t_poses, column) for column in p_N.T], axis=-1)
    return make_pose(Slerp(t_poses, Rotation.from_matrix(R))(t_frames).as_matrix(), at_frames)
