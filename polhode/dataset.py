"""A stereo sequence on disk (docs/dataset.md), without its truth, which polhode/truth.py reads.

Every image is decoded once when the sequence is opened, so that damage is found before the work begins.
"""

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polhode.calibration import StereoCalibration, read_calibration
from polhode.errors import InputError
from polhode.images import (
    Grey,
    UnreadableImage,
    bit_depth,
    has_content,
    parallel_decodes,
    read_mask,
    read_raw,
    to_grey,
)
from polhode.lie import Array, make_pose
from polhode.records import Bools, Ints, Wrench
from polhode.tables import attitudes_of, numbers_at, numbers_of, read_mapping, read_rows, timestamps_of

MIN_PAIRS = 3
MAX_LOSS = 0.6
SAME_POSITION_M = 1e-9
SAME_ROTATION = 1e-9

__all__ = ["StereoCalibration", "StereoImages", "StereoSequence", "open_sequence"]


@dataclass(frozen=True)
class StereoImages:
    """One pair as recorded: neither undistorted nor rectified."""

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
    """(F,) strictly increasing"""
    calibration: StereoCalibration
    X_NC: Array
    """(F, 4, 4) left camera as calibrated in N; the identity throughout when the inspector is at rest"""
    inspector_moves: bool
    sigma_camera_p_m: float
    """Standard deviation of the inspector's position [m]; 0: exact"""
    sigma_camera_theta_rad: float
    n_listed: int
    """Number of timestamps in either data.csv"""
    dropped: tuple[tuple[int, str], ...]
    """(timestamp_ns, reason) of frames that are listed but not usable"""
    warnings: tuple[str, ...]
    wrench: Wrench | None
    """Known force and torque on the target, of ``wrench0``; None when there is none"""
    _files: tuple[tuple[Path, Path], ...] = field(repr=False)
    _bits: int = 8

    def __len__(self) -> int:
        return len(self.timestamps_ns)

    def read_pair(self, k: int) -> StereoImages:
        """Images and masks of pair k, 0 <= k < F, 8-bit grey. Raises InputError if the files have changed."""
        left, mask_left = self.read_left(k)
        return StereoImages(left, self._read_image(1, k), mask_left, self._read_mask("masks1", k))

    def read_left(self, k: int) -> tuple[Grey, Bools | None]:
        """The left image and mask of pair k alone."""
        return self._read_image(0, k), self._read_mask("masks0", k)

    def _read_image(self, camera: int, k: int) -> Grey:
        width, height = self.calibration.width_px, self.calibration.height_px
        try:
            return to_grey(read_raw(self._files[k][camera], width, height), self._bits)
        except UnreadableImage as error:
            raise InputError(
                f"{self.folder}: pair {self.timestamps_ns[k]} ns changed while in use: {error}"
            ) from None

    def _read_mask(self, name: str, k: int) -> Bools | None:
        path = self.folder / "mav0" / name / f"{self.timestamps_ns[k]}.png"
        try:
            return read_mask(path, self.calibration.width_px, self.calibration.height_px)
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
class _Checked:
    """Result of decoding one pair."""

    reason: str | None
    content: bool
    largest_16_bit: int
    bad_masks: tuple[str, ...]


def open_sequence(folder: Path) -> StereoSequence:
    """Open and check a sequence.

    Unpaired and unreadable frames are dropped, listed in ``dropped`` and reported in ``warnings``. Raises
    InputError, one line, when the folder, a camera or its calibration is missing or wrong, timestamps do not
    increase, more than 60 % of the listed frames are lost, fewer than 3 pairs remain, all frames are black, a
    mask has the wrong size, or ``inspector0`` or ``wrench0`` is wrong or does not cover the frames.
    """
    mav0 = _require_folders(folder)
    calibration = read_calibration(mav0)
    bits = calibration.bits
    left, right = (_listed_files(mav0 / name) for name in ("cam0", "cam1"))
    listed = sorted(left.keys() | right.keys())
    paired = [stamp for stamp in listed if stamp in left and stamp in right]
    reasons = {
        stamp: f"only in {'cam0' if stamp in left else 'cam1'}" for stamp in listed if stamp not in paired
    }
    files = [(left[stamp], right[stamp], stamp) for stamp in paired]
    checked = dict(zip(paired, _check_pairs(mav0, files, calibration, bits), strict=True))
    reasons |= {stamp: check.reason for stamp, check in checked.items() if check.reason is not None}
    usable = [stamp for stamp in paired if stamp not in reasons]
    dropped = tuple(sorted(reasons.items()))
    _require_enough(folder, usable, dropped, len(listed))
    if not any(checked[stamp].content for stamp in usable):
        message = "all frames are black: no image shows anything above the noise"
        raise InputError(f"{folder}: {message}; check exposure and lens cap")
    timestamps_ns = np.array(usable, dtype=np.int64)
    folder_of_poses, folder_of_wrench = mav0 / "inspector0", mav0 / "wrench0"
    inspector = read_inspector(folder_of_poses, timestamps_ns) if folder_of_poses.is_dir() else None
    # Without inspector0, N is the left camera itself.
    X_NC = inspector.X_NB @ calibration.X_BC0 if inspector else np.tile(np.eye(4), (len(usable), 1, 1))
    bad_masks = [bad for stamp in usable for bad in checked[stamp].bad_masks]
    bits = bits or bit_depth(max(checked[stamp].largest_16_bit for stamp in usable))
    return StereoSequence(
        folder=folder,
        timestamps_ns=timestamps_ns,
        calibration=calibration,
        X_NC=np.asarray(X_NC),
        inspector_moves=inspector is not None and inspector.moves,
        sigma_camera_p_m=inspector.sigma_p_m if inspector else 0.0,
        sigma_camera_theta_rad=inspector.sigma_theta_rad if inspector else 0.0,
        n_listed=len(listed),
        dropped=dropped,
        warnings=tuple(_warnings(dropped, len(listed), bad_masks, inspector)),
        wrench=read_wrench(folder_of_wrench, timestamps_ns) if folder_of_wrench.is_dir() else None,
        _files=tuple((left[stamp], right[stamp]) for stamp in usable),
        _bits=bits,
    )


def _require_folders(folder: Path) -> Path:
    if not folder.is_dir():
        raise InputError(
            f"{folder} is not a folder: give the folder that contains mav0/ (see docs/dataset.md)"
        )
    mav0 = folder / "mav0"
    for name in ("cam0", "cam1"):
        if not (mav0 / name).is_dir():
            raise InputError(
                f"{mav0 / name} is missing: a sequence needs mav0/cam0 and mav0/cam1 (see docs/dataset.md)"
            )
    return mav0


def _listed_files(camera: Path) -> dict[int, Path]:
    """Timestamp [ns] -> image file, as listed by the camera's data.csv; the name defaults to <ns>.png."""
    path = camera / "data.csv"
    rows = read_rows(path)
    stamps = timestamps_of(path, rows)
    names = [fields[1] if len(fields) > 1 and fields[1] else f"{fields[0]}.png" for _, fields in rows]
    return {int(stamp): camera / "data" / name for stamp, name in zip(stamps, names, strict=True)}


def _check_pairs(
    mav0: Path, pairs: list[tuple[Path, Path, int]], calibration: StereoCalibration, bits: int | None
) -> Iterator[_Checked]:
    at_once = parallel_decodes(calibration.width_px, calibration.height_px)
    with ThreadPoolExecutor(max_workers=min(os.cpu_count() or 1, 16, at_once)) as pool:
        yield from pool.map(lambda pair: _check_pair(mav0, pair, calibration, bits), pairs)


def _check_pair(
    mav0: Path, pair: tuple[Path, Path, int], calibration: StereoCalibration, bits: int | None
) -> _Checked:
    left, right, stamp = pair
    width, height = calibration.width_px, calibration.height_px
    content, largest = False, 0
    for camera, path in (("cam0", left), ("cam1", right)):
        try:
            raw = read_raw(path, width, height)
        except UnreadableImage as error:
            return _Checked(f"{camera} image: {error}", False, 0, ())
        if raw.dtype == np.uint16:
            largest = max(largest, int(raw.max()))
            if bits is not None and largest >= 2**bits:
                raise InputError(
                    f"{path}: value {largest} is above {bits} bits: correct 'bits' in sensor.yaml"
                )
        content = content or has_content(to_grey(raw, bits or bit_depth(int(raw.max()))))
    return _Checked(None, content, largest, tuple(_bad_masks(mav0, stamp, width, height)))


def _bad_masks(mav0: Path, stamp: int, width_px: int, height_px: int) -> Iterator[str]:
    for name in ("masks0", "masks1"):
        path = mav0 / name / f"{stamp}.png"
        if not path.parent.is_dir():
            continue
        try:
            read_mask(path, width_px, height_px)
        except UnreadableImage as error:
            if "wrong size" in str(error):
                raise InputError(f"{path}: {error}; masks must have the size of the images") from None
            yield f"{path}: {error}"


def _require_enough(
    folder: Path, usable: list[int], dropped: tuple[tuple[int, str], ...], n_listed: int
) -> None:
    example = f" (first: {dropped[0][0]} ns, {dropped[0][1]})" if dropped else ""
    if len(dropped) > MAX_LOSS * n_listed:
        message = f"{len(dropped)} of {n_listed} frames are missing, unpaired or unreadable{example}"
        raise InputError(f"{folder}: {message}; at most 60 % may be, repair the sequence")
    if len(usable) < MIN_PAIRS:
        message = f"{len(usable)} usable stereo pairs of {n_listed} frames{example}"
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


def read_wrench(folder: Path, timestamps_ns: Ints) -> Wrench:
    """Read ``wrench0/data.csv``: timestamp, force_N (3) [N], torque_P (3) [N m]. A row applies until the
    next.

    Raises InputError when a row contains no numbers, timestamps do not increase, or no row is as early as the
    last frame (F,).
    """
    path = folder / "data.csv"
    rows = read_rows(path)
    stamps = timestamps_of(path, rows)
    values = numbers_of(path, rows, columns=6)
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
    rows = read_rows(path)
    stamps = timestamps_of(path, rows)
    values = numbers_of(path, rows, columns=7)
    R_NB = attitudes_of(path, rows, values[:, 3:], "q_RS")
    interpolated = _require_cover(path, stamps, timestamps_ns)
    sigma_p_m, sigma_theta_rad, warnings = _read_sigmas(folder / "sensor.yaml")
    X_NB = _interpolate(stamps, values[:, :3], R_NB, timestamps_ns)
    if interpolated:
        warnings = (*warnings, f"{path}: {interpolated} frames lack a pose of their own; it was interpolated")
    moved = np.abs(X_NB - X_NB[0])
    moves = bool(moved[:, :3, 3].max() > SAME_POSITION_M or moved[:, :3, :3].max() > SAME_ROTATION)
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


def _read_sigmas(path: Path) -> tuple[float, float, tuple[str, ...]]:
    """sigma_p_m, sigma_theta_rad; a file or key that is absent means that the poses are exact."""
    if not path.exists() or not path.read_bytes().strip():
        return 0.0, 0.0, ()
    sensor = read_mapping(
        path, "give sigma_p_m and sigma_theta_rad, or remove the file if the poses are exact"
    )
    sigmas = []
    for key in ("sigma_p_m", "sigma_theta_rad"):
        sigma = float(numbers_at(path, sensor, key, (1,))[0]) if key in sensor else 0.0
        if sigma < 0.0:
            raise InputError(f"{path} key '{key}': {sigma:g} is negative; a standard deviation is not")
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
