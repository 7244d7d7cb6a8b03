"""The files of ``polhode calibrate --verify``: verification.json, verification.html; lines for the screen."""

from polhode.calibration.figures import page_sections
from polhode.calibration.verify import Verified
from polhode.pipeline.checkout.checkout import in_a_line
from polhode.pipeline.checkout.page import check_row
from polhode.report.template import fill
from polhode.run_directory.summary_schema import json_text
from polhode.runtime.errors import printable

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
    parts = page_sections(done.views, done.state, done.data, done.residuals)
    checks = done.result.checks
    return fill(
        "verification.html.j2",
        title=f"Verification of {printable(name)}",
        name=printable(name),
        result=done.result,
        words=WORDS[done.result.status],
        notes=[f"{check.status}: {in_a_line(check)}" for check in checks if check.status != "PASS"],
        rows=[check_row(check) for check in checks],
        sections=[(title, parts[title]) for title in ("Epipolar error", "Residuals", "Coverage")],
    )
