"""The files of ``polhode calibrate --verify``: verification.json, verification.html; lines for the screen."""

import numpy as np

from polhode.calibration.epipolar import common_corners, epipolar_px
from polhode.calibration.figures import (
    coverage_figure,
    epipolar_figure,
    epipolar_histogram,
    radial_figure,
    residual_figure,
    views_figure,
)
from polhode.calibration.verify import Verified
from polhode.errors import printable
from polhode.pipeline.checkout.checkout import in_a_line
from polhode.pipeline.checkout.page import check_row
from polhode.pipeline.report.template import fill
from polhode.pipeline.run_directory.summary_schema import json_text

VERIFY_COMMAND = "calibrate --verify"
"""In the mark of the folder."""
VERIFY_PAGE = "verification.html"
VERIFY_FILES = ("verification.json", VERIFY_PAGE)
WORDS = {
    "PASS": "The calibration holds for these images.",
    "WARN": "The calibration holds roughly; see what may have changed.",
    "FAIL": "The calibration does not hold for these images.",
}


def verification_files(done: Verified, name: str) -> dict[str, bytes]:
    """Both files, by their names."""
    return {
        VERIFY_FILES[0]: json_text(done.result).encode(),
        VERIFY_PAGE: _render(done, name).encode(),
    }


def format_verification(done: Verified) -> str:
    """What does not pass, the worst first, the two errors, and the result in a line."""
    result = done.result
    lines = [f"left out  {each.file}: {each.reason}" for each in result.rejected]
    lines += [
        f"{status}  {in_a_line(check)}"
        for status in ("FAIL", "WARN")
        for check in result.checks
        if check.status == status
    ]
    passed = sum(check.status == "PASS" for check in result.checks)
    values = {check.name: check.value for check in result.checks}
    lines.append(
        f"{result.status}: {passed} of {len(result.checks)} checks pass, {result.pairs} pairs; reprojection "
        f"{values['reprojection error']:.3f} px, epipolar {values['epipolar error']:.3f} px"
    )
    return "\n".join(lines)


def _render(done: Verified, name: str) -> str:
    views, data, residuals = done.views, done.data, done.residuals
    left, right = common_corners(data)
    right_px = data[1].uv_px[right]
    error = np.asarray(epipolar_px(done.state, data[0].uv_px[left], right_px))
    sizes = (views.size_px(0), views.size_px(1))
    names = [printable(each or "") for each in views.pairs.names[0]]
    sections = [
        ("Epipolar error", [epipolar_figure(right_px, error, sizes[1]), epipolar_histogram(error)]),
        (
            "Residuals",
            [
                *(residual_figure(data[c], residuals[c], sizes[c], c) for c in (0, 1)),
                views_figure(residuals, data, names, views.count),
                radial_figure(done.state, data, residuals),
            ],
        ),
        ("Coverage", [coverage_figure(data[c], sizes[c], c) for c in (0, 1)]),
    ]
    checks = done.result.checks
    return fill(
        "verification.html.j2",
        title=f"Verification of {printable(name)}",
        name=printable(name),
        result=done.result,
        words=WORDS[done.result.status],
        notes=[f"{check.status}: {in_a_line(check)}" for check in checks if check.status != "PASS"],
        rows=[check_row(check) for check in checks],
        sections=sections,
    )
