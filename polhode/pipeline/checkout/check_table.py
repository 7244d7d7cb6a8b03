"""The checks of checkout: group, name, unit, limits, and what to do beyond them.

Functions of the other modules give each its value and a sentence of what was found.
"""

from typing import NamedTuple

import numpy as np

from polhode.frontend.features.epipolar_search import MAX_SHIFT_SHARE
from polhode.frontend.matching.pairs import MIN_INLIERS
from polhode.importers.times import PLAUSIBLE_S
from polhode.pipeline.checkout.result import CheckoutCheck, Group, Verdict
from polhode.records.dataset import MAX_LOSS
from polhode.records.rig_calibration import USUAL_BASELINES_M


class CheckRow(NamedTuple):
    """A check, but for its value and finding."""

    group: Group
    name: str
    unit: str
    limit: float | None
    """Beyond it (``at_least``: below it) the check warns; None: information, or it depends on the rig"""
    fail_limit: float | None
    """Beyond it the check fails; None: it never fails"""
    advice: str
    not_possible: Verdict = "PASS"
    """Status without a value"""
    at_least: bool = False


FAIL_UNPAIRED = 100.0 * MAX_LOSS
"""Share of the frames [%] beyond which a run refuses a sequence"""
CALIBRATE = "Calibrate the rig again, or give the right calibration with --rig."
SEE_IMAGES = "See what the checks of the rig and of the images say."

# fmt: off
CHECK_TABLE = {
    "exchanged": CheckRow("rig", "pairs with left and right exchanged", "%", 0.0, 0.0,
        "Exchange cam0 and cam1, or correct T_BS in their sensor.yaml, if it is all pairs; else correct "
        "data.csv.", "WARN"),
    # root mean square of the rows' common offset: sound sequences have 0.06 at most, matching accepts 0.8
    "rows": CheckRow("rig", "vertical disparity", "px", 0.3, 0.8, CALIBRATE, "WARN"),
    "baseline": CheckRow("rig", "baseline", "m", 2.0, USUAL_BASELINES_M[1],
        "If the calibration is in millimetres, import with --unit mm: all lengths scale with it.", "FAIL"),
    "pitch": CheckRow("rig", "pitch of the right camera", "deg", None, None, CALIBRATE, "WARN"),
    "roll": CheckRow("rig", "roll of the right camera", "deg", None, None, CALIBRATE, "WARN"),
    "focal lengths": CheckRow("rig", "difference of the focal lengths", "%", 0.3, None, CALIBRATE, "WARN"),
    "region": CheckRow("rig", "residual vertical disparity of the worst region of the image", "px", 0.3, None,
        "Look at the map in checkout.html, and calibrate again with the board in all parts of the image: the "
        "distortion does not fit.", "WARN"),
    # longer side of the bounding box
    "size": CheckRow("range", "size of the target", "px", 90.0, 30.0,
        "Go nearer or use a longer focal length, so that the target fills more of the image.", "FAIL", True),
    "smallest disparity": CheckRow("range", "smallest disparity", "px", 6.0, 1.5,
        "Go nearer, or use a longer baseline or focal length: range is poor at small disparities.",
        "FAIL", True),
    # of nine tenths of the shift that stereo matching searches
    "largest disparity": CheckRow("range", "largest disparity", "% of the width",
        round(100.0 * 0.9 * MAX_SHIFT_SHARE, 1), None,
        "Stay farther away, use a shorter baseline, or turn the cameras towards the target: parts with "
        "larger shifts are lost to stereo matching.", "FAIL"),
    "missing ranges": CheckRow("range", "target pixels without a range", "%", 30.0, 90.0,
        "See whether the ranges belong to the pixels of the images, and whether the target is within the "
        "reach of the sensor; give masks if other things are taken for the target.", "FAIL"),
    "range noise": CheckRow("range", "noise of the ranges over that stated", "", 1.5, None,
        "Correct sigma_m and sigma_growth_per_m in range0/sensor.yaml, since sigmas and weights follow them; "
        "or scale_m, if the expected range is wrong by such a factor too.", "WARN"),
    "depth": CheckRow("range", "depth sigma of a feature over the size of the target", "%", 3.0, None,
        "Go nearer, or measure depth better: shape and rotation rest on depth that is small against its "
        "noise.",
        "WARN"),
    "features": CheckRow("motion", "median number of stereo features per pair", "", 100.0, float(MIN_INLIERS),
        "Improve light, focus or distance; where the surface has no texture, the features trained here "
        "(frontend.features.method polhode) find more.", at_least=True),
    # at 30 degrees RootSIFT finds the motion of four fifths of the lit pairs of frames, at 60 degrees of
    # three tenths, the features trained here of three quarters (docs/frontend.md#results)
    "rotation": CheckRow("motion", "rotation between successive frames", "deg", 35.0, 60.0, "", "FAIL"),
    # with RootSIFT runs that were not solved had 6 and 8; with fewer, a run uses the features trained here as
    # well, which match five times as many
    "matches": CheckRow("motion", "median number of matches between successive pairs", "", 20.0, None,
        "Record at a higher frame rate, or with softer light: shadows that move over the surface and large "
        "turns lose matches.", "WARN", True),
    "matched": CheckRow("motion", "successive pairs that match", "%", 50.0, 20.0,
        "Look at when they do not (checkout.html): in darkness and out of view nothing helps, else a higher "
        "frame rate or softer light.", "WARN", True),
    "unseen": CheckRow("images", "images without a target", "%", 10.0, 60.0,
        "Expose longer, or leave such frames out; the motion is bridged over them by the dynamics alone."),
    "saturated": CheckRow("images", "saturated part of the target", "%", 10.0, 40.0,
        "Expose for a shorter time: saturated surface has no texture, and depth there is guessed.", "WARN"),
    # below 8 features are not detected
    "brightness": CheckRow("images", "99.5th percentile of the grey levels of the target", "grey levels",
        60.0, 15.0,
        "Expose longer or use more gain; for 16-bit images state 'bits' in sensor.yaml.", "FAIL", True),
    # sharp images have 0.6 to 0.8; a Gaussian of 1 px makes it 1.0 to 1.2, one of 2 px 1.7 to 1.9
    "edges": CheckRow("images", "width of edges", "px", 1.2, 3.0,
        "Focus the lenses, and expose for a shorter time if it is worst along one direction.", "WARN"),
    "edges of cameras": CheckRow("images", "ratio of the widths of edges between the cameras", "", 1.3, None,
        "Focus the camera with the wider edges again, or clean its lens."),
    # a surface whose texture has a direction reaches 1.7
    "edges by direction": CheckRow("images", "ratio of the widths of edges between directions", "", 1.8, None,
        "Expose for a shorter time: the target moves during the exposure, or a camera vibrates."),
    "noise": CheckRow("images", "noise after the contrast is stretched", "grey levels", 6.0, None,
        "Expose longer instead of using gain, or average: noise hides weak texture."),
    "gain": CheckRow("images", "difference of brightness between the cameras", "%", 15.0, None,
        "Set both cameras to the same exposure and gain."),
    # under a single lamp or the Sun a turn of 30 degrees alone makes up to 190
    "jumps": CheckRow("images", "change of brightness between successive frames", "%", 250.0, None,
        "Switch off automatic exposure and gain, or accept fewer matches across each jump."),
    "clock offset": CheckRow("time", "clock offset of the right camera", "us", 0.0, None,
        "If the cameras were triggered together, this is an offset of their clocks, which a run removes; if "
        "not, depth and motion are wrong: see the delay between the cameras.", "FAIL"),
    "unpaired": CheckRow("time", "unpaired images", "%", 10.0, FAIL_UNPAIRED,
        "Find out why frames are lost (buffers, disk), or correct the stamps in data.csv; a run needs "
        f"{100 - FAIL_UNPAIRED:.0f} % of the frames."),
    # beyond several standard deviations, and what moves the rows by enough (data_checks/rig_check)
    "delay": CheckRow("time", "delay between the cameras", "ms", 4.0, None,
        "Trigger both cameras by one signal; distances are wrong where the target moves."),
    "unreadable": CheckRow("time", "unreadable images", "%", 0.0, FAIL_UNPAIRED,
        "Copy the images again, or remove their lines from data.csv."),
    "repeated": CheckRow("time", "repeated images", "%", 0.0, FAIL_UNPAIRED, ""),
    # half the range of the middle 90 % of the intervals, over the median one
    "jitter": CheckRow("time", "jitter of the intervals", "%", 25.0, None,
        "Nothing is lost by uneven stamps if they are right; make sure that they are those of the exposures, "
        "not of the transfer."),
    "interval": CheckRow("time", "usual interval between pairs", "s", 60.0, PLAUSIBLE_S[1],
        "Look at the unit of the timestamps (import --time-unit): rates and motion scale with it.", "FAIL"),
    "short interval": CheckRow("time", "usual interval between pairs", "s", 2e-3, PLAUSIBLE_S[0],
        "Look at the unit of the timestamps (import --time-unit): rates and motion scale with it.", "FAIL",
        True),
    "duration": CheckRow("time", "duration", "days", 1.0, 30.0,
        "Look at the unit of the timestamps (import --time-unit), or at a clock that was set.", "FAIL"),
    # another unit is a factor of a thousand; 1 Hz is what many write that know of none
    "stated rate": CheckRow("time", "interval over that of rate_hz in sensor.yaml", "", 3.0, 30.0,
        "Correct the unit of the timestamps (import --time-unit), or rate_hz in sensor.yaml."),
    "gap": CheckRow("time", "longest gap", "intervals", 5.0, None,
        "The motion is bridged over a gap by the dynamics alone: record without gaps, or cut the sequence "
        "there."),
    "masks": CheckRow("background", "images with a mask, where some have one", "%", 100.0, None,
        "Give a mask for every frame (masks0/, masks1/), or for none: a frame without one is used whole.",
        at_least=True),
    "inverted masks": CheckRow("background", "masks that look inverted", "%", 20.0, 50.0,
        "Exchange black and white: the target is what is not 0."),
    "doubtful masks": CheckRow("background", "pairs with doubtful segmentation masks", "%", 20.0, None, ""),
    "border": CheckRow("background", "bright part of the border of the image", "%", 5.0, 60.0,
        "If it is background (Earth, a wall), give masks of the target in masks0/ and masks1/; if it is the "
        "target, keep all of it in view."),
    "surroundings": CheckRow("background", "bright pixels around the target", "%", 1.0, None,
        "Stars and glints that are small do no harm; give masks if there are larger things."),
    "leaving": CheckRow("background", "images in which the target reaches the border", "%", 20.0, None,
        "Keep the whole target in the images: parts beyond the border have no shape, and a cut outline "
        "misleads masks."),
    "inspector": CheckRow("inspector", "distance from an image to the nearest inspector pose", "intervals",
        0.5, None,
        "Give a pose at the time of each image: between poses it is interpolated; state sigma_p_m and "
        "sigma_theta_rad in inspector0/sensor.yaml if the poses are measured."),
}
# fmt: on
Limits = tuple[float | None, float | None]


def limit_of(key: str) -> float:
    """The limit from which on a check warns."""
    limit = CHECK_TABLE[key].limit
    assert limit is not None
    return limit


def make_check(
    key: str,
    value: float | None,
    finding: str,
    *,
    limits: Limits | None = None,
    sigma: float | None = None,
    name: str = "",
    advice: str = "",
) -> CheckoutCheck:
    """The check of a row with its value, None or NaN: not possible; ``limits``, ``name`` and ``advice``
    instead of the row's."""
    row = CHECK_TABLE[key]
    limit, fail_limit = limits or (row.limit, row.fail_limit)
    status, known = row.not_possible, value is not None and np.isfinite(value)
    if value is not None and known:
        # what is printed is what is judged
        value = float(f"{value:.6g}")
        beyond = [
            each is not None and (value < each if row.at_least else value > each)
            for each in (limit, fail_limit)
        ]
        status = "FAIL" if beyond[1] else "WARN" if beyond[0] else "PASS"
    return CheckoutCheck(
        group=row.group,
        name=name or row.name,
        value=value if known else None,
        unit=row.unit,
        limit=limit,
        fail_limit=fail_limit,
        at_least=row.at_least,
        sigma=None if sigma is None or not known else float(f"{sigma:.6g}"),
        status=status,
        finding=finding,
        advice="Nothing to do." if status == "PASS" else (advice or row.advice),
    )
