"""The checks that a run makes of its data and of its answer: name, unit, limit, and the reason to doubt.

A check is a function that compares records and gives a value; everything that is said about the value stands
here, a row each. A reason says what does not hold and what to do. How the checks decide the status of a run
is in ``verdict``, what they can and cannot find in docs/checks.md.
"""

import logging
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from polhode.run_directory.summary_schema import Check

_log = logging.getLogger(__name__)


class CheckRow(NamedTuple):
    """What a check measures and expects."""

    name: str
    unit: str
    limit: float | None
    """From where on (``at_least``: below which) the answer is doubted; None: information only"""
    reason: str
    """A format string, of the value and of what the check gives besides"""
    at_least: bool = False


# fmt: off
CHECK_TABLE = {
    # of the data
    "identical images": CheckRow("all images identical", "", 0.0,
        "all pairs of images are the same, bit for bit: a camera or the recorder stood still, and the "
        "motion found is not the target's (or the images are rendered ones, without noise, of a target "
        "at rest)"),
    "exchanged images": CheckRow("pairs with negative disparities", "pairs", 0.0,
        "the images of {value:.0f} of {pairs} pairs are exchanged, left for right (first at {first_s:g} "
        "s): points would be behind the cameras; correct data.csv"),
    # several times what a frame's median scatters
    "step of rows": CheckRow("step of the vertical disparity in time", "px", 0.3,
        "the rows of the two images differ by {step_px:+.2f} px more from {from_s:g} s on, as if one "
        "camera had turned by {degrees:.2f} deg: the calibration does not hold throughout"),
    "step of roll": CheckRow("step of the roll between the cameras in time", "deg", float(np.rad2deg(1e-3)),
        "the rows of the two images are inclined by {value:.2f} deg more from {from_s:g} s on, as if one "
        "camera had turned about its axis: the calibration does not hold throughout"),
    # far above the jitter of a trigger
    "camera delay": CheckRow("delay between the cameras", "ms", 4.0,
        "the right camera's images are {value:.0f} ms {late} (sigma {sigma_ms:.1f} ms): the rows of the "
        "two images differ where the target moves, and distances and shape are wrong accordingly"),
    # an angle, times the focal length
    "step of disparities": CheckRow("step of all disparities in time", "px", None,
        "from {from_s:g} s on all disparities are {step_px:+.2f} px different, as if one camera had "
        "turned sideways by {degrees:.2f} deg: the calibration does not hold throughout"),
    "focal length": CheckRow(
        "self-calibrated focal length from the calibration, in sigmas of both", "sigma", 5.0,
        "a focal length {percent:.2f} % {longer} than calibrated (sigma {sigma:.2f} %), or disparities "
        "{disparity_px:+.2f} px different, would fit the rotating target better, {value:.1f} sigmas of the "
        "stated calibration: calibrate again, or state larger sigmas; distances are wrong accordingly"),
    "focal length of ranges": CheckRow(
        "self-calibrated focal length from the calibration, in sigmas of both", "sigma", 5.0,
        "a focal length {percent:.2f} % {longer} than calibrated (sigma {sigma:.2f} %), or ranges with "
        "another offset, would fit the rotating target better: check the calibration of the camera and of "
        "the ranges; shape and motion are wrong accordingly"),
    # good sequences show 0.4 % at most
    "clock": CheckRow(
        "period of rotation from the images over that from the timestamps: deviation from 1", "%", 8.0,
        "the time stamps contradict the rotation, most after {from_s:g} s: within the {stated_s:.2f} s "
        "that they state the target turned as it does in {needed_s:.2f} s before and after; the clock "
        "may have jumped, and rates and disturbances there are not those of the target"),
    "inspector attitude": CheckRow("noise of the inspector's attitudes", "deg", 0.1,
        "the reported poses of the inspector contradict the images: their attitudes scatter by about "
        "{value:.2f} deg, where {stated_deg:.2f} deg is stated, and the target turns more smoothly "
        "without them; check inspector0/"),
    # odds of four hundred; of 340 good runs without a swing, most of them with other faults, at most 4.3
    "inspector swing": CheckRow(
        "log evidence of an unreported oscillation of the inspector's attitude", "log odds", 6.0,
        "the target's path and its attitude swing together as they would if the inspector's attitude "
        "did, by about {swing_deg:.2f} deg beside what is reported: no force and torque on the target "
        "are tied to one another like this; check inspector0/, or supply it where the inspector does not "
        "keep its attitude"),
    # undisturbed sequences show 6.1 at the worst of all instants: errors have more in common than sigmas know
    "centre before and after": CheckRow("change of the centre of mass at a disturbance", "sigma", 7.0,
        "from {from_s:.1f} s on the centre of mass is another point of the target than before (by "
        "{change_mm:.1f} mm, {value:.0f} sigma): a part may have left it, or moved; what is stated of "
        "mass, axes and motion for the whole sequence is true of neither"),
    "mass before and after": CheckRow("mass properties that change at a disturbance", "", 0.0,
        "after {end_s:.1f} s the target has other mass properties than before {start_s:.1f} s "
        "({changes}): a part may have left it, or moved; what is stated for the whole sequence is true "
        "of neither"),
    # three landmarks fix a pose, four agreed with a wrong one by chance; matches of two frames count as well
    "connection": CheckRow("fewest landmarks common to the parts before and after an instant", "", 6.0,
        "the parts before {start_s:g} s and after {end_s:g} s share {count} and are connected by the "
        "dynamics alone: the turn between them, and what follows from it, no image confirms{others}",
        at_least=True),
    # with fewer, the robust steps after them cope
    "doubtful masks": CheckRow("pairs with doubtful segmentation masks", "%", 20.0, "{doubts}"),
    # right rates have at least 0.2, and mostly 0.4 to 0.95, those of a still outline at most 0.04
    "symmetry rotation": CheckRow(
        "contrast between the best and the second-best rotation about the symmetry axis", "", 0.15,
        "if the target is a body of revolution, as its surface suggests, the turn found about its axis is "
        "doubtful, since "
        "{doubt} one that differs by {rate_deg_s:.1f} deg/s (correlation {own:.2f} and {other:.2f}, "
        "usual: 0.5 and 0)", at_least=True),
    # sound scenes of configs/scenes have 0 to 4 %, axisymmetric 10 %, minor_axis 20 %
    "links": CheckRow(
        "relative poses from matching alone that differ from the motion by more than 5 deg", "%", 15.0,
        "{value:.0f}% of the links between frames, by matching alone, contradict the motion by more than "
        "5 deg (usual: below 5%): in these pairs most features move otherwise"),
    # of a frame; undisturbed runs have 90 or more
    "mirror": CheckRow("separation from the solution with reversed relief", "sigma", 12.0,
        "the relief of the target hardly shows in the disparities ({value:.0f} sigma a frame): the same "
        "body turned inside out, rotating the other way, would fit these images almost as well; come "
        "closer or use a longer baseline", at_least=True),
    # thruster bursts have up to 0.9; of 35 good runs with a push, those whose clock did not jump up to 3.1
    "push": CheckRow("displacement beyond what a disturbance can cause", "sigma", 4.0,
        "between {start_s:.1f} s and {end_s:.1f} s the target is displaced by {excess_mm:.2g} mm more "
        "than its change of velocity explains ({sigmas:.1f} sigma): no push does this; a camera or the "
        "inspector's pose may have jumped, or a part left the target"),
    # of the estimate as such
    "frames": CheckRow("frames with measurements", "%", 50.0,
        "fewer than half of the frames have measurements; the others are bridged by the dynamics",
        at_least=True),
    "outliers": CheckRow("observations rejected as outliers", "%", 40.0,
        "{value:.0f}% of the observations contradict the motion"),
    "rotation": CheckRow("odds of other rotations between pairs", "%", 1.0,
        "how far the target rotates between pairs is ambiguous: {turns} degrees fit the images alike (odds "
        "{odds}); state the fastest rotation that it may have (backend.max_rpm), or record more pairs a "
        "second, or pairs at differing intervals"),
    # stronger disturbances make an answer doubtful, because frames may contradict one another
    "disturbances": CheckRow("power of the disturbances over that stated", "", 30.0,
        "the disturbances appear {value:.0f} times as strong as stated (power): an unknown force or "
        "wrong associations may be the cause; the standard deviations are large accordingly"),
    "surface": CheckRow("faces of the mesh", "", 1.0,
        "there is no surface: the depth maps gave none, or the run ended before them", at_least=True),
}
# fmt: on


def make_check(key: str, value: float | None, limit: float | None = None, **facts: object) -> Check:
    """The check of a row with its value. None: these data do not allow it.

    ``limit`` instead of the row's; ``facts`` are what the reason names besides the value.
    """
    row = CHECK_TABLE[key]
    limit = row.limit if limit is None else float(limit)
    check = Check(name=row.name, limit=limit, unit=row.unit, at_least=row.at_least)
    if value is None:
        return check
    beyond = limit is not None and (value < limit if row.at_least else value > limit)
    reason = row.reason.format(value=value, **facts) if beyond else ""
    return check.model_copy(update={"value": float(value), "reason": reason})


def frame_step(n_frames: int) -> int:
    """Every how many frames costly checks take, so that a long sequence is thinned out to 120 frames."""
    return -(-n_frames // 120)


def attempt_checks(step: Callable[[], list[Check]]) -> list[Check]:
    """The checks of a step, their reasons logged. An error does not cost the run, which is doubted for it."""
    try:
        with np.errstate(invalid="ignore", divide="ignore"):
            found = step()
    except (ArithmeticError, LookupError, ValueError, MemoryError) as error:
        _log.debug("a check ended with an error", exc_info=True)
        kind = type(error).__name__
        reason = f"a check ended with an error ({kind}: {error}): what it finds is not known; see log.txt"
        found = [Check(name=f"checks that raised an error ({kind})", value=1.0, limit=0.0, reason=reason)]
    for check in found:
        if check.reason:
            _log.warning(check.reason)
    return found
