"""What the figures of a page say: their content is compressed in it."""

import re

from polhode.report.template import inflated


def text_of_figures(page: str) -> str:
    """The JSON of all figures, one after the other."""
    return "\n".join(inflated(text) for text in re.findall(r'data-target="[^"]+">(.*?)</script>', page))
