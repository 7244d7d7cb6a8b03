"""Pictures by matplotlib with its own settings, whatever ``matplotlibrc`` there is.

Matplotlib reads the file ``matplotlibrc`` of the current folder, which may be a dataset of another person: it
could spoil the pictures, or have LaTeX started on a text of its own.
"""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from matplotlib import style

P = ParamSpec("P")
T = TypeVar("T")


def default_style(draw: Callable[P, T]) -> Callable[P, T]:
    """Call ``draw`` with the settings that matplotlib ships; those of before are there again afterwards."""

    @wraps(draw)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> T:
        with style.context("default"):
            return draw(*args, **kwargs)

    return drawn
