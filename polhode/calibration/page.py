"""The files of ``polhode calibrate``: calibration.json, the calibration in each format, and report.html."""

from polhode.calibration.calibrate import CalibratedRig
from polhode.calibration.figures import page_sections
from polhode.calibration.formats import FORMAT_FILES, calibration_files
from polhode.calibration.result import CalibrationResult, Parameter, result_of
from polhode.report.template import fill
from polhode.run_directory.summary_schema import json_text
from polhode.runtime.errors import printable

COMMAND = "calibrate"
"""In the mark of the folder."""
PAGE, RESULT = "report.html", "calibration.json"
FILES = (*FORMAT_FILES, RESULT, PAGE)
TITLES = {
    "cam0": "Left camera",
    "cam1": "Right camera",
    "cam1_from_cam0": "From the left into the right camera",
    "rig": "Rig",
}
MODEL_WORDS = {
    "brown5": "pinhole, Brown's distortion with 5 coefficients",
    "brown8": "pinhole, Brown's rational distortion with 8 coefficients",
    "fisheye": "equidistant fisheye",
}


def files_of(rig: CalibratedRig, name: str) -> dict[str, bytes]:
    """All files of a calibration, by their names."""
    result = result_of(rig)
    sizes = (rig.views.size_px(0), rig.views.size_px(1))
    return {
        **calibration_files(rig.state, sizes),
        RESULT: json_text(result).encode(),
        PAGE: render(rig, result, name).encode(),
    }


def format_calibration(rig: CalibratedRig) -> str:
    """What the screen shows: images that are left out, residuals, warnings."""
    result = result_of(rig)
    lines = [f"left out  {each.file}: {each.reason}" for each in result.rejected]
    lines += [f"warning  {each}" for each in result.warnings]
    rms = result.rms_px
    baseline = result.parameters["rig"]["baseline"]
    lines.append(
        f"{result.pairs} pairs, {len(result.used)} images used, {len(result.rejected)} left out; residuals "
        f"{rms.cam0:.3f} px (left alone), {rms.cam1:.3f} px (right alone), {rms.stereo:.3f} px (together); "
        f"epipolar error {result.epipolar_rms_px:.3f} px; baseline {1e3 * baseline.value:.3f} mm "
        f"(sigma {1e3 * baseline.sigma:.3f})"
    )
    return "\n".join(lines)


def render(rig: CalibratedRig, result: CalibrationResult, name: str) -> str:
    """The whole page."""
    groups = [
        (TITLES[group], [_row(key, each) for key, each in own.items()])
        for group, own in result.parameters.items()
    ]
    return fill(
        "calibration.html.j2",
        title=f"Calibration of {printable(name)}",
        name=printable(name),
        result=result,
        board=rig.views.board.words,
        models=[MODEL_WORDS[each.model] for each in result.cameras],
        groups=groups,
        sections=page_sections(rig.views, rig.state, rig.data, rig.adjusted.residuals).items(),
    )


def _row(name: str, each: Parameter) -> dict[str, str]:
    # two digits of the standard deviation
    exponent = int(f"{each.sigma:e}".partition("e")[2]) if each.sigma > 0.0 else 1
    digits = max(0, min(12, 1 - exponent))
    return {
        "name": name,
        "value": f"{each.value:.{digits}f}",
        "sigma": f"{each.sigma:.2g}",
        "unit": each.unit,
    }
