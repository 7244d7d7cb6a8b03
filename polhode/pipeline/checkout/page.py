"""The files of ``polhode checkout``: checkout.json and the page checkout.html; lines for the screen."""

import base64
import io
from contextlib import AbstractContextManager
from pathlib import Path

from PIL import Image

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.pipeline.checkout.checkout import Checkout, in_a_line
from polhode.pipeline.checkout.figures import LEVEL_PX, checkout_figures, draw_pair
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.report.template import fill
from polhode.run_directory.summary_schema import json_text
from polhode.runtime.errors import printable

COMMAND = "checkout"
FILES = ("checkout.json", "checkout.html")
GROUPS = {
    "rig": "Rig: rows of left and right image",
    "range": "Range and size",
    "motion": "Motion between frames",
    "images": "Images",
    "time": "Times",
    "background": "Background",
    "inspector": "Inspector",
    "cost": "Cost of a run",
}
WORDS = {
    "PASS": "Nothing stands against a run.",
    "WARN": "A run is possible; see what may spoil it.",
    "FAIL": "Expect a run to fail or to mislead until this is mended.",
}


def checkout_folder(path: Path) -> AbstractContextManager[Path]:
    """The folder of the results, links followed; checked before the work, and locked until it is written.

    Raises InputError.
    """
    return marked_folder(path, COMMAND, FILES.__contains__)


def write_checkout(done: Checkout, name: str, folder: Path) -> None:
    """Both files, or none. Raises InputError, RunFailure."""
    contents = json_text(done.result).encode(), render(done, name).encode()
    write_files(folder, COMMAND, dict(zip(FILES, contents, strict=True)), FILES.__contains__)


def format_checkout(done: Checkout) -> str:
    """What does not pass, the worst first, and the result in a line."""
    checks = done.result.checks
    lines = [
        f"{status}  {in_a_line(check)}"
        for status in ("FAIL", "WARN")
        for check in checks
        if check.status == status
    ]
    passed = sum(check.status == "PASS" for check in checks)
    noun = "pairs" if done.findings is None else done.findings.sample.noun
    examined = f"{done.result.pairs_examined} of {done.result.pairs} {noun} examined"
    return "\n".join([*lines, f"{done.result.status}: {passed} of {len(checks)} checks pass, {examined}"])


def render(done: Checkout, name: str) -> str:
    """The whole page."""
    result, found, picture = done.result, done.findings, None
    rows = {
        title: [check_row(check) for check in result.checks if check.group == group]
        for group, title in GROUPS.items()
    }
    if found is not None:
        stream = io.BytesIO()
        drawn = draw_pair(found.shown, found.sample.pairs[found.shown_index].rows)
        Image.fromarray(drawn).save(stream, "JPEG", quality=86)
        picture = f"data:image/jpeg;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"
    return fill(
        "checkout.html.j2",
        title=f"Checkout of {printable(name)}",
        name=printable(name),
        result=result,
        words=WORDS[result.status],
        notes=[f"{check.status}: {in_a_line(check)}" for check in result.checks if check.status != "PASS"],
        groups=[(title, found_rows) for title, found_rows in rows.items() if found_rows],
        sections=checkout_figures(done),
        picture=picture,
        has_ranges=found is not None and found.sequence.has_ranges,
        shown_px=f"{LEVEL_PX:.1f}",
    )


def check_row(check: CheckoutCheck) -> dict[str, str]:
    """A check as a row of its table."""

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.3g}"

    value = number(check.value) or "not measured"
    if check.sigma is not None:
        value += f" ± {check.sigma:.2g}"
    bound = f"{'≥' if check.at_least else '≤'} {number(check.limit)}" if check.limit is not None else ""
    if check.fail_limit is not None and check.fail_limit != check.limit:
        bound += f" ({'≥' if check.at_least else '≤'} {number(check.fail_limit)})"
    return {
        "name": check.name,
        "value": value,
        "unit": check.unit,
        "limit": bound,
        "status": check.status,
        "finding": check.finding,
        "advice": check.advice if check.status != "PASS" else "",
    }
