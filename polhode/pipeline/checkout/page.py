"""The files of ``polhode checkout``: checkout.json and the page checkout.html; lines for the screen."""

import base64
import io
from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from polhode.files.output.marked_folder import marked_folder, write_files
from polhode.frontend.features.epipolar_search import RowOffsets
from polhode.frontend.rectification import RectifiedPair
from polhode.geometry.camera import RectifiedRig
from polhode.pipeline.checkout.check_table import limit_of
from polhode.pipeline.checkout.checkout import Checkout, in_a_line
from polhode.pipeline.checkout.result import CheckoutCheck
from polhode.pipeline.checkout.rig_tilt import REGIONS, RowFit, regions
from polhode.report.plot_style import (
    FAINT,
    INK,
    Figure,
    Layout,
    Trace,
    axis,
    color_bar,
    layout,
    note,
    on,
    packed,
)
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
}
WORDS = {
    "PASS": "Nothing stands against a run.",
    "WARN": "A run is possible; see what may spoil it.",
    "FAIL": "Expect a run to fail or to mislead until this is mended.",
}
LEVEL_PX = 3.0 * limit_of("rows")
"""Rows of a match that differ by more are drawn in another colour."""


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
        sections=[] if found is None or found.rows is None else [("Rows", [_map(found.rows, found.rig)])],
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


def _map(fit: RowFit, rig: RectifiedRig) -> Figure:
    """The vertical disparity over the image."""
    offset_px, uv_px = fit.offset_px[fit.good], fit.uv_px[fit.good]
    limit = max(limit_of("rows"), float(np.percentile(np.abs(offset_px), 98.0)))
    median, count = regions(fit, rig, fit.offset_px)
    scale = [[0.0, "#0072b2"], [0.5, "#e8ecf0"], [1.0, "#d55e00"]]
    marker: Layout = {"color": packed(offset_px), "colorscale": scale, "cmin": -limit, "cmax": limit}
    marker |= {"size": 5, "line": {"color": FAINT, "width": 0.3}, "colorbar": color_bar("px")}
    points: Trace = {"type": "scatter", "mode": "markers", "x": packed(uv_px[:, 0]), "y": packed(uv_px[:, 1])}
    points |= {"marker": marker, "showlegend": False, **on(1)}
    width, height = rig.width_px, rig.height_px
    style: Layout = {"xref": "x", "yref": "y", "bgcolor": "rgba(255,255,255,0.75)"}
    style |= {"font": {"size": 12, "color": INK}}
    words = [
        note(
            f"<b>{median[row, column]:+.2f}</b> ({count[row, column]})",
            (column + 0.5) * width / REGIONS,
            (row + 0.5) * height / REGIONS,
            **style,
        )
        for row, column in np.argwhere(count)
    ]
    grid: list[Layout] = []
    for k in range(1, REGIONS):
        u, v = k * width / REGIONS, k * height / REGIONS
        for x0, x1, y0, y1 in ((u, u, 0, height), (0, width, v, v)):
            ends = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}
            grid.append({"type": "line", **ends, "line": {"color": "#c3ccd4", "width": 1}})
    drawing = layout(
        xaxis=axis("u [px]", range=[0, width], showgrid=False),
        yaxis=axis("v [px]", range=[height, 0], scaleanchor="x", constrain="domain", showgrid=False),
        annotations=words,
        shapes=grid,
    )
    caption = (
        "Row in the left minus row in the right image, of matches of all examined pairs, in the rectified "
        "left image; in each part of the image the median [px] and the number of matches. A rig that is as "
        "calibrated shows grey everywhere. An offset of all is a pitch, a slope along the rows a roll of the "
        "right camera, one down the image a difference of the focal lengths."
    )
    return Figure("rows-map", "Vertical disparity over the image", caption, [points], drawing, height_px=460)


def draw_pair(pair: RectifiedPair, rows: RowOffsets) -> NDArray[np.uint8]:
    """Left and right image side by side (H, 2 W, 3) as rectified: guides along the rows, matches joined.

    As the astronauts' second screen (thesis figure 5-25): the lines must be as level as the guides. Or the
    image beside its range image: near is bright, black is not measured.
    """

    def grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        bright = image.astype(np.float64) * (235.0 / max(float(np.percentile(image, 99.7)), 16.0))
        return np.repeat(np.clip(bright, 0.0, 255.0).astype(np.uint8)[..., None], 3, axis=2)

    if pair.measured is not None:
        d = pair.measured.disparity_px
        known = np.isfinite(d)
        low, high = np.percentile(d[known], [1.0, 99.0]) if known.any() else (0.0, 1.0)
        level = np.clip((np.where(known, d, low) - low) / max(high - low, 1e-6), 0.0, 1.0)
        colours = cv2.applyColorMap((255.0 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
        return np.hstack([grey(pair.left), np.where(known[..., None], colours, 0).astype(np.uint8)])
    picture, (height, width) = np.hstack([grey(pair.left), grey(pair.right)]), pair.left.shape
    for row in np.linspace(0, height, 9 + 2)[1:-1].astype(int).tolist():
        cv2.line(picture, (0, row), (2 * width, row), (0, 158, 115), 1)
    order = np.argsort(rows.uv_px[:, 1], kind="stable")
    some = order[np.unique(np.linspace(0, len(order) - 1, 40).astype(int))] if len(order) else order
    for k in some.tolist():
        u, v = rows.uv_px[k]
        ends = np.array([[u, v], [u - rows.disparity_px[k] + width, v - rows.offset_px[k]]])
        a, b = np.round(16 * ends).astype(int).tolist()
        color = (86, 180, 233) if abs(rows.offset_px[k]) <= LEVEL_PX else (213, 94, 0)
        cv2.line(picture, a, b, color, 1, cv2.LINE_AA, shift=4)
        for end in (a, b):
            cv2.circle(picture, end, 3 * 16, color, 1, cv2.LINE_AA, shift=4)
    return np.asarray(picture, dtype=np.uint8)
