"""Filling the pages: templates, style, script, plotting library and figures, all inside one file."""

import base64
import json
import re
import zlib
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import DictLoader, Environment, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from polhode.report.plot_style import DARK, Figure, packed

_FILES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted(Path(__file__).with_name("templates").iterdir())
    if path.suffix in (".j2", ".css", ".js")
}
"""Read with the code that fills them: an update of the program during a long run does not part the two."""


def fill(template: str, **values: Any) -> str:
    """A template of this package, filled with values; it also gets style, script, library and encoders."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=DictLoader(_FILES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals.update(
        style=Markup(_FILES["page.css"]),  # noqa: S704  of this package
        script=Markup(_FILES["page.js"]),  # noqa: S704  of this package
        # The plotting library, compressed: 40 % of its size.
        plotly_deflated=deflated(get_plotlyjs()),
        dark_colors=json_text(DARK),
        figure_text=figure_text,
        css_text=css_text,
    )
    return environment


def deflated(text: str) -> Markup:
    """A text as base64 of its zlib stream, which the page's script inflates; the same for the same text."""
    return Markup(base64.b64encode(zlib.compress(text.encode(), 9)).decode("ascii"))  # noqa: S704  base64


def inflated(text: str) -> str:
    """What ``deflated`` was given."""
    return zlib.decompress(base64.b64decode(text)).decode()


def json_text(content: Any) -> Markup:
    """JSON that may stand inside a script element: only "<" could end it early."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))  # noqa: S704


def css_text(text: str) -> Markup:
    """A text inside the quotation marks of a style sheet: all but letters, digits and spaces escaped.

    A space ends each escape: a style sheet takes one away there, even after six digits.
    """
    return Markup(re.sub("[^A-Za-z0-9 ]", lambda each: f"\\{ord(each[0]):06x} ", text))  # noqa: S704


def figure_text(figure: Figure) -> Markup:
    """A figure as the page holds it: for plotly.js, compressed."""
    drawing = figure.layout | {"height": figure.height_px}
    content = {"data": figure.traces, "layout": drawing, "clock": figure.clock}
    return deflated(json.dumps(content, separators=(",", ":"), allow_nan=False, default=packed))
