"""Puts words and figures into one HTML file that needs nothing else: no network, no other file."""

import base64
import contextlib
import io
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from PIL import Image
from plotly.offline import get_plotlyjs

from polhode.atomic import write_text
from polhode.pipeline.report import wording as words
from polhode.pipeline.report.conserved import conserved_figures
from polhode.pipeline.report.content import Content, Picture, read_content
from polhode.pipeline.report.convergence import convergence_figures
from polhode.pipeline.report.mesh_wording import mesh_rows, mesh_sentences
from polhode.pipeline.report.motion import motion_figures
from polhode.pipeline.report.plot import Figure
from polhode.pipeline.report.residuals import measurement_figures
from polhode.pipeline.report.rotation import rotation_figures
from polhode.pipeline.report.shape import shape_figures
from polhode.pipeline.report.sigmas import sigma_rows

SHEETS = ("landmarks.png", "mesh.png")
"""Pictures of the whole width; the file in RUN/pictures is sharper."""


def write_report(folder: Path, path: Path | None = None, name: str | None = None) -> None:
    """Write the report of the run in ``folder`` to ``path``, RUN/report.html unless given.

    Made from the stored files alone, so it can be written again at any time. ``name`` is what the page calls
    the run, the folder's name unless given. Raises InputError when the folder holds no run.
    """
    content = read_content(folder, name or run_name(folder))
    write_text(path or folder / "report.html", render(content))


def refresh_report(folder: Path) -> None:
    """Write RUN/report.html again, after metrics.json came to a run."""
    write_report(folder)


def render(content: Content) -> str:
    """The whole page."""
    summary, motion = content.summary, content.motion
    sections = [
        ("Motion", motion_figures(content), "The run did not reach an estimate of the motion."),
        (
            "Rotation and inertia",
            [*rotation_figures(content), *conserved_figures(content)],
            "The run did not reach an estimate of the inertia.",
        ),
        ("Convergence", convergence_figures(content), "The run holds no causal estimate."),
        ("Measurements", measurement_figures(content), "The run did not reach stereo measurements."),
        ("Shape", shape_figures(content), "The run holds neither a map nor a surface."),
    ]
    return fill(
        "report.html.j2",
        title=content.name,
        name=content.name,
        finding=words.finding(summary, motion.trajectory if motion else None),
        summary=summary,
        inertia_rows=words.inertia_rows(summary),
        absolute_rows=words.absolute_rows(summary),
        push_rows=words.push_rows(summary),
        assumed_rows=words.assumed_rows(summary.assumed),
        mesh_rows=mesh_rows(summary),
        mesh_sentences=mesh_sentences(summary),
        motion_rows=words.motion_rows(motion),
        sigma_rows=sigma_rows(content),
        run_rows=words.run_rows(content),
        timing_rows=words.timing_rows(summary),
        metric_rows=words.metric_rows(content.metrics),
        sections=sections,
        has_surface=content.surface is not None,
        sheets=[_shown(each) for each in content.pictures if each.name in SHEETS],
        stills=[_shown(each) for each in content.pictures if each.name.startswith("model")],
        pictures=[_shown(each) for each in content.pictures if each.name[0].isdigit()],
        config_text=content.config_text,
    )


def fill(template: str, **values: Any) -> str:
    """A template of this package with its values, the drawing library and the writer of figures."""
    return (
        _environment()
        .get_template(template)
        .render(figure_json=_figure_json, plotly_js=_plotly_js(), **values)
    )


def run_name(folder: Path) -> str:
    """The run's name, also while it is being written in a hidden folder beside its place."""
    return re.sub(r"^\.(.+)\.partial-\w+$", r"\1", folder.resolve().name)


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _figure_json(figure: Figure) -> Markup:
    content = {"data": figure.data, "layout": {**figure.layout, "height": figure.height_px}}
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    # Inside a script element only "<" could end it early.
    return Markup(text.replace("<", "\\u003c"))


@cache
def _plotly_js() -> Markup:
    """The library; the addresses in its own links (maps, its logo) are respelt so that no scanner takes them
    for something that this page loads. To JavaScript the strings are the same.
    """
    return Markup(re.sub(r"((?:src|href)\s*=\s*.?)h(ttps?:)", r"\1\\u0068\2", get_plotlyjs()))


def _shown(picture: Picture) -> tuple[str, str]:
    """Caption and content; sheets as JPEG, which is a quarter of the size."""
    content = picture.content
    if picture.name in SHEETS:
        stream = io.BytesIO()
        # A file that is no picture is shown as the browser shows such a thing.
        with contextlib.suppress(OSError):
            Image.open(io.BytesIO(content)).convert("RGB").save(stream, "JPEG", quality=86)
            content = stream.getvalue()
    return picture.caption, _data_uri(content)


def _data_uri(image: bytes) -> str:
    kind = "png" if image.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode('ascii')}"
