"""A stereo sequence on disk (docs/dataset.md), without its truth, which polhode/records/read_truth.py reads.

The second of the two cameras may be a range sensor (polhode/records/range_images.py): then the calibration
has a virtual right camera, and ``read_range`` takes the place of the right images.

Every image is decoded once when the sequence is opened, so that damage is found before the work begins.
"""

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
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
from polhode.records.mask_files import (
    doubts_of_masks,
    find_masks,
    mask_file,
    other_mask_folders,
    unused_masks,
)
from polhode.records.pairing import offset_in_words, pair_by_time, time_in_words
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
PAIRS_AHEAD = 64
"""Pairs that are checked at a time when a sequence is opened."""

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
    _masks: tuple[Mapping[str, Path], ...] = field(repr=False)
    """Of each camera by their names without suffix (``mask_files``)"""
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
    def poses_stated(self) -> bool:
        """Whether N is that of the inspector's stated poses, not that of the left camera at rest."""
        return not np.array_equal(self.X_NC, np.broadcast_to(np.eye(4), self.X_NC.shape))

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
            stamp = self.timestamps_ns[k]
            raise InputError(f"{self.folder}: pair {stamp} ns changed while in use: {error}") from None
        if _digest(raw) != self._digests[k][camera]:
            raise InputError(f"{file}: changed while in use: leave the sequence alone, and run again")
        return raw

    def _read_mask(self, camera: int, k: int) -> Bools | None:
        width, height = self.calibration.size_px(camera)
        if self.repeated[k]:
            return np.zeros((height, width), dtype=np.bool_)
        stamps = _stamps_of_mask(camera, int(self.timestamps_ns[k]), int(self._right_ns[k]))
        path = mask_file(self._masks[camera], stamps, self._files[k][camera])
        try:
            return None if path is None else read_mask(path, width, height)
        except UnreadableImage:
            # open_sequence has warned of it.
            return None


def open_sequence(folder: Path) -> StereoSequence:
    """Open and check a sequence.

    Unpaired and unreadable frames are dropped, listed in ``dropped`` and reported in ``warnings``. Raises
    InputError, one line, when the folder, a camera or its calibration is missing or wrong, timestamps do not
    increase, more than 60 % of the listed frames are lost, fewer than 3 pairs remain, all frames are black, a
    mask has the wrong size, no range image has a measurement, or ``inspector0`` or ``wrench0`` is wrong or
    does not cover the frames.
    """
    mav0 = folder / "mav0"
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not a folder: give the folder that contains mav0/ (see docs/dataset.md)"
        )
    if not mav0.exists() and (folder / "cam0").is_dir():
        raise InputError(f"{folder} is the folder mav0 itself: give the folder that contains it")
    cameras = find_cameras(mav0)
    ranges = read_range_model(cameras.folder(1)) if cameras.has_ranges else None
    if ranges is None:
        calibration = read_calibration(mav0, cameras.names)
    else:
        calibration = read_range_calibration(mav0, cameras.names[0])
    listings = tuple(read_listing(cameras.folder(camera) / "data.csv") for camera in (0, 1))
    files, right_of, reasons, warnings = _pair_files(cameras, *listings)
    n_listed = len(files) + len(reasons)
    # Images are decoded only while enough frames can remain.
    _require_enough(folder, reasons, n_listed)
    masks, of_masks = _masks_of(cameras, calibration, listings, tuple(files))
    warnings += of_masks
    usable: list[_Checked] = []
    for number, check in enumerate(_check_pairs(cameras, files, right_of, calibration, masks), start=1):
        if check.reason is None:
            usable.append(check)
        else:
            reasons[check.stamp] = check.reason
            _require_enough(folder, reasons, n_listed, unchecked=len(files) - number)
    if not any(check.content for check in usable):
        if any(check.bright for check in usable):
            raise InputError(
                f"{folder}: all frames are saturated or uniformly bright; check exposure and gain"
            )
        raise InputError(
            f"{folder}: all frames are black: no image shows anything above the noise; "
            "check exposure and lens cap"
        )
    measured = [k for k, check in enumerate(usable) if check.shows[1]]
    if ranges is not None and not measured:
        raise InputError(
            f"{cameras.folder(1)}: no image has a measurement, all pixels are 0; record the ranges again"
        )
    timestamps_ns = np.array([check.stamp for check in usable], dtype=np.int64)
    repeated, frozen = _repeated(cameras, usable)
    # Without inspector0, N is the left camera itself.
    poses, wrench = mav0 / "inspector0", mav0 / "wrench0"
    inspector = read_inspector(poses, timestamps_ns) if poses.is_dir() else None
    X_NC = inspector.X_NB @ calibration.X_BC0 if inspector else np.tile(np.eye(4), (len(usable), 1, 1))
    if not cameras.has_ranges and (mav0 / RANGE_FOLDER).is_dir():
        remedy = f"to use the ranges, take {cameras.names[1]} out of {mav0}"
        warnings.insert(0, f"{mav0 / RANGE_FOLDER} is not used, since there are two cameras; {remedy}")
    if reasons:
        example = f"(first: {min(reasons)} ns, {reasons[min(reasons)]})"
        warnings.append(f"{len(reasons)} of {n_listed} frames dropped: unpaired or unreadable {example}")
    if bad := [words for check in usable for words in check.bad_masks]:
        warnings.append(f"{len(bad)} masks are missing or unreadable and not used (first: {bad[0]})")
    warnings += [*(inspector.warnings if inspector is not None else ()), *_odd_times(timestamps_ns)]
    if repeated.any():
        warnings.append(
            f"{int(repeated.sum())} of {len(repeated)} pairs have an image of the pair before, bit for bit "
            f"(first: {timestamps_ns[repeated][0]} ns): a camera or recorder stood still; they are not used"
        )
    sequence = StereoSequence(
        folder=folder,
        timestamps_ns=timestamps_ns,
        calibration=calibration,
        X_NC=np.asarray(X_NC),
        inspector_moves=inspector is not None and inspector.moves,
        sigma_camera_p_m=inspector.sigma_p_m if inspector else 0.0,
        sigma_camera_theta_rad=inspector.sigma_theta_rad if inspector else 0.0,
        n_listed=n_listed,
        dropped=tuple(sorted(reasons.items())),
        warnings=tuple(warnings),
        wrench=read_wrench(wrench, timestamps_ns) if wrench.is_dir() else None,
        repeated=repeated,
        frozen=frozen,
        _files=tuple(files[check.stamp] for check in usable),
        _digests=tuple(check.digests for check in usable),
        _cameras=cameras,
        _masks=masks,
        _right_ns=np.array([right_of[check.stamp] for check in usable], dtype=np.int64),
        _bits=calibration.bits or bit_depth(max(check.largest_16_bit for check in usable)),
        range_model=ranges,
    )
    return sequence if ranges is None else _with_virtual_camera(sequence, ranges, measured)


def _with_virtual_camera(sequence: StereoSequence, model: RangeModel, measured: list[int]) -> StereoSequence:
    """The sequence with the virtual right camera where the noise of the ranges asks for it.

    measured: pairs whose range image has a measurement. The range of the target in an image is the median of
    what the mask or the dark background leaves. Where more than half of the border has a range there is a
    background and no mask, and the target, which covers a twentieth of the image or more, is nearer.
    """
    usual = []
    for index in np.unique(np.linspace(0, len(measured) - 1, 24).round().astype(int)).tolist():
        mask, range_m = sequence._read_mask(0, measured[index]), sequence.read_range(measured[index])
        known = range_m[np.isfinite(range_m) if mask is None else mask & np.isfinite(range_m)]
        border = np.concatenate([range_m[0], range_m[-1], range_m[:, 0], range_m[:, -1]])
        has_background = mask is None and np.isfinite(border).mean() > 0.5
        if len(known):
            usual.append(float(np.percentile(known, 5.0 if has_background else 50.0)))
    if not usual:
        raise InputError(
            f"{sequence.folder / 'mav0' / RANGE_FOLDER}: no pixel of the target, as the masks give it, has a "
            "measurement; masks and ranges must be of the same pixels"
        )
    focal_px = float(np.mean(sequence.calibration.K0[[0, 1], [0, 1]]))
    baseline_m = model.virtual_baseline_m(focal_px, float(np.median(usual)))
    return replace(sequence, calibration=with_baseline(sequence.calibration, baseline_m))


def _pair_files(
    cameras: CameraFolders, left: dict[int, str], right: dict[int, str]
) -> tuple[dict[int, tuple[Path, Path]], dict[int, int], dict[int, str], list[str]]:
    """By the timestamp [ns] of the pair, ascending: its files; the stamp of its right image; the reason why a
    listed frame is no pair. And warnings. Raises InputError for recordings without a time in common."""
    first, second = cameras.names
    left_ns, right_ns = (np.array(list(names), dtype=np.int64) for names in (left, right))
    gap_ns = max(int(right_ns[0] - left_ns[-1]), int(left_ns[0] - right_ns[-1]))
    if gap_ns > 0 and min(len(left_ns), len(right_ns)) > 1:
        late, early = (second, first) if right_ns[0] > left_ns[-1] else (first, second)
        raise InputError(
            f"{cameras.mav0}: the images of {first} and {second} have no time in common: {late} begins "
            f"{time_in_words(gap_ns)} after {early} ends; give both the stamps of one clock"
        )
    pairing = pair_by_time(left_ns, right_ns)
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
    warnings = []
    if pairing.offset_ns:
        offset = offset_in_words(pairing.offset_ns, pairing.interval_ns, second, first)
        warnings.append(
            f"{offset}: taken for an offset of the clocks; pairs have the stamps of {first}; if the cameras "
            "were not triggered together, depth and motion are wrong"
        )
    folders = [cameras.folder(camera) / "data" for camera in (0, 1)]
    present: list[set[str]] = [set(), set()]
    for camera in (0, 1):
        with suppress(OSError):
            present[camera] = {entry.name for entry in os.scandir(folders[camera])}
    files: dict[int, tuple[Path, Path]] = {}
    right_of = dict(zip(left_ns[pairing.left].tolist(), right_ns[pairing.right].tolist(), strict=True))
    for stamp, other in right_of.items():
        for camera, name in enumerate((left[stamp], right[other])):
            # A name with a folder is looked up by itself.
            if name not in present[camera] and ("/" not in name or not (folders[camera] / name).exists()):
                reasons[stamp] = f"{cameras.names[camera]} image: file missing"
                break
        else:
            files[stamp] = (folders[0] / left[stamp], folders[1] / right[other])
    return files, right_of, reasons, warnings


@dataclass(frozen=True)
class _Checked:
    """Result of decoding one pair: why it cannot be used (None: it can), and what its images are."""

    stamp: int
    reason: str | None = None
    bright: bool = False
    """Whether more than half of an image is in the upper half of the range"""
    largest_16_bit: int = 0
    bad_masks: tuple[str, ...] = ()
    digests: tuple[bytes, ...] = ()
    shows: tuple[bool, ...] = ()
    """Whether each image has content: a black one has none"""
    content: bool = False


def _check_pairs(
    cameras: CameraFolders,
    files: dict[int, tuple[Path, Path]],
    right_of: dict[int, int],
    calibration: StereoCalibration,
    masks: tuple[Mapping[str, Path], ...],
) -> Iterator[_Checked]:
    """What is found out about each pair, in order; never more than a few are decoded ahead."""
    rest, has_ranges = iter(files.items()), cameras.has_ranges

    def check(pair: tuple[int, tuple[Path, Path]]) -> _Checked:
        stamp, bits, bright, largest = pair[0], calibration.bits, False, 0
        digests, shows, bad_masks = list[bytes](), list[bool](), list[str]()
        for camera, path in enumerate(pair[1]):
            where = f"{cameras.names[camera]} image"
            try:
                raw = read_raw(path, *calibration.size_px(camera))
            except UnreadableImage as error:
                return _Checked(stamp, f"{where}: {error}")
            digests.append(_digest(raw))
            if camera == 1 and has_ranges:
                if wrong := why_no_ranges(raw):
                    return _Checked(stamp, f"{where}: {wrong}")
                shows.append(bool(raw.any()))
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
        for camera in (0,) if has_ranges else (0, 1):
            if masks[camera] or cameras.masks(camera).is_dir():
                stamps = _stamps_of_mask(camera, stamp, right_of[stamp])
                mask = mask_file(masks[camera], stamps, pair[1][camera])
                if mask is None:
                    bad_masks.append(f"{cameras.masks(camera) / f'{stamp}.png'}: file missing")
                    continue
                try:
                    read_mask(mask, *calibration.size_px(camera))
                except UnreadableImage as error:
                    if "wrong size" in str(error):
                        raise InputError(f"{mask}: {error}; masks must have the size of the images") from None
                    bad_masks.append(f"{mask}: {error}")
        content, found = shows[0] if has_ranges else any(shows), (tuple(bad_masks), tuple(digests))
        return _Checked(stamp, None, bright, largest, *found, tuple(shows), content)

    at_once = min(parallel_decodes(*calibration.size_px(camera)) for camera in (0, 1))
    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, 16, at_once)) as pool:
        while some := list(islice(rest, PAIRS_AHEAD)):
            yield from pool.map(check, some)


def _digest(image: NDArray[Any]) -> bytes:
    return blake2b(image.tobytes(), digest_size=16).digest()


def _stamps_of_mask(camera: int, stamp: int, right_ns: int) -> tuple[int, ...]:
    """A mask has the timestamp of its pair; one of the right camera may have that of its image."""
    return (stamp, right_ns) if camera else (stamp,)


def _masks_of(
    cameras: CameraFolders,
    calibration: StereoCalibration,
    listings: tuple[dict[int, str], ...],
    pairs_ns: tuple[int, ...],
) -> tuple[tuple[dict[str, Path], ...], list[str]]:
    """The masks of both cameras, and warnings about them."""
    masks, warnings = [], []
    if others := other_mask_folders(cameras.mav0):
        warnings.append(
            f"{others[0]} is not used: the masks of a sequence are in mav0/masks0 and mav0/masks1"
        )
    for camera, listing in enumerate(listings):
        folder = cameras.masks(camera)
        found = {} if camera and cameras.has_ranges else find_masks(folder, listing, pairs_ns)
        masks.append(found)
        if unused := unused_masks(found, listing, pairs_ns):
            warnings.append(f"{folder}: {len(unused)} masks belong to no image (first: {unused[0]})")
        doubts = doubts_of_masks(found, calibration.size_px(camera)) if found else []
        warnings += [f"{folder}: masks {words}" for words in doubts]
    return tuple(masks), warnings


def _require_enough(folder: Path, reasons: dict[int, str], n_listed: int, unchecked: int = 0) -> None:
    """Raise InputError when the frames lost so far, of which ``reasons`` tells, leave too few."""
    example = f" (first: {min(reasons)} ns, {reasons[min(reasons)]})" if reasons else ""
    at_least = "at least " if unchecked else ""
    if len(reasons) > MAX_LOSS * n_listed:
        message = (
            f"{at_least}{len(reasons)} of {n_listed} frames are missing, unpaired or unreadable{example}"
        )
        raise InputError(f"{folder}: {message}; at most 60 % may be, repair the sequence")
    if n_listed - len(reasons) < MIN_PAIRS:
        message = f"{n_listed - len(reasons)} usable stereo pairs of {n_listed} frames{example}"
        raise InputError(f"{folder}: {message}; at least {MIN_PAIRS} are needed")


def _repeated(cameras: CameraFolders, checked: list[_Checked]) -> tuple[Bools, bool]:
    """(F,) pairs with an image of the pair before, since no sensor repeats its noise; whether all are alike.

    Raises InputError where one camera alone stood still throughout.
    """
    same = [
        [shows and a == b for shows, a, b in zip(after.shows, before.digests, after.digests, strict=True)]
        for before, after in pairwise(checked)
    ]
    of_cameras = np.array([[False, False], *same], dtype=np.bool_)
    frozen = bool(of_cameras[1:].all())
    still = np.flatnonzero(of_cameras[1:].all(axis=0))
    if len(still) and not frozen:
        raise InputError(
            f"{cameras.folder(int(still[0]))}: all images are the same, bit for bit: the camera or the "
            "recorder stood still; record the sequence again"
        )
    return np.asarray(of_cameras.any(axis=1)) & (not frozen), frozen


def _odd_times(timestamps_ns: Ints) -> list[str]:
    """Intervals that suggest another unit, or a stamp of another recording."""
    intervals_s = 1e-9 * np.diff(timestamps_ns)
    usual_s, longest = float(np.median(intervals_s)), int(np.argmax(intervals_s))
    # Microseconds or seconds given as nanoseconds lie outside.
    if not 1e-4 <= usual_s <= 86400.0:
        return [
            f"the frames are {usual_s:.3g} s apart: check that the timestamps in data.csv are nanoseconds"
        ]
    if intervals_s[longest] > max(3600.0, 100.0 * usual_s):
        return [
            f"frame {timestamps_ns[longest + 1]} ns comes {intervals_s[longest]:.3g} s after the one before "
            f"it, where {usual_s:.3g} s is usual: check the timestamps in data.csv"
        ]
    return []


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


@dataclass(frozen=True)
class InspectorPoses:
    """Pose of the inspector's body B in N at each frame, and how well it is known."""

    X_NB: Array
    """(F, 4, 4)"""
    sigma_p_m: float
    sigma_theta_rad: float
    moves: bool
    warnings: tuple[str, ...]


def read_inspector(folder: Path, timestamps_ns: Ints) -> InspectorPoses:
    """Read ``inspector0`` and interpolate it to the frames (F,): linear in position, slerp in attitude.

    Raises InputError when a pose is NaN, a quaternion is not of unit length, or a frame has no pose
    within one interval between frames.
    """
    path, frames = folder / "data.csv", timestamps_ns
    table = read_table(path, columns=7)
    stamps, p_N = table.timestamps_ns, table.values[:, :3]
    require_below(table, 1e12, "a coordinate [m]")
    R_NB = attitudes_of(table, table.values[:, 3:], "q_RS")
    interval_ns = float(np.median(np.diff(frames)))
    after = np.clip(np.searchsorted(stamps, frames), 0, len(stamps) - 1)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    distance_ns = np.minimum(abs(stamps[after] - frames), abs(stamps[before] - frames))
    far = distance_ns > interval_ns * 1.001
    if far.any():
        message = f"{path} does not cover {int(far.sum())} of {len(frames)} frames, first {frames[far][0]} ns"
        raise InputError(f"{message}; give a pose for every frame, or remove inspector0/ if it is at rest")
    sigma_p_m, sigma_theta_rad, warnings = read_sigmas(folder / "sensor.yaml")
    if interpolated := int((distance_ns > 0.5 * interval_ns).sum()):
        warnings = (*warnings, f"{path}: {interpolated} frames lack a pose of their own; it was interpolated")
    if len(stamps) == 1:
        X_NB = np.repeat(make_pose(R_NB, p_N), len(frames), axis=0)
    else:
        # Before the first and after the last pose, the nearest one. Differences in int64 first: nanoseconds
        # since 1970 do not fit the 53 bits of a double.
        t_poses = (stamps - stamps[0]).astype(np.float64)
        t_frames = np.clip((frames - stamps[0]).astype(np.float64), t_poses[0], t_poses[-1])
        at_frames = np.stack([np.interp(t_frames, t_poses, column) for column in p_N.T], axis=-1)
        X_NB = make_pose(Slerp(t_poses, Rotation.from_matrix(R_NB))(t_frames).as_matrix(), at_frames)
    moves = bool(np.abs(X_NB - X_NB[0])[:, :3].max() > 1e-9)
    return InspectorPoses(X_NB, sigma_p_m, sigma_theta_rad, moves, warnings)


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
