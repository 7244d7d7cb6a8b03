"""Times of the frames: left against right stamps, lost frames, gaps, unevenness; poses of the inspector."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from polhode.files.json_files import read_json
from polhode.files.tables import read_listing, read_mapping, read_table
from polhode.geometry.lie import Ints
from polhode.pipeline.checkout.check_table import limit_of, make_check
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.records.camera_folders import find_cameras
from polhode.records.dataset import StereoSequence
from polhode.records.pairing import Pairing, offset_in_words, pair_by_time, time_in_words
from polhode.runtime.errors import InputError

UNKNOWN_HZ = 1.0
"""What those write in sensor.yaml who know of no rate, such as calibrations"""


@dataclass(frozen=True)
class Stamps:
    """The stamps that both cameras list [ns], and how they are paired."""

    left: Ints
    """(n,)"""
    right: Ints
    """(m,)"""
    second: str = "right camera"
    """What the right stamps are those of"""
    first: str = "left camera"

    @cached_property
    def pairing(self) -> Pairing:
        """As a run pairs them."""
        return pair_by_time(self.left, self.right)

    def differences_ns(self) -> Ints:
        """(p,) right minus left, of the pairs."""
        return self.right[self.pairing.right] - self.left[self.pairing.left]


def read_stamps(folder: Path) -> Stamps:
    """What ``data.csv`` of both cameras lists. Raises InputError."""
    cameras = find_cameras(folder / "mav0")
    left, right = (
        np.array(list(read_listing(cameras.folder(side) / "data.csv")), dtype=np.int64) for side in (0, 1)
    )
    return Stamps(left, right, "range images", "camera") if cameras.has_ranges else Stamps(left, right)


def stamp_checks(stamps: Stamps) -> list[CheckoutCheck]:
    """Offset of the clocks, and images without a partner, by the lists alone."""
    pairing, differences = stamps.pairing, stamps.differences_ns()
    allowed, of_ranges = time_in_words(pairing.tolerance_ns), stamps.second != "right camera"
    offset_us = None
    finding = f"No stamp of the {stamps.first} is near enough to one of the {stamps.second}."
    if len(differences):
        offset_us, words = 1e-3 * abs(pairing.offset_ns), "There is no constant difference"
        if pairing.offset_ns:
            first = f"the {stamps.first}" if of_ranges else "the left one"
            words = offset_in_words(pairing.offset_ns, pairing.interval_ns, f"the {stamps.second}", first)
            words = f"{words[0].upper()}{words[1:]}, throughout"
        scatter = time_in_words(float(np.abs(differences - pairing.offset_ns).max()))
        finding = f"{words}; single ones deviate by up to {scatter}, {allowed} are allowed."
    advice = ""
    if of_ranges:
        advice = (
            "If image and ranges were taken together, this is an offset of their clocks, which a run "
            "removes; if not, depth and motion are wrong."
        )
    name = f"clock offset of the {stamps.second}"
    images, pairs = len(stamps.left) + len(stamps.right), len(pairing.left)
    unpaired = images - 2 * pairs
    alone = f"{unpaired} of {images} listed images have no partner within {allowed}."
    return [
        make_check("clock offset", offset_us, finding, name=name, advice=advice),
        make_check("unpaired", 100.0 * unpaired / max(pairs + unpaired, 1), alone),
    ]


def frame_checks(sequence: StereoSequence) -> list[CheckoutCheck]:
    """Unreadable and repeated images, gaps and unevenness of the pairs that a run would use."""
    dt = np.diff(sequence.timestamps_ns) * 1e-9
    usual, longest = float(np.median(dt)), int(np.argmax(dt))
    near = dt[dt < limit_of("gap") * usual]
    uneven = 50.0 * float(np.ptp(np.percentile(near, [5.0, 95.0]))) / usual if len(near) else 0.0
    at = (sequence.timestamps_ns[longest] - sequence.timestamps_ns[0]) * 1e-9
    unreadable = [reason for _, reason in sequence.dropped if not reason.startswith("only in")]
    repeated, count, listed = int(sequence.repeated.sum()), len(sequence), sequence.n_listed
    noun, what = "pairs", "pairs have an image of the pair before"
    if sequence.has_ranges:
        noun, what = "images", "images or their ranges are those before"
    missing = f"{len(unreadable)} of {listed} {noun}"
    missing += f" (first: {unreadable[0]})." if unreadable else "."
    again = f"{repeated} of {count} {what}, bit for bit."
    again += f" All {noun} are the same." if sequence.frozen else ""
    rate = (
        f"{1.0 / usual:.4g} {noun} per second ({usual:.4g} s), 90 % of the intervals within {uneven:.2g} %."
    )
    gap = f"{dt[longest]:.4g} s, {at:.4g} s after the first {noun[:-1]}."
    advice = f"A camera or the recorder stood still: such {noun} are not used; find the cause."
    return [
        make_check("unreadable", 100.0 * len(unreadable) / listed, missing),
        make_check("repeated", 100.0 * repeated / count, again, advice=advice),
        make_check("jitter", uneven, rate),
        make_check("gap", float(dt[longest]) / usual, gap),
    ]


def plausible_checks(sequence: StereoSequence) -> list[CheckoutCheck]:
    """Interval, duration and baseline that a rig can have, and the interval against a stated rate."""
    stamps_ns, stated = sequence.timestamps_ns, _states_unit(sequence.folder)
    usual_s = 1e-9 * float(np.median(np.diff(stamps_ns)))
    days = 1e-9 * float(stamps_ns[-1] - stamps_ns[0]) / 86400.0
    key = "short interval" if usual_s < limit_of("short interval") else "interval"
    limits = (limit_of(key), None) if stated else None
    said = " The unit of the times was stated with --time-unit." if stated else ""
    noun = "images" if sequence.has_ranges else "pairs"
    finding, name = f"{len(stamps_ns)} {noun}, {usual_s:.4g} s apart.{said}", f"usual interval between {noun}"
    checks = [
        make_check(key, usual_s, finding, limits=limits, name=name),
        make_check("duration", days, f"{86400.0 * days:.4g} s from the first of the {noun} to the last."),
    ]
    sensor = read_mapping(sequence.folder / "mav0" / "cam0" / "sensor.yaml", "a camera needs its calibration")
    rate_hz = sensor.get("rate_hz")
    if isinstance(rate_hz, int | float) and rate_hz > 0.0 and rate_hz != UNKNOWN_HZ and usual_s > 0.0:
        ratio = max(usual_s * rate_hz, 1.0 / (usual_s * rate_hz))
        finding = f"rate_hz is {rate_hz:g}, the {noun} are {usual_s:.4g} s apart."
        checks.append(make_check("stated rate", ratio, finding))
    if not sequence.has_ranges:
        rig = sequence.calibration
        baseline_m = float(np.linalg.norm(rig.X_BC1[:3, 3] - rig.X_BC0[:3, 3]))
        checks.append(make_check("baseline", baseline_m, f"The cameras are {baseline_m:.4g} m apart."))
    return checks


def _states_unit(folder: Path) -> bool:
    """Whether an import had the unit of the times from the user."""
    try:
        record = read_json(folder / "import.json", "a record of an import", 2**29)
        return "time_unit" in record["options"]
    except (InputError, KeyError, TypeError):
        return False


def inspector_checks(sequence: StereoSequence) -> list[CheckoutCheck]:
    """Whether the inspector's poses keep up with the images, and what is stated of their errors."""
    folder = sequence.folder / "mav0" / "inspector0"
    if not folder.is_dir():
        at_rest = "the camera is" if sequence.has_ranges else "the cameras are"
        return [make_check("inspector", None, f"There is no inspector0: {at_rest} taken to be at rest.")]
    stamps, frames = read_table(folder / "data.csv", columns=7).timestamps_ns, sequence.timestamps_ns
    after = np.clip(np.searchsorted(stamps, frames), 0, len(stamps) - 1)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    distance = np.minimum(np.abs(stamps[after] - frames), np.abs(stamps[before] - frames))
    usual = float(np.median(np.diff(frames)))
    sigma_p, sigma_deg = sequence.sigma_camera_p_m, float(np.rad2deg(sequence.sigma_camera_theta_rad))
    rate = 1e9 * (len(stamps) - 1) / max(float(stamps[-1] - stamps[0]), 1.0)
    stated = "no sigma, so as exact"
    if sigma_p or sigma_deg:
        stated = f"sigmas {1e3 * sigma_p:.3g} mm and {sigma_deg:.3g} deg"
    finding = (
        f"The inspector {'moves' if sequence.inspector_moves else 'stays at one pose'}; {len(stamps)} poses, "
        f"{rate:.4g} per second for {1e9 / usual:.4g} images, are given with {stated}."
    )
    return [make_check("inspector", float(distance.max()) / usual, finding)]
