"""LaTeX in the pages as MathML: browsers show it without a script, a font or a network."""

import re
from html import unescape

from latex2mathml.converter import convert

_FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\s*\\(?:\(|\[)(?P<latex>.*?)\\(?:\)|\])\s*</(?P=tag)>', re.DOTALL
)
_LEFT_AS_TEXT = re.compile(r"<m\w+[^>]*>\\[a-zA-Z]+")
"""A command of LaTeX that the converter does not know"""


def with_mathml(html: str, page: str) -> str:
    """The page with every formula that Arithmatex marked converted.

    Raises ValueError, which names the page, for LaTeX that the converter does not know.
    """

    def converted(match: re.Match[str]) -> str:
        latex, inline = unescape(match["latex"]).strip(), match["tag"] == "span"
        try:
            formula = convert(latex, display="inline" if inline else "block")
            if _LEFT_AS_TEXT.search(formula):
                raise ValueError("an unknown command")
        except Exception as error:
            raise ValueError(f"{page}: the formula {latex!r} cannot be converted: {error!r}") from error
        return formula if inline else f'<div class="formula">{formula}</div>'

    return _FORMULA.sub(converted, html)
