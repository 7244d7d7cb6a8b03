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
from polhode.report.terms import find_terms

_FILES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted(Path(__file__).with_name("templates").iterdir())
    if path.suffix in (".j2", ".css", ".js")
}
"""Read with the code that fills them: an update of the program during a long run does not part the two."""


def fill(template: str, **values: Any) -> str:
    """A template of this package, filled with values; it also gets style, script, library and encoders."""
    return (
        _environment()
        .get_template(template)
        .render(
            style=Markup(_FILES["page.css"]),  # noqa: S704  of this package
            script=Markup(_FILES["page.js"]),  # noqa: S704  of this package
            plotly_deflated=_plotly(),
            dark_colors=json_text(DARK),
            figure_text=figure_text,
            css_text=css_text,
            **values,
        )
    )


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
    escaped = "".join(each if re.match("[A-Za-z0-9 ]", each) else f"\\{ord(each):06x} " for each in text)
    return Markup(escaped)  # noqa: S704


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=DictLoader(_FILES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Macros see globals only.
    environment.globals["find_terms"] = find_terms
    return environment


def figure_text(figure: Figure) -> Markup:
    """A figure as the page holds it: for plotly.js, compressed."""
    content = {
        "data": figure.traces,
        "layout": {**figure.layout, "height": figure.height_px},
        "narrow": figure.narrow,
        "clock": figure.clock,
    }
    return deflated(json.dumps(content, separators=(",", ":"), allow_nan=False, default=packed))


@cache
def _plotly() -> Markup:
    """The library, compressed: 40 % of its size."""
    return deflated(get_plotlyjs())
