"""What a user should know of a sequence before a run, in seconds, from a sample of its pairs."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from polhode.frontend.rectification import RectifiedPair, Rectifier, rectified_pair
from polhode.geometry.camera import RectifiedRig
from polhode.geometry.lie import Ints
from polhode.pipeline.checkout.check_table import CHECK_TABLE
from polhode.pipeline.checkout.exposure import background_checks, exposure_checks
from polhode.pipeline.checkout.result import CheckoutCheck, CheckoutResult, Group, worst
from polhode.pipeline.checkout.rig_tilt import RowFit, fit_rows, tilt_checks
from polhode.pipeline.checkout.sample import PLACES, Sample, places, take_sample
from polhode.pipeline.checkout.target_motion import motion_checks
from polhode.pipeline.checkout.target_range import range_checks
from polhode.pipeline.checkout.timing import (
    frame_checks,
    inspector_checks,
    plausible_checks,
    read_stamps,
    stamp_checks,
)
from polhode.pipeline.context import rectifier_of, with_found_masks
from polhode.records.camera_folders import find_cameras
from polhode.records.dataset import StereoSequence, open_sequence
from polhode.records.rig_calibration import (
    StereoCalibration,
    read_calibration,
    read_range_calibration,
    with_baseline,
)
from polhode.runtime.errors import InputError
from polhode.runtime.processes import worker_count
from polhode.runtime.progress import Progress, Silent
from polhode.runtime.threads import single_threaded

WARNING_PLACES = 3
"""Places at which a run looks before its work."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Findings:
    """The sample with all that was made of it, for the page."""

    sequence: StereoSequence
    rig: RectifiedRig
    sample: Sample
    rows: RowFit | None
    shown: RectifiedPair
    """One pair of the middle of the sequence, as rectified"""
    shown_index: int
    """Its index in the sample"""


@dataclass(frozen=True)
class Checkout:
    """What ``polhode checkout`` writes."""

    result: CheckoutResult
    findings: Findings | None
    """None: too few frames of the two cameras belong together"""


@single_threaded
def checkout(
    sequence_folder: Path,
    rig_folder: Path | None = None,
    progress: Progress | None = None,
    workers: int = 0,
    count: int = PLACES,
) -> Checkout:
    """Check a sequence, with its own calibration or that of ``rig_folder`` (cam0/ and cam1/sensor.yaml).

    ``count``: places at which two successive pairs are examined. Where the stamps of the cameras leave no
    sequence to look at, the result has the checks of the stamps alone, and fails. Raises InputError for
    anything else that ``polhode run`` refuses.
    """
    rig: Literal["sequence", "given"] = "sequence" if rig_folder is None else "given"
    given = None
    if rig_folder is not None:
        try:
            has_ranges = find_cameras(sequence_folder / "mav0").has_ranges
        except InputError:
            has_ranges = False
        given = read_range_calibration(rig_folder) if has_ranges else read_calibration(rig_folder)
    try:
        sequence = open_sequence(sequence_folder)
    except InputError as error:
        # the checks of the stamps alone, where these are why the sequence cannot be opened
        try:
            checks = stamp_checks(read_stamps(sequence_folder))
        except InputError:
            raise error from None
        if worst(checks) != "FAIL":
            raise
        nothing = CheckoutResult(status="FAIL", pairs=0, pairs_examined=0, rig=rig, checks=tuple(checks))
        return Checkout(nothing, None)
    if given is not None:
        sequence = _with_calibration(sequence, given)
    frames, shown = places(sequence.timestamps_ns, count), progress or Silent()
    rectifier, processes = rectifier_of(sequence), worker_count(workers)
    rectifier = with_found_masks(sequence, rectifier, frames.tolist(), processes, shown)
    findings = find(sequence, rectifier, frames, processes, shown)
    of_times = *stamp_checks(read_stamps(sequence_folder)), *frame_checks(sequence)
    checks = [*image_checks(findings), *of_times, *plausible_checks(sequence), *inspector_checks(sequence)]
    checks.sort(key=lambda check: get_args(Group).index(check.group))
    result = CheckoutResult(
        status=worst(checks), pairs=len(sequence), pairs_examined=len(frames), rig=rig, checks=tuple(checks)
    )
    return Checkout(result, findings)


def _with_calibration(sequence: StereoSequence, given: StereoCalibration) -> StereoSequence:
    """The sequence, its images taken to be those of another rig. Raises InputError: other resolutions."""
    own = sequence.calibration
    for camera in (0, 1):
        of_rig, of_images = given.size_px(camera), own.size_px(camera)
        if of_rig != of_images:
            raise InputError(
                f"--rig: its cam{camera} has {of_rig[0]}x{of_rig[1]} px, the images have {of_images[0]}x"
                f"{of_images[1]}; give the calibration of these cameras"
            )
    if sequence.has_ranges:
        given = with_baseline(given, float(np.linalg.norm((own.X_BC1 - own.X_BC0)[:3, 3])))
    return replace(sequence, calibration=given)


def warn_before_run(sequence: StereoSequence, rectifier: Rectifier) -> None:
    """Log what does not pass at a few places of the sequence, a line each, in a second or two.

    Frames are not matched with each other, so nothing is said of the motion, nor of the cost; the reader of
    the sequence has warned of unreadable and repeated images. A check that fails does not cost the run.
    """
    said = [CHECK_TABLE[key].name for key in ("unreadable", "repeated")]
    try:
        frames = places(sequence.timestamps_ns, WARNING_PLACES)
        frames = frames[:: 2 if len(frames) == 2 * WARNING_PLACES else 1]
        checks = image_checks(find(sequence, rectifier, frames, 1, Silent()))
        checks = [each for each in checks if each.group not in ("motion", "time")]
        of_times = *frame_checks(sequence), *plausible_checks(sequence)
        for check in (*checks, *of_times, *inspector_checks(sequence)):
            if check.status != "PASS" and check.value is not None and check.name not in said:
                _log.warning("checkout: %s: %s", check.status, in_a_line(check))
    except (ArithmeticError, LookupError, ValueError, MemoryError):
        _log.exception("the checks before the run failed")


def in_a_line(check: CheckoutCheck) -> str:
    """Name, value, limit and advice."""
    unit = f" {check.unit}" if check.unit else ""
    bound = check.fail_limit if check.status == "FAIL" else check.limit
    limit = "" if bound is None else f" ({'at least' if check.at_least else 'at most'} {bound:g}{unit})"
    value = "not measured" if check.value is None else f"{check.value:.3g}{unit}{limit}"
    return f"{check.name}: {value}. {check.advice}"


def find(
    sequence: StereoSequence, rectifier: Rectifier, frames: Ints, workers: int, progress: Progress
) -> Findings:
    """Examine the pairs of these indices."""
    rig, middle = rectifier.rig, len(frames) // 2
    sample = take_sample(sequence, rectifier, frames, workers, progress)
    shown = rectified_pair(sequence, rectifier, int(frames[middle]))
    return Findings(sequence, rig, sample, fit_rows(sample, rig), shown, middle)


def image_checks(findings: Findings) -> list[CheckoutCheck]:
    """All checks that need images."""
    sequence, sample, rig = findings.sequence, findings.sample, findings.rig
    return [
        *tilt_checks(sample, rig, findings.rows),
        *range_checks(sample, rig),
        *motion_checks(sequence, sample, rig),
        *exposure_checks(sample),
        *background_checks(sample),
    ]
