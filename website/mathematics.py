"""LaTeX in the pages as MathML: browsers show it without a script, a font or a network."""

import re
from html import unescape

from latex2mathml.converter import convert

_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\(?:\(|\[)(?P<latex>.*?)\\(?:\)|\])\s*</(?P=tag)>', re.DOTALL
)


def with_mathml(html: str, page: str) -> str:
    """The page with every formula that Arithmatex marked converted.

    Raises ValueError, which names the page, for LaTeX that the converter does not know.
    """

    def converted(match: re.Match[str]) -> str:
        latex = unescape(match["latex"]).strip()
        display = "inline" if match["tag"] == "span" else "block"
        try:
            formula = convert(latex, display=display)
        except Exception as error:
            raise ValueError(f"{page}: the formula {latex!r} cannot be converted: {error!r}") from error
        if _left_over(formula):
            raise ValueError(f"{page}: the formula {latex!r} has a command that is not converted")
        return formula if display == "inline" else f'<div class="formula">{formula}</div>'

    return _FORMULA.sub(converted, html)


def _left_over(formula: str) -> bool:
    """Whether a command of LaTeX stands in the output as text."""
    return re.search(r"<m\w+[^>]*>\\[a-zA-Z]+", formula) is not None
