"""The report of a run: one HTML file that needs no network and no other file."""

import base64
import contextlib
import io
import json
import logging
import math
import os
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup
from PIL import Image
from plotly.offline import get_plotlyjs

from polhode.atomic import write_all, write_text
from polhode.errors import InputError, printable
from polhode.images import MAX_PIXELS
from polhode.output.locks import at_work
from polhode.output.place import begins_with, require_writable
from polhode.output.run_files import SUMMARY
from polhode.output.single_file import make_parent, output_file, remove_all_partials
from polhode.pipeline.evaluation import Metrics, evaluate
from polhode.pipeline.report import tables
from polhode.pipeline.report.convergence_figures import convergence_figures
from polhode.pipeline.report.motion_figures import motion_figures
from polhode.pipeline.report.plot_style import Figure
from polhode.pipeline.report.polhode_and_inertia_figures import rotation_figures
from polhode.pipeline.report.residual_figures import measurement_figures
from polhode.pipeline.report.shape_figures import shape_figures
from polhode.pipeline.run_directory.own_results import METRICS, OF_SUMMARY, summary_digest
from polhode.pipeline.run_directory.run_folder import require_run_folder
from polhode.pipeline.run_directory.stored_run import StoredPicture, StoredRun, read_stored_run
from polhode.pipeline.run_directory.summary import with_files, write_summary
from polhode.pipeline.run_directory.summary_schema import Summary

_log = logging.getLogger(__name__)

REPORT = "report.html"
SHEETS = ("landmarks.png", "mesh.png")
"""Pictures over the full width of the page; the files in RUN/pictures are sharper."""
MASKS = "masks.jpg"


def page_file(path: Path, folders: Sequence[Path]) -> Path:
    """Where a page about runs goes, links followed; checked before the work. Raises InputError.

    report.html of a run may be written again by the report of that run alone.
    """
    own = Path(os.path.realpath(folders[0] / REPORT))
    is_run = len(folders) == 1 and (folders[0] / SUMMARY).is_file()
    if is_run and not own.is_dir() and own == Path(os.path.realpath(path)):
        require_writable(own.parent, path)
        return own
    return output_file(path, "report", REPORT, _is_page)


_TEMPLATES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted(Path(__file__).with_name("templates").glob("*.j2"))
}
"""Read with the code that fills them: an update of the program during a long run does not part the two."""


def _is_page(path: Path) -> bool:
    return begins_with(path, '<meta name="generator" content="polhode report">')


def write_report(folder: Path, path: Path | None = None, name: str | None = None) -> None:
    """Write the report of the run in ``folder`` to ``path``, RUN/report.html unless given.

    Made from the stored files alone, so it can be written again at any time. ``name`` is the run's name on
    the page, by default the folder's. Raises InputError when the folder is not a run.
    """
    require_run_folder(folder)
    content = read_stored_run(folder, name or run_name(folder))
    page = render(content)
    if path is not None:
        make_parent(path, path)
    write_text(path or folder / REPORT, page)


def write_evaluation(folder: Path, metrics: dict[str, Any]) -> None:
    """Write metrics.json, and the report that contains it: both or, where the report cannot be made, neither.

    Raises InputError and RunFailure.
    """
    stored = {**metrics, OF_SUMMARY: summary_digest(folder)}
    page = render(read_stored_run(folder, run_name(folder), metrics))
    text = json.dumps(stored, indent=2, allow_nan=False) + "\n"
    write_all({folder / METRICS: text.encode(), folder / REPORT: page.encode()})


def evaluate_and_report(folder: Path, sequence_folder: Path) -> Metrics:
    """Compare a run with the truth of its sequence; write metrics.json and the report. Returns the metrics.

    Raises InputError: no run, no truth, another sequence, or the run cannot be written.
    """
    require_run_folder(folder)
    require_writable(folder, folder, "make the run writable, or evaluate a copy of it")
    with at_work(folder, folder):
        remove_all_partials(folder)
        metrics = evaluate(folder, sequence_folder)
        write_evaluation(folder, metrics)
    return metrics


def finish_run(folder: Path, summary: Summary) -> Summary:
    """Write summary.json and report.html. Returns the summary, with the time that the report took."""
    write_summary(summary, folder / "summary.json")
    start = perf_counter()
    try:
        write_report(folder)
    except InputError as error:
        # The results stand even without their page, which is made from them; but something in them is odd.
        _log.warning("no report: %s", error)
        status = "degraded" if summary.status == "ok" else summary.status
        summary = summary.fallen_to(status, f"no report: {error}")
    seconds = perf_counter() - start
    times = summary.timing_s
    timing = times.model_copy(update={"report": times.report + seconds, "total": times.total + seconds})
    timed = summary.model_copy(update={"timing_s": timing})
    timed = with_files(timed, folder)
    write_summary(timed, folder / "summary.json")
    return timed


def render(content: StoredRun) -> str:
    """The whole page."""
    summary, motion = content.summary, content.motion
    sections = [
        ("Motion", motion_figures(content), "The run did not reach an estimate of the motion."),
        (
            "Rotation and inertia",
            rotation_figures(content),
            "The run did not reach an estimate of the inertia.",
        ),
        ("Convergence", convergence_figures(content), "The run has no causal estimate."),
        ("Measurements", measurement_figures(content), "The run did not reach measurements."),
        ("Shape", shape_figures(content), "The run has neither a map nor a surface."),
    ]
    return fill(
        "report.html.j2",
        title=content.name,
        name=content.name,
        finding=tables.finding(summary, motion.trajectory if motion else None),
        summary=summary,
        check_rows=tables.check_rows(summary),
        inertia_rows=tables.inertia_rows(summary),
        intervals_rest_on=tables.intervals_rest_on(summary),
        absolute_rows=tables.absolute_rows(summary),
        disturbance_rows=tables.disturbance_rows(summary),
        assumed_rows=tables.assumed_rows(summary.assumed),
        mesh_rows=tables.mesh_rows(summary),
        mesh_sentences=tables.mesh_sentences(summary),
        motion_rows=tables.motion_rows(motion),
        sigma_rows=tables.sigma_rows(content),
        run_rows=tables.run_rows(content),
        timing_rows=tables.timing_rows(summary),
        metric_rows=tables.metric_rows(content.metrics),
        sections=sections,
        has_surface=content.surface is not None,
        sheets=[_embedded(each) for each in content.pictures if each.name in SHEETS],
        stills=[_embedded(each) for each in content.pictures if each.name.startswith("model")],
        masks=[_embedded(each) for each in content.pictures if each.name == MASKS],
        pictures=[_embedded(each) for each in content.pictures if each.name[0].isdigit()],
        config_text=content.config_text,
    )


def fill(template: str, **values: Any) -> str:
    """A template of this package, filled with values; it also gets plotly.js and the encoder of figures."""
    return (
        _environment()
        .get_template(template)
        .render(figure_json=_figure_json, plotly_js=_plotly_js(), **values)
    )


def run_name(folder: Path) -> str:
    """The run's name, as a text, also while it is being written into a hidden folder beside its final one."""
    return printable(re.sub(r"^\.(.+)\.partial(-\w+)?$", r"\1", folder.resolve().name))


@cache
def _environment() -> Environment:
    return Environment(
        loader=DictLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _figure_json(figure: Figure) -> Markup:
    content = {"data": figure.data, "layout": {**figure.layout, "height": figure.height_px}}
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    # Inside a script element only "<" could end it early.
    return Markup(text.replace("<", "\\u003c"))  # noqa: S704


@cache
def _plotly_js() -> Markup:
    """The library. The addresses of its own links (maps, its logo) are escaped, so that no scanner takes them
    for something that this page loads; to JavaScript the strings are the same.
    """
    library = re.sub(r"((?:src|href)\s*=\s*.?)h(ttps?:)", r"\1\\u0068\2", get_plotlyjs())
    return Markup(library)  # noqa: S704  of an installed package


def _embedded(picture: StoredPicture) -> tuple[str, str]:
    """Caption and content; sheets as JPEG, which is a quarter of the size."""
    content = picture.content
    if picture.name in SHEETS:
        stream = io.BytesIO()
        # A damaged or a hostile image is left to the browser.
        with contextlib.suppress(Exception):
            picture_of_run = Image.open(io.BytesIO(content), formats=("PNG", "JPEG"))
            if math.prod(picture_of_run.size) <= MAX_PIXELS:
                picture_of_run.convert("RGB").save(stream, "JPEG", quality=86)
                content = stream.getvalue()
    return picture.caption, _data_uri(content)


def _data_uri(image: bytes) -> str:
    kind = "png" if image.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
