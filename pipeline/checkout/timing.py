"""Times of the frames: left against right stamps, lost frames, gaps, unevenness; poses of the inspector."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from polhode.camera_folders import find_cameras
from polhode.dataset import MAX_LOSS, StereoSequence
from polhode.pairing import Pairing, offset_in_words, pair_by_time, time_in_words
from polhode.pipeline.checkout.result import CheckoutCheck, judged
from polhode.records import Ints
from polhode.tables import read_listing, read_table

MAX_UNPAIRED, FAIL_UNPAIRED = 10.0, 100.0 * MAX_LOSS
"""Share of the frames [%]."""
MAX_UNEVEN = 25.0
"""Half the range of the middle 90 % of the intervals, over the median one [%]."""
MAX_GAP = 5.0
"""Longest interval over the median one."""
MAX_REPEATED = 0.0


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

    @property
    def unpaired(self) -> int:
        """Images of either camera without a partner."""
        return len(self.left) + len(self.right) - 2 * len(self.pairing.left)

    @property
    def listed(self) -> int:
        """Pairs, and images without a partner."""
        return len(self.pairing.left) + self.unpaired

    def differences_ns(self) -> Ints:
        """(p,) right minus left, of the pairs."""
        return self.right[self.pairing.right] - self.left[self.pairing.left]


def read_stamps(folder: Path) -> Stamps:
    """What ``data.csv`` of both cameras lists. Raises InputError."""
    cameras = find_cameras(folder / "mav0")
    left, right = (
        np.array(list(read_listing(cameras.folder(side) / "data.csv")), dtype=np.int64) for side in (0, 1)
    )
    if cameras.has_ranges:
        return Stamps(left, right, "range images", "camera")
    return Stamps(left, right)


def stamp_checks(stamps: Stamps) -> list[CheckoutCheck]:
    """Offset of the clocks, and images without a partner, by the lists alone."""
    pairing, differences = stamps.pairing, stamps.differences_ns()
    share = 100.0 * stamps.unpaired / max(stamps.listed, 1)
    allowed = time_in_words(pairing.tolerance_ns)
    if len(differences) == 0:
        offset_us, finding = (
            None,
            f"No stamp of the {stamps.first} is near enough to one of the {stamps.second}.",
        )
    else:
        scatter = np.abs(differences - pairing.offset_ns).max()
        offset_us = 1e-3 * abs(pairing.offset_ns)
        finding = offset_in_words(
            pairing.offset_ns,
            pairing.interval_ns,
            f"the {stamps.second}",
            "the left one" if stamps.first == "left camera" else f"the {stamps.first}",
        )
        finding = (
            f"{finding[0].upper()}{finding[1:]}, throughout"
            if pairing.offset_ns
            else "There is no constant difference"
        ) + f"; single ones deviate by up to {time_in_words(float(scatter))}, {allowed} are allowed."
    return [
        judged(
            "time",
            f"stamps of the {stamps.second} against the {stamps.first.removesuffix(' camera')}",
            offset_us,
            "us",
            0.0,
            finding=finding,
            not_possible="FAIL",
            advice="If the cameras were triggered together, this is an offset of their clocks, which a run "
            "removes; if not, depth and motion are wrong: see the delay between the cameras."
            if stamps.second == "right camera"
            else "If image and ranges were taken together, this is an offset of their clocks, which a run "
            "removes; if not, depth and motion are wrong.",
        ),
        judged(
            "time",
            "images without a partner",
            share,
            "%",
            MAX_UNPAIRED,
            fail_limit=FAIL_UNPAIRED,
            finding=f"{stamps.unpaired} of {len(stamps.left) + len(stamps.right)} listed images have no "
            "partner "
            f"within {allowed}.",
            advice="Find out why frames are lost (buffers, disk), or correct the stamps in data.csv; a run "
            f"needs {100 - FAIL_UNPAIRED:.0f} % of the frames.",
        ),
    ]


def frame_checks(sequence: StereoSequence) -> list[CheckoutCheck]:
    """Unreadable and repeated images, gaps and unevenness of the pairs that a run would use."""
    dt = np.diff(sequence.timestamps_ns) * 1e-9
    usual, longest = float(np.median(dt)), int(np.argmax(dt))
    near = dt[dt < MAX_GAP * usual]
    uneven = 50.0 * float(np.ptp(np.percentile(near, [5.0, 95.0]))) / usual if len(near) else 0.0
    at = (sequence.timestamps_ns[longest] - sequence.timestamps_ns[0]) * 1e-9
    unreadable = [reason for _, reason in sequence.dropped if not reason.startswith("only in")]
    example = f" (first: {unreadable[0]})" if unreadable else ""
    repeated = int(sequence.repeated.sum())
    noun, one = ("images", "image") if sequence.has_ranges else ("pairs", "pair")
    return [
        judged(
            "time",
            "unreadable images",
            100.0 * len(unreadable) / sequence.n_listed,
            "%",
            0.0,
            fail_limit=FAIL_UNPAIRED,
            finding=f"{len(unreadable)} of {sequence.n_listed} {noun}{example}.",
            advice="Copy the images again, or remove their lines from data.csv.",
        ),
        judged(
            "time",
            "repeated images",
            100.0 * repeated / len(sequence),
            "%",
            MAX_REPEATED,
            fail_limit=FAIL_UNPAIRED,
            finding=(
                f"{repeated} of {len(sequence)} images or their ranges are those before, bit for bit."
                if sequence.has_ranges
                else f"{repeated} of {len(sequence)} pairs have an image of the pair before, bit for bit."
            )
            + (f" All {noun} are the same." if sequence.frozen else ""),
            advice=f"A camera or the recorder stood still: such {noun} are not used; find the cause.",
        ),
        judged(
            "time",
            "unevenness of the intervals",
            uneven,
            "%",
            MAX_UNEVEN,
            finding=f"{1.0 / usual:.4g} {noun} per second ({usual:.4g} s), 90 % of the intervals within "
            f"{uneven:.2g} %.",
            advice="Nothing is lost by uneven stamps if they are right; make sure that they are those of the "
            "exposures, not of the transfer.",
        ),
        judged(
            "time",
            "longest gap",
            float(dt[longest]) / usual,
            "intervals",
            MAX_GAP,
            finding=f"{dt[longest]:.4g} s, {at:.4g} s after the first {one}.",
            advice="The motion is bridged over a gap by the dynamics alone: record without gaps, or cut "
            "the sequence "
            "there.",
        ),
    ]


def inspector_checks(sequence: StereoSequence) -> list[CheckoutCheck]:
    """Whether the inspector's poses keep up with the images, and what is stated of their errors."""
    folder, name = (
        sequence.folder / "mav0" / "inspector0",
        "distance from an image to the nearest inspector pose",
    )
    if not folder.is_dir():
        at_rest = "the camera is" if sequence.has_ranges else "the cameras are"
        return [
            judged(
                "inspector",
                name,
                None,
                "intervals",
                0.5,
                advice="",
                finding=f"There is no inspector0: {at_rest} taken to be at rest.",
            )
        ]
    stamps = read_table(folder / "data.csv", columns=7).timestamps_ns
    frames = sequence.timestamps_ns
    after = np.clip(np.searchsorted(stamps, frames), 0, len(stamps) - 1)
    before = np.clip(after - 1, 0, len(stamps) - 1)
    distance = np.minimum(np.abs(stamps[after] - frames), np.abs(stamps[before] - frames))
    usual = float(np.median(np.diff(frames)))
    sigma_p, sigma_deg = sequence.sigma_camera_p_m, float(np.rad2deg(sequence.sigma_camera_theta_rad))
    rate = 1e9 * (len(stamps) - 1) / max(float(stamps[-1] - stamps[0]), 1.0)
    stated = (
        f"sigmas {1e3 * sigma_p:.3g} mm and {sigma_deg:.3g} deg"
        if sigma_p or sigma_deg
        else "no sigma, so as exact"
    )
    moves = "The inspector moves" if sequence.inspector_moves else "The inspector stays at one pose"
    return [
        judged(
            "inspector",
            name,
            float(distance.max()) / usual,
            "intervals",
            0.5,
            finding=f"{moves}; {len(stamps)} poses, {rate:.4g} per second for {1e9 / usual:.4g} images, "
            "are given "
            f"with {stated}.",
            advice="Give a pose at the time of each image: between poses it is interpolated; state "
            "sigma_p_m and "
            "sigma_theta_rad in inspector0/sensor.yaml if the poses are measured.",
        )
    ]
